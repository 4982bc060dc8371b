"""Checks of a whole manifest beyond single fields. All problems are reported at once."""

import keyword
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from difflib import get_close_matches
from typing import Any

from drivecal.bundles.archives import MANIFEST, BundleFile
from drivecal.bundles.expressions import Constraint, Formula
from drivecal.bundles.highway import FmuController, HighwaySimulator, PlannerController, ProcessController, PythonController
from drivecal.bundles.highway_checks import (
    files_named,
    measures_problems,
    planner_problems,
    scenarios_problems,
    simulator_problems,
    task_problems,
)
from drivecal.bundles.manifest import (
    AnySimulator,
    CommandSimulator,
    FmuSimulator,
    Manifest,
    ProcessSimulator,
    PythonSimulator,
    ScoreEntry,
)
from drivecal.bundles.shapes import with_coefficients
from drivecal.contracts import strict_json
from drivecal.contracts.input_errors import nearest, validated
from drivecal.contracts.specification import ParameterEntry
from drivecal.contracts.strict_json import shown
from drivecal.contracts.tables import parameter_column
from drivecal.domain.constraints import Constraints
from drivecal.domain.errors import InvalidInputError, Problem, attempted, problems_of
from drivecal.domain.evaluations import Breakdown
from drivecal.domain.parameters import Parameter, ParameterSpace
from drivecal.domain.values import decimal
from drivecal.plugins import registry

Files = Mapping[str, BundleFile]
"""Files of a bundle by path."""
OWN_FOLDERS = ("HOME", "TMPDIR", "TMP", "TEMP")
"""Variables that name an empty folder for each simulator."""
_SECRET = re.compile(r"(?!.*_LICENSE).*(PASSWORD|PASSWD|PASSPHRASE|TOKEN|SECRET|CREDENTIAL|APIKEY|_KEY(_|$))", re.IGNORECASE)
"""Names of variables that usually hold secrets. Variables for licences stay allowed."""
MOST_PARAMETERS = 200
"""Numbers that a search moves, as many as entries of `parameters`."""
LONGEST_NAME = 64
"""Characters of a name, as of `Identifier`."""
WITH_FILES = (PythonSimulator, FmuSimulator, PythonController, FmuController)
"""Sections that name a Python file or an FMU."""
_DIGEST = re.compile(r"[0-9a-f]{64}")
_REDUCTION = re.compile(r"(?:last|min|max|mean|integral)\(\s*\S(?:.*\S)?\s*\)")
_PLACEHOLDERS: Mapping[str, Any] = {
    "problem": "x",
    "description": "",
    "parameters": {"x": {"lower": 0, "upper": 1}},
    "added": {},
    "removed": {},
    "renamed": {},
    "varied": {},
    "constraints": [],
    "baseline": None,
    "simulator": {"kind": "python", "file": MANIFEST},
    "scenarios": {"x": {}},
    "measures": {"x": "1"},
    "failures": [],
    "series": {},
    "scores": {"x": {"formula": "0", "direction": "maximise", "range": [0, 1]}},
}
"""Valid sections that stand for faulty ones while the others are checked."""


def checked(document: object, files: Files | None = None, taken: Collection[str] | None = None) -> Manifest:
    """Returns a checked manifest. Raises InvalidInputError with all problems.

    Args:
        document: the content of `problem.yaml`.
        files: the bundle's files, None if they are not known.
        taken: names that the problem must not have, by default the names of the installed problems.
    """
    strict_json.check_plain(document)
    try:
        manifest = validated(Manifest, document)
        problems, faulty = [], set[str]()
    except InvalidInputError as error:
        problems = [_cut_formula(problem) for problem in error.problems]
        faulty = {re.split(r"[.\[]", problem.field)[0] for problem in problems}
        if not isinstance(document, dict):
            raise
        faulty |= {name for name, field in Manifest.model_fields.items() if field.is_required()} - document.keys()
        if not faulty <= _PLACEHOLDERS.keys() | document.keys():
            raise
        sound = {name: section for name, section in document.items() if name in _PLACEHOLDERS}
        manifest = Manifest.model_validate(sound | {name: _PLACEHOLDERS[name] for name in faulty & _PLACEHOLDERS.keys()})
    if "problem" not in faulty:
        problems += _problem_name(manifest.problem, registry.names(registry.PROBLEMS) if taken is None else taken)
    problems += _semantic_problems(manifest, faulty, files)
    if problems:
        raise InvalidInputError(*dict.fromkeys(problems))
    return manifest


