"""Commands about the calibration files of other tools."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from drivecal.calibration_data import files
from drivecal.calibration_data.characteristics import LARGEST_FILE
from drivecal.calibration_data.sections import Sections, chosen_by, joined, sections_of
from drivecal.cli.application import JsonOption, app, tell
from drivecal.cli.views.output import print_json
from drivecal.client.documents import read_document
from drivecal.domain.errors import InvalidInputError, Problem

NamesOption = Annotated[
    str | None, typer.Option("--names", metavar="MAP", help="A YAML file that binds names, e.g. a line P1: ACC_tGap_C.")
]


@app.command()
def parameters(
    sources: Annotated[
        list[str], typer.Argument(metavar="FILE...", help="A2L, DCM or CDFX files; what several say is taken from the last.")
    ],
    match: Annotated[
        list[str] | None, typer.Option(metavar="GLOB", help="Take these only, e.g. 'ACC_*'; may be repeated.")
    ] = None,
    names: NamesOption = None,
    span: Annotated[
        float,
        typer.Option(min=1e-6, max=1e3, help="Half the width of a range that no file gives, as a share of the value."),
    ] = 0.5,
    as_json: JsonOption = False,
) -> None:
    """Print the parameters of calibration files as sections of problem.yaml."""
    contents = [(source, files.read(_bytes(source), source)) for source in sources]
    labels = files.labels_of(read_document(names)) if names is not None else {}
    chosen = chosen_by(joined(content.characteristics for _, content in contents), match or [])
    sections = sections_of(chosen, {label: name for name, label in labels.items()}, span)
    if as_json:
        print_json({"parameters": sections.parameters, "baseline": sections.baseline})
    else:
        typer.echo("\n".join(_yaml(sections)))
    for source, content in contents:
        if content.skipped:
            tell(
                f"{source}: {len(content.skipped):,} curves, maps, other arrays, variants and values that follow from others are left out"
            )
    if sections.guessed:
        tell(f"no file has a usable range of {', '.join(sections.guessed)}: {span:.0%} around the value was taken; correct it")
    if sections.left_out:
        tell(f"no file has the choices of {', '.join(sections.left_out)}: left out; give an A2L with the enumeration, too")
    missing = sections.parameters.keys() - sections.baseline.keys()
    if missing and sections.baseline:
        tell(f"no file has a value of {', '.join(sorted(missing))}: complete the baseline, or remove it")


def _yaml(sections: Sections) -> Iterator[str]:
    yield "parameters:"
    for name, entry in sections.parameters.items():
        fields = ", ".join(f"{field}: {json.dumps(value, ensure_ascii=False)}" for field, value in entry.items())
        yield f"  {name}: {{{fields}}}"
    if sections.baseline:
        yield "baseline:"
        yield from (f"  {name}: {json.dumps(value, ensure_ascii=False)}" for name, value in sections.baseline.items())


def _bytes(file: str) -> bytes:
    try:
        with Path(file).open("rb") as stream:
            return stream.read(LARGEST_FILE + 1)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise InvalidInputError(Problem(file, f"it cannot be read: {reason}", "give an A2L, DCM or CDFX file")) from error
