"""Commands about the results of a campaign."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, BinaryIO, Literal, TextIO, cast, get_args

import typer
import yaml

from drivecal.calibration_data.files import labels_of
from drivecal.cli.application import CampaignArgument, UrlOption, app, connect, say
from drivecal.cli.commands.problem import NamesOption
from drivecal.cli.views.output import Asked, asking, print_importance, print_ranked, print_solutions
from drivecal.cli.views.sections import front_blocks, shown_of_front
from drivecal.client.client import Client
from drivecal.client.transport import harmless_text
from drivecal.configuration.documents import read_document
from drivecal.contracts.assignments import assignments
from drivecal.contracts.tables import TableName
from drivecal.domain.errors import InvalidInputError, NotFoundError, Problem, file_faults

Format = Literal["csv", "parquet", "json", "yaml", "dcm", "cdfx"]
ScoreOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME or NAME@PUSH",
        help="Rank by another score of the problem instead, or of another push (name or digest), from stored measures.",
    ),
]

VariantOption = Annotated[str | None, typer.Option(metavar="NAME", help="Rank for this variant of the campaign.")]


@app.command()
@asking
def solutions(
    client: Client,
    identifier: CampaignArgument,
    weights: Annotated[
        str | None,
        typer.Option(metavar="S1=2,S2=1", help="Rank by these weights instead; simulates nothing. Not named means weight 1."),
    ] = None,
    score: ScoreOption = None,
    variant: VariantOption = None,
    limit: Annotated[int, typer.Option(min=1, max=1000, help="How many at most, best first.")] = 20,
) -> Asked:
    """Show the best parameter sets of a campaign."""
    if weights is not None:
        assignments(weights.split(","), "--weights")
    page = client.solutions(identifier, weights, limit, score, variant)

    def shown() -> None:
        print_solutions(page.items, client.setup(identifier).shapes)
        cells = client.campaign(identifier).cells
        if score is not None and cells.reused + cells.predicted:
            say("note: sets with a copied or predicted score have no other score and are left out; drivecal rerun rates them")

    return page, shown


@app.command()
@asking
def importance(
    client: Client,
    identifier: CampaignArgument,
    scenario: Annotated[str | None, typer.Option(metavar="NAME", help="For the score in this scenario.")] = None,
    variant: VariantOption = None,
) -> Asked:
    """Show what matters: how much the objective depends on each parameter among the sets of the search."""
    answer = client.importance(identifier, scenario=scenario, variant=variant)
    return answer, lambda: print_importance(answer)


@app.command()
@asking
def front(
    client: Client,
    identifier: CampaignArgument,
    weights: Annotated[
        str | None,
        typer.Option(metavar="comfort=2,gap=1", help="Best first under these weights of the objectives; others have 1."),
    ] = None,
    limit: Annotated[
        int, typer.Option(min=1, help="How many to print: knee, best of each objective, the first others; --json lists all.")
    ] = 20,
) -> Asked:
    """Show the sets of a campaign that no other set beats in every objective."""
    campaign_id = client.campaign(identifier).id
    rows, summary = client.front(campaign_id, weights), client.front_summary(campaign_id, weights)

    def show() -> None:
        sets = {row.rank: row.parameters for row in shown_of_front(rows, limit)}
        print_ranked(front_blocks(rows, summary, limit), sets, client.setup(campaign_id).shapes)

    return {"summary": summary, "items": rows}, show


@app.command()
def export(
    identifier: CampaignArgument,
    given_table: Annotated[
        TableName | None,
        typer.Option(
            "--table",
            help=f"One of {', '.join(get_args(TableName))}; by default evaluations; of one set, solutions or the front.",
        ),
    ] = None,
    form: Annotated[
        Format | None,
        typer.Option("--format", help=f"One of {', '.join(get_args(Format))}; by default the file's ending, or csv."),
    ] = None,
    output: Annotated[str, typer.Option("--output", "-o", metavar="FILE", help="Where to; - is standard output.")] = "-",
    row: Annotated[
        int | None,
        typer.Option(min=1, max=1000, metavar="N", help="One set for calibration tools: rank N of the solutions or front."),
    ] = None,
    names: NamesOption = None,
    base: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Of one set: a DCM or CDFX whose other content is kept, or an A2L with its axes."),
    ] = None,
    where: Annotated[
        list[str] | None,
        typer.Option(metavar="CONDITION", help="Only such rows: COLUMN=VALUE, >=NUMBER or <=NUMBER; may be repeated."),
    ] = None,
    weights: Annotated[
        str | None,
        typer.Option(metavar="S1=2,S2=1", help="Of solutions (scenarios) and front (objectives): ranked by these weights."),
    ] = None,
    score: ScoreOption = None,
    variant: VariantOption = None,
    measures: Annotated[
        bool, typer.Option("--measures", help="Of the table evaluations: the measures of each run as further columns.")
    ] = False,
    url: UrlOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="The same as --format json.")] = False,
) -> None:
    """Write a whole table of a campaign to a file, or its best set as a calibration file (dcm, cdfx, yaml, or
    csv and json with --row)."""
    if as_json and form not in {None, "json"}:
        raise typer.BadParameter(f"--json is --format json, not {form}")
    form = "json" if as_json else form or _format_of(output if output != "-" or base is None else base.name)
    is_single = form in {"dcm", "cdfx", "yaml"} or any(given is not None for given in (row, names, base))
    table = given_table or ("solutions" if is_single else "evaluations")
    if weights is not None and table not in {"solutions", "front"}:
        raise typer.BadParameter("--weights needs --table solutions or front")
    for option, chosen in {"--score": score, "--variant": variant}.items():
        if chosen is not None and table != "solutions":
            raise typer.BadParameter(f"{option} needs --table solutions")
    if measures and table != "evaluations":
        raise typer.BadParameter("--measures needs --table evaluations")
    given = {"where": where, "weights": weights, "score": score, "variant": variant, "base": base}
    given |= {"measures": "true" if measures else None}
    query = {name: value for name, value in given.items() if value}
    with connect(url) as client:
        campaign = client.campaign(identifier)
        is_front = len(campaign.spec.get("objectives") or []) > 1 and score is variant is None
        table = "front" if is_single and given_table is None and is_front else table
        if is_single:
            pieces = iter([_calibration_file(client, campaign.id, table, form, row or 1, names, query)])
        else:
            pieces = _pieces(client, campaign.id, table, form, query)
        if output == "-":
            if form == "parquet" and sys.stdout.isatty():
                raise InvalidInputError(Problem("--output", "a terminal cannot show Parquet", "give -o FILE"))
            _print(pieces, sys.stdout)
            return
        size = 0
        with _whole_or_not_at_all(Path(output)) as stream:
            for piece in pieces:
                size += stream.write(piece)
    say(f"{output}: {f'set {row or 1} of ' if is_single else ''}{table}, {size:,} bytes")


def _format_of(output: str) -> Format:
    """Returns the format that a file's ending names; csv for standard output, and for a file without an ending."""
    ending = Path(output).suffix.removeprefix(".").lower()
    if ending and ending not in get_args(Format):
        raise typer.BadParameter(f"no format has the ending of {output}: give --format {', '.join(get_args(Format))}")
    return cast("Format", ending or "csv")