def _cut_formula(problem: Problem) -> Problem:
    """Returns a better remedy if YAML has cut a formula at its comma, as in `{formula: max(a, b), ...}`."""
    is_cut = problem.field.startswith("scores.") and problem.field.endswith(")") and problem.message == "there is no such field"
    return replace(problem, remedy="put a formula with commas into quotes") if is_cut else problem


def _semantic_problems(manifest: Manifest, faulty: set[str], files: Files | None) -> Iterator[Problem]:
    checks = (
        ({"parameters"}, _parameters(manifest)),
        ({"parameters"}, _names("parameters", manifest.parameters)),
        ({"varied"}, _names("varied", manifest.varied)),
        ({"measures"}, _names("measures", manifest.measures)),
        ({"parameters", "varied"}, _varied(manifest)),
        ({"parameters", "added", "removed", "renamed"}, _claims(manifest)),
        ({"parameters", "constraints"}, _constraints(manifest)),
        ({"parameters", "baseline"}, _baseline(manifest)),
        ({"parameters", "baseline", "constraints"}, _feasibility(manifest)),
        ({"parameters", "baseline", "constraints"}, _remainder(manifest)),
        ({"simulator"}, _simulator(manifest.simulator, files)),
        ({"simulator", "measures"}, _fmu_measures(manifest)),
        ({"simulator", "scenarios"}, _highway_scenarios(manifest, files)),
        ({"simulator", "scenarios", "parameters", "varied"}, _planner(manifest)),
        ({"simulator", "scenarios", "measures", "series", "failures"}, _highway_answers(manifest)),
        ({"scenarios"}, _scenario_resources(manifest)),
        ({"failures"}, _failures(manifest.failures)),
        ({"scores"}, _ranges(manifest.scores)),
        ({"scores", "measures"}, _formulas(manifest)),
    )
    for sections, problems in checks:
        if not sections & faulty:
            yield from problems


def _problem_name(name: str, taken: Collection[str]) -> Iterator[Problem]:
    if name in taken:
        yield Problem("problem", f"{name} is an installed problem", "give another name")
    elif _DIGEST.fullmatch(name):
        yield Problem("problem", f"{shown(name)} looks like a digest", "give another name")


def _parameters(manifest: Manifest) -> Iterator[Problem]:
    columns: dict[str, str] = {}
    owner = {coefficient: name for name, shape in manifest.shapes.items() for coefficient in shape.names}
    for name in owner.keys() & manifest.parameters.keys():
        yield Problem(f"parameters.{name}", f"{owner[name]} has a coefficient of this name", "give it another name")
    for name, shape in manifest.shapes.items():
        if others := {owner[each] for each in shape.names} - {name}:
            yield Problem(f"parameters.{name}", f"{others.pop()} has coefficients of the same names", "give it another name")
    for name in {owner[each] for each in owner if len(each) > LONGEST_NAME}:
        message = f"names of its coefficients are longer than {LONGEST_NAME} characters"
        yield Problem(f"parameters.{name}", message, "give it a shorter name")
    if len(manifest.scalars) > MOST_PARAMETERS:
        message = f"with each coefficient there are {len(manifest.scalars)} numbers to search"
        yield Problem("parameters", message, f"give fewer `coefficients`: at most {MOST_PARAMETERS} in all")
    for name, entry in manifest.scalars.items():
        for problem in problems_of(_declared(name, entry)):
            yield replace(problem, field=f"parameters.{owner.get(name, name)}{problem.field.removeprefix(name)}")
        column = parameter_column(name)
        if column in columns:
            message = f"{name} and {columns[column]} would share the column {column} of the tables"
            yield Problem(f"parameters.{name}", message, "give it another name")
        columns[column] = name


def _names(section: str, names: Iterable[str]) -> Iterator[Problem]:
    for name in names:
        if any(map(keyword.iskeyword, name.split("."))):
            yield Problem(f"{section}.{name}", f"{name} cannot stand in a formula", f"give it another name, such as {name}_")


def _varied(manifest: Manifest) -> Iterator[Problem]:
    for name, entry in manifest.varied.items():
        field = f"varied.{name}"
        if name in {*manifest.parameters, *manifest.scalars}:
            yield Problem(field, f"{name} is a parameter, too", "give one of them another name")
        if not entry.lower < entry.upper:
            yield Problem(f"{field}.lower", f"{entry.lower:g} is not below {entry.upper:g}", "give the smaller number")
        elif not entry.lower <= entry.nominal <= entry.upper:
            message = f"{entry.nominal:g} lies outside of {entry.lower:g} to {entry.upper:g}"
            yield Problem(f"{field}.nominal", message, "give a value of the range")


