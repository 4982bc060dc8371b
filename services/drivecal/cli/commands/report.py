"""The commands that write reports and review sheets, and verify a sheet."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from drivecal.cli.application import CampaignArgument, ExitCode, JsonOption, UrlOption, app, campaign_ids, connect, tell
from drivecal.cli.views.output import print_json
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.report.review.content import differences, digest_in, read_sheet
from drivecal.report.whole import read_report, write

MOST_PRINTED = 50
"""Differences that are printed; --json has all."""
LARGEST = 64 * 2**20


@app.command()
def report(
    identifier: CampaignArgument,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="The folder to write to; created if it is missing.")
    ],
    url: UrlOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write a campaign's, or a comparison's, figures (SVG and PNG), tables (CSV) and one self-contained page, index.html."""
    with connect(url) as client:
        whole = read_report(client, client.full_id(identifier))
        written = write(whole, output)
    if as_json:
        print_json({"campaign": whole.data.campaign.id, "page": str(written[-1]), "files": [str(path) for path in written]})
    else:
        typer.echo(f"{written[-1]}: the report, with {len(written) - 1} files beside it")


@app.command()
def review(
    identifier: Annotated[
        str | None,
        typer.Argument(
            metavar="ID", help="The campaign's id, or at least its first four characters.", autocompletion=campaign_ids
        ),
    ] = None,
    rank: Annotated[
        int | None, typer.Option("--set", min=1, metavar="N", help="The set of this rank in the solutions.")
    ] = None,
    front: Annotated[int | None, typer.Option(min=1, metavar="N", help="The set of this rank on the front.")] = None,
    against: Annotated[
        str | None,
        typer.Option(
            metavar="N, ID or ID:N", help="Another set beside it: by its rank in the same table, or of another campaign."
        ),
    ] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", metavar="FILE.html", help="The file to write.")] = None,
    verify: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="Compare a sheet with its campaign instead; exit status 1 if anything differs."),
    ] = None,
    url: UrlOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write a chosen set as one page to check, print and sign, or verify such a page."""
    if verify is not None:
        if identifier is not None or output is not None or rank is not None or front is not None or against is not None:
            raise typer.BadParameter("--verify takes the campaign and the set from the file, and no other option")
        _verify(verify, url, as_json)
        return
    if identifier is None or output is None:
        raise typer.BadParameter("give a campaign's ID and -o FILE.html, or --verify FILE.html")
    if rank is not None and front is not None:
        raise typer.BadParameter("give --set or --front")
    with connect(url) as client:
        campaign = client.full_id(identifier)
        page = client.review(campaign, rank, front, against)
    try:
        output.write_bytes(page.encode())
    except OSError as error:
        reason = error.strerror or str(error)
        raise InvalidInputError(Problem(str(output), f"it cannot be written: {reason}", "give another file")) from error
    digest = digest_in(page)
    if as_json:
        print_json({"campaign": campaign, "file": str(output), "digest": digest})
    else:
        typer.echo(f"{output}: digest {digest}")


def _verify(file: Path, url: str | None, as_json: bool) -> None:
    text = _text(file)
    sheet = read_sheet(text, str(file))
    given = sheet.query
    with connect(url) as client:
        ranks = {name: int(given[name]) for name in ("set", "front") if given.get(name, "").isdecimal()}
        page = client.review(sheet.campaign, ranks.get("set"), ranks.get("front"), given.get("against"))
    now = read_sheet(page, "the server's answer")
    different = list(differences(text, page))
    equal = sheet.is_unchanged and sheet.digest == now.digest
    if as_json:
        print_json(
            {
                "campaign": sheet.campaign,
                "equal": equal,
                "unchanged": sheet.is_unchanged,
                "digest": sheet.digest,
                "digest_now": now.digest,
                "differences": [{"place": each.place, "file": each.first, "now": each.second} for each in different],
            }
        )
    else:
        if not sheet.is_unchanged:
            tell(f"{file} was changed after it was written: its content does not have the digest that it names")
        for each in different[:MOST_PRINTED]:
            typer.echo(f"{each.place}: {each.first or 'nothing'} in the file, {each.second or 'nothing'} now")
        if len(different) > MOST_PRINTED:
            tell(f"{len(different) - MOST_PRINTED:,} more differences; --json has all")
        if sheet.version != now.version:
            tell(f"drivecal {sheet.version} wrote the file and the server is {now.version}: wording and layout may differ")
        typer.echo(f"equal: {sheet.digest}" if equal else f"different: {sheet.digest} in the file, {now.digest} now")
    raise typer.Exit(ExitCode.OK if equal else ExitCode.FAILED)


def _text(file: Path) -> str:
    try:
        with file.open("rb") as stream:
            return stream.read(LARGEST).decode()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else "it is no text in UTF-8"
        raise InvalidInputError(Problem(str(file), f"it cannot be read: {reason}", "give a review sheet")) from error