class _Quoting(yaml.SafeDumper):
    """Writes texts in quotes: without them some readers take `08` or `1e3` for a number."""


_Quoting.add_representer(str, lambda dumper, text: dumper.represent_scalar("tag:yaml.org,2002:str", text, style='"'))


def _calibration_file(
    client: Client, identifier: str, table: TableName, form: Format, row: int, names: str | None, query: Mapping[str, Any]
) -> bytes:
    """Returns the set of a rank as a calibration file, or as JSON or YAML for `drivecal check`."""
    if form == "parquet":
        raise InvalidInputError(Problem("--format", "parquet holds no single set", "give dcm, cdfx, yaml, csv or json"))
    if form in {"json", "yaml"} and (names is not None or "base" in query):
        raise InvalidInputError(Problem("--names, --base", f"a set as {form} has its parameters alone", "leave them out"))
    if table not in {"solutions", "front"}:
        raise InvalidInputError(Problem("--table", f"{table} holds no ranked sets", "give --table solutions or front"))
    if "where" in query:
        raise InvalidInputError(Problem("--where", "a single set is chosen by its rank", "give --row, and --weights if wanted"))
    if form == "json" or form == "yaml":  # mypy narrows by these
        chosen = next(islice(client.rows(identifier, table, **query), row - 1, None), None)
        if chosen is None:
            raise NotFoundError("set", f"{identifier}#{row}", "fewer sets are ranked")
        whole = {each.name for each in client.setup(identifier).parameters if each.kind == "integer"}
        document = {
            "parameters": {name: int(value) if name in whole else value for name, value in chosen["parameters"].items()}
        }
        written = json.dumps(document, ensure_ascii=False, indent=1) + "\n"
        return (
            written if form == "json" else yaml.dump(document, Dumper=_Quoting, sort_keys=False, allow_unicode=True)
        ).encode()
    labels = {} if names is None else labels_of(read_document(names))
    rank, front = (None, row) if table == "front" else (row, None)
    given = {name: value for name, value in query.items() if name in {"weights", "score", "variant", "base"}}
    return client.calibration_file(identifier, form, rank, front, labels=labels, **given)