def _claims(manifest: Manifest) -> Iterator[Problem]:
    present = list(manifest.parameters)
    for name, value in manifest.added.items():
        if name not in manifest.parameters:
            yield Problem(f"added.{name}", "there is no such parameter", nearest(name, present))
            continue
        made = attempted(with_coefficients, {name: value}, manifest.shapes, "added")
        yield from problems_of(made)
        for scalar, number in made.items() if isinstance(made, dict) else ():
            yield from _value(f"added.{name}", _declared(scalar, manifest.scalars[scalar]), number)
    for name in manifest.removed:
        if name in manifest.parameters:
            yield Problem(f"removed.{name}", f"{name} is a parameter still", "leave it out, or remove the parameter")
    for name, old in manifest.renamed.items():
        if name not in manifest.parameters:
            yield Problem(f"renamed.{name}", "there is no such parameter", nearest(name, present))
        if old in manifest.parameters:
            yield Problem(f"renamed.{name}", f"{old} is a parameter still", "give the name that the parameter had before")
        elif list(manifest.renamed.values()).count(old) > 1 or old in manifest.removed or name in manifest.added:
            message = f"another claim speaks of {name} or {old} as well"
            yield Problem(f"renamed.{name}", message, "give each parameter one claim")


def _declared(name: str, entry: ParameterEntry) -> Parameter | InvalidInputError:
    return attempted(Parameter.declared, name, **entry.model_dump())


def choices_of(manifest: Manifest) -> dict[str, tuple[str, ...]]:
    """Returns the choices of each parameter, empty for numbers, as constraints take them."""
    return {name: tuple(entry.choices or ()) for name, entry in manifest.scalars.items()}


def _parsed_constraints(manifest: Manifest) -> list[Constraint | InvalidInputError]:
    known = choices_of(manifest)
    return [attempted(Constraint, each, known, f"constraints[{place}]") for place, each in enumerate(manifest.conditions)]


def _constraints(manifest: Manifest) -> Iterator[Problem]:
    for constraint in _parsed_constraints(manifest):
        yield from problems_of(constraint)


def _baseline(manifest: Manifest) -> Iterator[Problem]:
    if manifest.baseline is None:
        return
    start = attempted(lambda: manifest.start or {})
    if isinstance(start, InvalidInputError):
        yield from start.problems
        return
    for name, value in start.items():
        if name not in manifest.scalars:
            yield Problem(f"baseline.{name}", "there is no such parameter", nearest(name, list(manifest.parameters)))
        else:
            yield from _value(f"baseline.{name}", _declared(name, manifest.scalars[name]), value)
    for name in manifest.scalars:
        if name not in start:
            yield Problem(f"baseline.{name}", "the value is missing", "give one value per parameter")


def _value(field: str, parameter: Parameter | InvalidInputError, value: float | str) -> Iterator[Problem]:
    if isinstance(parameter, Parameter):  # else its own problems are reported
        yield from problems_of(attempted(parameter.index, value if isinstance(value, str) else decimal(value), field))


def _feasibility(manifest: Manifest) -> Iterator[Problem]:
    if manifest.baseline is None or list(_baseline(manifest)):
        return
    for constraint in _parsed_constraints(manifest):
        if isinstance(constraint, Constraint) and not constraint.holds(manifest.start or {}):
            yield Problem("baseline", f"it breaks the constraint {shown(constraint.text)}", "change it, or the constraint")


def _remainder(manifest: Manifest) -> Iterator[Problem]:
    """Yields the constraints that leave nothing. A baseline that keeps them proves that something is left; without one, sets are tried."""
    parsed = _parsed_constraints(manifest)
    parameters = [_declared(name, entry) for name, entry in manifest.scalars.items()]
    known = tuple(parameter for parameter in parameters if isinstance(parameter, Parameter))
    constraints = [constraint for constraint in parsed if isinstance(constraint, Constraint)]
    if manifest.baseline is not None or not parsed or len(known) < len(parameters) or len(constraints) < len(parsed):
        return
    space = ParameterSpace(known)
    kept = Constraints(space, {each.text: each for each in constraints})
    for problem in problems_of(attempted(kept.region, 0 * space.n_values, space.n_values - 1)):
        yield replace(problem, remedy=f"{problem.remedy}, or give a `baseline` that keeps them: a trial proves nothing")


