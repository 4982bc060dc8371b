"""Writes new problems: a folder with a `problem.yaml` and a simulation that works, to be edited."""

import json
import re
import shutil
from collections.abc import Iterator, Mapping
from decimal import Decimal
from importlib import resources
from pathlib import Path

from drivecal.bundles.archives import MANIFEST, files_of
from drivecal.bundles.checks import checked
from drivecal.bundles.fmus.description import INTEGERS, FmuDescription, FmuVariable, read_fmu
from drivecal.bundles.installed import installed_problems
from drivecal.client.documents import located_yaml
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem, file_faults
from drivecal.domain.parameters import text

PLANNER = "highway-planner"
"""The built-in motorway as a start."""
KINDS = ("process", "command", "python", "python-random", "fmu", "highway", PLANNER)
MOST_ENTRIES = 20
"""Parameters and outputs of an FMU that are written out; further ones become comments."""
LONGEST, COARSEST = 1e6, 1e4
"""Largest duration and step of a problem's FMU (s)."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_.-]{0,63}")
_LARGEST = 1e6


def write_problem(kind: str, name: str, folder: str | Path | None = None, fmu: str | Path | None = None) -> list[Path]:
    """Writes a new problem into `folder`, by default one of its name, and returns its files.

    `fmu`: the FMU of a problem of that kind, whose parameters and outputs are filled in. Raises InvalidInputError.
    """
    path = Path(name if folder is None else folder)
    _check(kind, name, path, fmu)
    description = None if fmu is None else read_fmu(fmu)
    contents = _template(kind, name)
    file = "system.fmu" if fmu is None else Path(fmu).name
    if description is None:
        contents["problem.yaml"] = (
            contents["problem.yaml"].replace("NAME", name).replace("FOLDER", path.name).replace("FILE", file)
        )
    else:
        contents["problem.yaml"] = fmu_manifest(name, path.name, file, description)
    checked(located_yaml(contents["problem.yaml"].encode())[0])
    with file_faults(shown(str(path), 200), "written", "give another folder"):
        path.mkdir(parents=True, exist_ok=True)
        for inner, content in contents.items():
            (path / inner).write_text(content, encoding="utf-8")
        if fmu is not None:
            shutil.copyfile(fmu, path / file)
    return sorted(path.iterdir())


def _template(kind: str, name: str) -> dict[str, str]:
    """Returns the files of a template by name."""
    if kind != PLANNER:
        folder = resources.files("drivecal.client") / "templates" / kind
        return {file.name.removesuffix(".txt"): file.read_text(encoding="utf-8") for file in folder.iterdir() if file.is_file()}
    files = {name: file.content.decode() for name, file in files_of(installed_problems()["highway"].archive).items()}
    _, _, sections = files[MANIFEST].partition("\n\n")
    return files | {MANIFEST: f"problem: {name}\ndescription: The planner of drivecal on six roads of a motorway\n\n{sections}"}


def _check(kind: str, name: str, path: Path, fmu: str | Path | None) -> None:
    if kind not in KINDS:
        raise InvalidInputError(Problem("kind", f"{shown(kind)} is not one of the kinds", f"give {', '.join(KINDS)}"))
    if not _NAME.fullmatch(name):
        remedy = "start with a letter; go on with letters, digits, `_`, `.` or `-`"
        raise InvalidInputError(Problem("name", f"'{shown(name)}' is not a valid name", remedy))
    if fmu is not None and kind != "fmu":
        raise InvalidInputError(Problem("fmu", f"a problem of kind {kind} has no FMU", "leave it out, or give the kind fmu"))
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise InvalidInputError(Problem(shown(str(path), 200), "it exists already", "give another name, or remove it"))


def fmu_manifest(name: str, folder: str, file: str, description: FmuDescription) -> str:
    """Returns a `problem.yaml` for the FMU `file` in `folder`. Raises InvalidInputError if it has no usable parameter or output."""
    named: dict[str, FmuVariable] = {}
    for variable in description.parameters:
        if _NAME.fullmatch(variable.name) and _bounds(variable):
            named.setdefault(variable.name, variable)
    parameters = list(named.values())
    if not parameters:
        raise InvalidInputError(
            Problem(shown(file), "the FMU has no numeric parameter with a plain name", "export one as a parameter")
        )
    outputs: dict[str, FmuVariable] = {}
    for output in description.outputs:
        measure = f"{re.sub(r'[^A-Za-z0-9_]+', '_', output.name).strip('_')}_last"
        if output.is_number and _NAME.fullmatch(measure) and output.name.isprintable():
            outputs.setdefault(measure, output)
    others = [f"{shown(output.name, 60)} ({_kind(output)})" for output in description.outputs if not output.is_number]
    if not outputs:
        message = f"no output of the FMU is a single number: {', '.join(others[:5])}" if others else "the FMU has no output"
        raise InvalidInputError(
            Problem(shown(file), message, "export the signals that a score needs as outputs, one number each")
        )
    shown_outputs = dict(list(outputs.items())[:MOST_ENTRIES])
    wanted = description.duration or 10.0
    duration = min(wanted, LONGEST)
    step = description.step if description.step is not None and description.step > 0.0 else duration / 1000
    step = min(step, duration, COARSEST)
    lines = [
        "# Written from the FMU's description: keep the parameters to calibrate and correct their ranges, which are guesses if the FMU has",
        f"# none. Check it: drivecal problem check {folder}; send it to the server: drivecal problem push {folder}",
        f"problem: {name}",
        "parameters:",
        *_parameter_lines(parameters),
        *_left_out(description, named),
        "simulator:",
        "  kind: fmu",
        f"  file: {json.dumps(file)}",
        f"  duration: {_decimal(duration)} # s" + (f"; the FMU says {wanted:g}" if duration != wanted else ""),
        f"  step: {_decimal(step)} # s",
        "  timeout: 60 # s of real time",
        "  memory_mb: 2000",
        "  deterministic: true",
        "  measures: # last(y), min(y), max(y), mean(y) or integral(y) of an output y",
        *(
            f"    {measure}: {json.dumps(f'last({output.name})', ensure_ascii=False)}"
            for measure, output in shown_outputs.items()
        ),
        *(f"    # further output: {shown(output.name)}" for output in list(outputs.values())[MOST_ENTRIES:100]),
        *(f"    # output that is no single number: {other}" for other in others[:100]),
        "# Start values of further parameters and inputs, by name.",
        "scenarios:",
        "  nominal: {}",
        "measures:",
        *(f"  {measure}: {_quoted_unit(output)}" for measure, output in shown_outputs.items()),
        "scores:",
        f"  cost: {{formula: abs({next(iter(outputs))}), direction: minimise, range: [0, 100], tolerance: 1}}",
    ]
    return "\n".join(lines) + "\n"


def _parameter_lines(parameters: list[FmuVariable]) -> Iterator[str]:
    for index, parameter in enumerate(parameters[:200]):
        lower, upper = _bounds(parameter) or (0.0, 1.0)
        bounds = f"lower: {_plain(lower)}, upper: {_plain(upper)}" + (", integer: true" if parameter.whole else "")
        name = f'"{parameter.name}"' if parameter.name.lower() in {"true", "false", "null"} else parameter.name
        entry = f"{name}: {{{bounds}, unit: {_quoted_unit(parameter)}}}"
        comment = f" # {shown(parameter.description)}" if parameter.description else ""
        start = "" if parameter.start is None else f"{comment or ' #'} (start: {parameter.start:g})"
        yield f"  {'# ' if index >= MOST_ENTRIES else ''}{entry}{start or comment}"


def _left_out(description: FmuDescription, named: Mapping[str, FmuVariable]) -> Iterator[str]:
    """Yields a comment that counts the parameters that a problem cannot have."""
    kinds = {"parameter", "structuralParameter"}
    others = [shown(entry.name, 60) for entry in description.variables if entry.causality in kinds and entry.name not in named]
    if others:
        yield f"  # left out: {len(others)} texts, arrays, and parameters of unusable names or ranges, e.g. {', '.join(others[:5])}"


def _bounds(variable: FmuVariable) -> tuple[float, float] | None:
    """Returns the range of a parameter, guessed around its start if the FMU has none; None if it exceeds drivecal's numbers."""
    start = variable.start or 0.0
    reach = abs(start) / 2 or 1.0
    lower = start - reach if variable.lower is None else variable.lower
    upper = start + reach if variable.upper is None else variable.upper
    if variable.whole:
        least, most = (1, len(variable.items)) if variable.items else INTEGERS.get(variable.kind, INTEGERS["Int64"])
        lower, upper = float(max(int(lower), least)), float(min(int(upper) + (variable.upper is None), most))
    lower, upper = round(lower, 9), round(upper, 9)
    return (lower, upper) if -_LARGEST <= lower < upper <= _LARGEST else None


def _plain(value: float) -> str:
    return text(Decimal(str(value)))


def _decimal(value: float) -> str:
    """Returns a number without an exponent, which YAML would read as a text: `1e-05`."""
    return f"{Decimal(repr(value)):f}"


def _kind(output: FmuVariable) -> str:
    return f"an array of {output.kind}" if output.is_array else output.kind


def _quoted_unit(variable: FmuVariable) -> str:
    """Returns the unit as the FMU writes it, which the check compares; 1 if it does not fit into a manifest."""
    return json.dumps(variable.unit if shown(variable.unit, 32) == variable.unit else "1", ensure_ascii=False)