def _pieces(client: Client, identifier: str, table: TableName, form: Format, query: Mapping[str, Any]) -> Iterator[bytes]:
    if form in ("csv", "parquet"):
        yield from client.table(identifier, table, form, **query)
        return
    separator = "["
    for row in client.rows(identifier, table, **query):
        yield f"{separator}\n{json.dumps(row, ensure_ascii=False)}".encode()
        separator = ","
    yield b"\n]\n" if separator == "," else b"[]\n"


def _print(pieces: Iterator[bytes], stream: TextIO) -> None:
    """Writes a file to standard output; on a terminal, without what that would obey."""
    for piece in harmless_text(pieces) if stream.isatty() else pieces:
        stream.buffer.write(piece)
    stream.buffer.flush()


@contextmanager
def _whole_or_not_at_all(path: Path) -> Iterator[BinaryIO]:
    """Opens a file that appears under its name only when it is complete. Devices and pipes are written as they are."""
    is_special = path.exists() and not path.is_file()  # before links are followed: /dev/stdout links to nothing
    path = path if is_special else path.resolve()
    written = path if is_special else path.with_name(f".{path.name[:40]}.{os.getpid()}.part")
    try:
        with file_faults(path, "written", "give another file"):
            with written.open("wb") as stream:
                yield stream
            if not is_special:
                if path.exists():
                    shutil.copymode(path, written)
                written.replace(path)
    finally:
        if not is_special:
            written.unlink(missing_ok=True)


TABLES: tuple[TableName, ...] = ("generations", "solutions", "front", "influence", "robustness", "validation")
"""Tables of a report."""


@app.command()
@asking
def report(
    client: Client,
    identifier: CampaignArgument,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="The folder; made if it is missing.")],
) -> Asked:
    """Write a campaign's results as one page that needs no server, index.html, its tables (CSV) and its specification."""
    campaign = client.campaign(identifier)
    page = client.report(campaign.id)
    files = {f"tables/{name}.csv": b"".join(client.table(campaign.id, name, "csv")) for name in TABLES}
    files |= {"campaign.json": json.dumps(campaign.spec, indent=2, ensure_ascii=False).encode() + b"\n", "index.html": page}
    with file_faults(output, "written", "give another folder"):
        (output / "tables").mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            with _whole_or_not_at_all(output / name) as stream:
                stream.write(content)
    written = [str(output / name) for name in files]
    text = f"{written[-1]}: the report, with {len(written) - 1} files beside it"
    return {"campaign": campaign.id, "page": written[-1], "files": written}, lambda: typer.echo(text)