def _scenario_resources(manifest: Manifest) -> Iterator[Problem]:
    for name, data in manifest.scenarios.items():
        if "resources" in data:
            message = f"{shown(str(data['resources']))} does not say how many of each resource a run holds"
            yield Problem(f"scenarios.{name}.resources", message, "give whole numbers by name, such as {carmaker: 1}")


def _failures(names: tuple[str, ...]) -> Iterator[Problem]:
    reserved = {breakdown.value for breakdown in Breakdown}
    for index, name in enumerate(names):
        if name in reserved:
            message = f"{name} means that a run has no result"
            yield Problem(f"failures[{index}]", message, "give a failure of the system under test another name")
        elif name in names[:index]:
            yield Problem(f"failures[{index}]", f"{name} appears twice", "give each failure once")


def _ranges(scores: Mapping[str, ScoreEntry]) -> Iterator[Problem]:
    for name, score in scores.items():
        field, (lower, upper) = f"scores.{name}", score.range
        if upper <= lower:
            yield Problem(f"{field}.range", f"the end {upper:g} is not above the start {lower:g}", "give the smaller one first")
        elif score.failed is not None and not (
            score.failed <= lower if score.direction == "maximise" else score.failed >= upper
        ):
            end = "at most" if score.direction == "maximise" else "at least"
            message = f"{score.failed:g} would let failed runs win over others"
            yield Problem(f"{field}.failed", message, f"give {end} {score.worst:g}, or leave it out")


def _formulas(manifest: Manifest) -> Iterator[Problem]:
    for name, score in manifest.scores.items():
        if score.formula is not None:
            yield from problems_of(attempted(Formula, score.formula, manifest.measures, f"scores.{name}.formula"))


def _fmu_measures(manifest: Manifest) -> Iterator[Problem]:
    if not isinstance(manifest.simulator, FmuSimulator):
        return
    reported = manifest.simulator.measures
    for name in [name for name in reported if name not in manifest.measures]:
        remedy = f"add it to `measures` with its unit; {nearest(name, list(manifest.measures))}"
        yield Problem(f"simulator.measures.{name}", "the measure is not declared", remedy)
    for name in [name for name in manifest.measures if name not in reported]:
        yield Problem(f"measures.{name}", "the simulator does not report it", "add it to `simulator.measures`, e.g. last(x)")


def _simulator(simulator: Any, files: Files | None) -> Iterator[Problem]:
    if isinstance(simulator, ProcessSimulator | CommandSimulator):
        yield from _command("simulator.command", simulator.command, files)
    if isinstance(simulator, CommandSimulator):
        yield from _placeholders(simulator.command)
    yield from _code("simulator", simulator, files)
    if isinstance(simulator, HighwaySimulator):
        yield from simulator_problems(simulator)
        yield from _code("simulator.controller", simulator.controller, files)
        if isinstance(simulator.controller, ProcessController):
            yield from _command("simulator.controller.command", simulator.controller.command, files)
    if isinstance(simulator, FmuSimulator):
        for name, reduction in simulator.measures.items():
            if not _REDUCTION.fullmatch(reduction):
                remedy = "give last(x), min(x), max(x), mean(x) or integral(x) of an output x"
                yield Problem(f"simulator.measures.{name}", f"{shown(reduction)} is not a reduction of an output", remedy)
        if simulator.step > simulator.duration:
            yield Problem("simulator.step", "the step is longer than the duration", f"give at most {simulator.duration:g}")
    for index, name in enumerate(simulator.environment or ()):
        if name.upper().startswith(("DRIVECAL", "RAY")):
            yield Problem(f"simulator.environment[{index}]", f"{name} is a variable of the worker itself", "leave it out")
        elif _SECRET.match(name):
            remedy = "leave it out; if simulators may know it, give it another name on the workers, such as TOOL_LICENSE"
            yield Problem(f"simulator.environment[{index}]", f"{name} may hold a secret of the worker", remedy)
        elif name in OWN_FOLDERS:
            remedy = "leave it out; give the tool the whole path, or export the variable in a wrapper script"
            yield Problem(f"simulator.environment[{index}]", f"drivecal sets {name} to an empty folder", remedy)
    if simulator.probe is not None:
        yield from _command("simulator.probe", simulator.probe, files)
    for index, given in enumerate(simulator.inputs or ()):
        if isinstance(given, list):
            yield from _command(f"simulator.inputs[{index}]", given, files)


def _code(field: str, section: Any, files: Files | None) -> Iterator[Problem]:
    """Yields the faults of the Python file or FMU that a simulator or controller names."""
    if not isinstance(section, WITH_FILES):
        return
    ending = ".py" if section.kind == "python" else ".fmu"
    yield from _file(f"{field}.file", section.file, files)
    if not section.file.endswith(ending):
        yield Problem(f"{field}.file", f"{shown(section.file)} is no {ending} file", f"give the path of a {ending} file")
    if isinstance(section, PythonSimulator | PythonController) and section.wheels is not None:
        folder = section.wheels.removesuffix("/") + "/"
        yield from _file(f"{field}.wheels", folder, files and [folder for name in files if name.startswith(folder)])


def _planner(manifest: Manifest) -> Iterator[Problem]:
    if isinstance(manifest.simulator, HighwaySimulator) and isinstance(manifest.simulator.controller, PlannerController):
        yield from planner_problems(manifest.simulator.controller, manifest.scalars, manifest.varied)


def _highway_scenarios(manifest: Manifest, files: Files | None) -> Iterator[Problem]:
    if isinstance(manifest.simulator, HighwaySimulator):
        yield from scenarios_problems(manifest.simulator.step, manifest.scenarios)
        yield from task_problems(manifest.simulator.controller, manifest.scenarios)
        for field, path in files_named(manifest.scenarios):
            yield from _file(field, path, files)


def _highway_answers(manifest: Manifest) -> Iterator[Problem]:
    if isinstance(manifest.simulator, HighwaySimulator):
        yield from measures_problems(manifest.measures, manifest.series, manifest.failures, has_planner=manifest.has_planner)


def _command(field: str, words: list[str], files: Files | None) -> Iterator[Problem]:
    program = words[0]
    for index, word in enumerate(words):
        if "\x00" in word:
            yield Problem(f"{field}[{index}]", "a word holds a NUL character", "leave it out")
        elif word.startswith(("./", "../")) or (index == 0 and "/" in word and not word.startswith("/")):
            yield from _file(f"{field}[{index}]", word.removeprefix("./"), files)
    if files is None or program.startswith("/"):
        return
    path = program.removeprefix("./")
    if "/" not in program and program in files:
        yield Problem(f"{field}[0]", f"{program} without ./ is sought on PATH", f"give ./{program} for the file of the bundle")
    elif "/" in program and path in files and not files[path].executable:
        yield Problem(f"{field}[0]", f"the file {shown(path)} is not executable", f"type: chmod +x {shown(path)}")


def script_problems(simulator: AnySimulator, files: Files) -> Iterator[Problem]:
    """Yields the commands that begin with a script whose first line ends as on Windows: no machine has such an interpreter."""
    parts: list[tuple[str, Any]] = [("simulator", simulator)]
    if isinstance(simulator, HighwaySimulator):
        parts.append(("simulator.controller", simulator.controller))
    for part, section in parts:
        for field in ("command", "probe"):
            path = (getattr(section, field, None) or [""])[0].removeprefix("./")
            line = files[path].content[:256].partition(b"\n")[0] if path in files else b""
            if line.startswith(b"#!") and line.endswith(b"\r"):
                remedy = f"convert its line ends, e.g. sed -i 's/\\r$//' {shown(path)}"
                yield Problem(f"{part}.{field}[0]", f"the first line of {shown(path)} ends as on Windows", remedy)


def _file(field: str, path: str, files: Collection[str] | None) -> Iterator[Problem]:
    if path.startswith(("/", "~")) or re.match(r"[A-Za-z]:", path):
        yield Problem(field, f"{shown(path)} is an absolute path", "give a path inside the folder of the problem")
    elif ".." in path.split("/"):
        yield Problem(field, f"{shown(path)} leaves the folder of the problem", "copy the file into the folder")
    elif "\\" in path:
        yield Problem(field, f"{shown(path)} has backslashes", "separate folders by /")
    elif files is not None and path not in files:
        close = get_close_matches(path, files, n=1)
        remedy = f"did you mean {close[0]}?" if close else "add it to the folder"
        yield Problem(field, f"the folder of the problem has no file {shown(path)}", remedy)


def _placeholders(command: list[str]) -> Iterator[Problem]:
    known = ("{parameters}", "{scenario}", "{results}", "{seed}")
    for index, word in enumerate(command):
        for placeholder in re.findall(r"\{[A-Za-z_]+\}", word):
            if placeholder not in known:
                yield Problem(
                    f"simulator.command[{index}]", f"{shown(placeholder)} is not a placeholder", nearest(placeholder, known)
                )
    for placeholder in ("{parameters}", "{results}"):
        if not any(placeholder in word for word in command):
            remedy = f'add "{placeholder}": the path of a JSON file'
            yield Problem("simulator.command", f"the program is not given {placeholder}", remedy)
