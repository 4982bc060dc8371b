"""`drivecal check`: is a set still good?"""

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import isclose
from pathlib import Path
from typing import Annotated, Any, Self
from xml.etree.ElementTree import Element, SubElement, tostring

import typer
from pydantic import Field, model_validator

from drivecal.cli.application import ExitCode, JsonOption, UrlOption, app, code_of_state, connect, tell
from drivecal.cli.commands.evaluate import SECONDS_BETWEEN_QUESTIONS, ended
from drivecal.cli.views.output import print_columns, print_json
from drivecal.cli.views.progress import pauses
from drivecal.client.client import Client
from drivecal.configuration.documents import read_document
from drivecal.contracts.evaluation import EvaluatedCell, Evaluation
from drivecal.contracts.input_errors import validated
from drivecal.contracts.inventory import ProblemAnswer
from drivecal.contracts.setup import ShapeAnswer
from drivecal.contracts.specification import DECIDING, DEFAULT_PROBLEM, Given, GoalSpecification, Model
from drivecal.contracts.strict_json import Number
from drivecal.domain.errors import InvalidInputError, NotFoundError, Problem, file_faults
from drivecal.domain.scales import told

Parameters = Mapping[str, Given]
Axes = Mapping[str, Sequence[Sequence[float]]]
CALIBRATION_FILES = (".dcm", ".cdfx")


class SetLimit(GoalSpecification):
    """A limit of a score or measure in each of its scenarios."""

    at_least: Number | None = None
    at_most: Number | None = None
    worse_by_at_most: Annotated[float, Field(ge=0)] | None = None
    """Largest loss of a score against the baseline."""

    @model_validator(mode="after")
    def _has_a_limit(self) -> Self:
        if sum(bound is not None for bound in (self.at_least, self.at_most, self.worse_by_at_most)) != 1:
            raise ValueError("it needs one of at_least, at_most and worse_by_at_most")
        if self.worse_by_at_most is not None and self.score is None:
            raise ValueError("worse_by_at_most is a limit of a score; measures have no direction")
        if self.score is self.measure is None:
            raise ValueError("it is a limit of a score or a measure; leave changes and distance out")
        return self

    @property
    def text(self) -> str:
        """The limit in words."""
        if self.at_least is not None:
            return f"{self.label} at least {self.at_least:g}"
        if self.at_most is not None:
            return f"{self.label} at most {self.at_most:g}"
        return f"{self.label} at most {self.worse_by_at_most:g} worse than the baseline"


class LimitsFile(Model):
    """A file of limits."""

    limits: Annotated[list[SetLimit], Field(min_length=1, max_length=1000)]


@dataclass(frozen=True, slots=True)
class Finding:
    """A limit in a scenario. `broken` says why it does not hold, None if it does."""

    scenario: str
    limit: str
    broken: str | None


@dataclass(frozen=True, slots=True)
class CheckedSet:
    """A set: its cells and the baseline's cells by score and scenario, and its limits. The campaign's score comes first, or the
    problem's first one."""

    cells: Mapping[str, Mapping[str, EvaluatedCell]]
    baseline: Mapping[str, Mapping[str, EvaluatedCell]]
    problem: ProblemAnswer
    differing: int = 0
    """New runs that gave another result than the stored ones."""
    notes: Sequence[str] = ()

    @property
    def scenarios(self) -> Mapping[str, EvaluatedCell]:
        """The cells of the first score."""
        return next(iter(self.cells.values()))

    def findings(self, limits: Sequence[SetLimit]) -> Iterator[Finding]:
        """Yields a finding for each scenario, which needs a result, and for each limit in its scenarios."""
        for name, cell in self.scenarios.items():
            yield Finding(name, "has a result", None if cell.score is not None else cell.detail or cell.failure or "no result")
        for limit in limits:
            for name in self.scenarios if limit.scenarios == "all" else limit.scenarios:
                yield Finding(name, limit.text, self._broken(limit, name))
        if self.differing and self.problem.simulator.get("deterministic") is not False:
            counted = (
                f"{self.differing:,} runs gave another result; what they read besides the problem's files belongs into `inputs`"
            )
            yield Finding("all", "new runs give the stored results", counted)

    def _broken(self, limit: SetLimit, scenario: str) -> str | None:
        value = self._value(self.cells, limit, scenario)
        if value is None:
            return f"no value of {limit.label}"
        if limit.worse_by_at_most is None:
            low, high = limit.at_least, limit.at_most
            holds = (low is None or value >= low) and (high is None or value <= high)
        else:
            before = self._value(self.baseline, limit, scenario)
            if before is None:
                return f"the baseline has no value of {limit.label}"
            sign = -1 if self.problem.scores[limit.score or ""]["direction"] == "minimise" else 1
            holds = sign * (before - value) <= limit.worse_by_at_most
            if not holds:
                return f"{limit.label} is {told(value)}, and {told(before)} in the baseline"
        return None if holds else f"{limit.label} is {told(value)}"

    def _value(self, cells: Mapping[str, Mapping[str, EvaluatedCell]], limit: SetLimit, scenario: str) -> float | None:
        cell = (next(iter(cells.values())) if limit.score is None else cells[limit.score]).get(scenario)
        if cell is None or limit.score is not None:
            return None if cell is None else cell.score
        return (cell.metrics or {}).get(limit.measure or "")


@app.command()
def check(
    chosen: Annotated[str, typer.Argument(metavar="SET", help="A JSON, YAML, DCM or CDFX file, or ID#RANK of a campaign.")],
    problem: Annotated[str | None, typer.Option(help="The problem; by default the campaign's, or highway.")] = None,
    limits: Annotated[str | None, typer.Option(metavar="FILE", help="Limits of scores and measures, YAML or JSON.")] = None,
    baseline: Annotated[str | None, typer.Option(metavar="SET", help="A set to compare with, given as SET is.")] = None,
    names: Annotated[str | None, typer.Option(metavar="FILE", help="Labels of the parameters in DCM and CDFX files.")] = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Simulate the set and the baseline again.")] = False,
    junit: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the findings as JUnit XML.")] = None,
    summary: Annotated[Path | None, typer.Option(metavar="FILE", help="Append a summary in Markdown.")] = None,
    timeout: Annotated[float | None, typer.Option(min=0, help="Seconds to wait at most; then exit status 6.")] = None,
    url: UrlOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check whether a set keeps its limits in every scenario; exit status 1 if not. Only what changed is simulated."""
    wanted = [] if limits is None else validated(LimitsFile, dict(read_document(limits))).limits
    with connect(url) as client:
        parameters, spec, axes = _set(client, chosen, names)
        known = client.problem(problem or spec.get("problem", DEFAULT_PROBLEM))
        copied = DECIDING if problem is None else DECIDING - {"catalogue"}  # another push may have other scenarios
        settings = {name: spec[name] for name in copied if name in spec} | {"problem": known.digest}
        listed = settings.get("catalogue") or known.scenarios
        _refuse_other_axes(axes, known.shapes)
        _refuse_unknown(wanted, known, () if isinstance(listed, str) else listed, has_baseline=baseline is not None)
        evaluators = _evaluators(known, spec.get("evaluator"), wanted)
        own = parameters if spec and problem is None else known.parameters  # a driving function has its own
        wait = partial(ended, client, timeout=timeout, asking=pauses(SECONDS_BETWEEN_QUESTIONS, timeout))
        compared: dict[str, dict[str, EvaluatedCell]] = {}
        differing, notes = 0, list[str]()
        if baseline is not None:
            before, _, theirs = _set(client, baseline, names)
            _refuse_other_axes(theirs, known.shapes)
            values = _values(before, own, known.shapes)
            compared, differing, noted = _evaluated(client, settings | {"parameters": values}, evaluators, wait, fresh=fresh)
            notes += [f"baseline: {note}" for note in noted]
        document = settings | {"parameters": _values(parameters, own, known.shapes)}
        cells, more, noted = _evaluated(client, document, evaluators, wait, fresh=fresh)
    checked = CheckedSet(cells, compared, known, differing + more, [*notes, *noted])
    findings = list(checked.findings(wanted))
    if junit is not None:
        with file_faults(junit, "written", "give another file"):
            junit.write_bytes(_junit(chosen, findings))
    if summary is not None:
        with file_faults(summary, "written", "give another file"), summary.open("a", encoding="utf-8") as stream:
            stream.write(_markdown(chosen, checked, findings))
    broken = [finding for finding in findings if finding.broken is not None]
    if as_json:
        print_json(_document(checked, findings))
    else:
        print_columns(["scenario", "score", "baseline", "obtained", "broken"], _rows(checked, findings))
        for note in checked.notes:
            tell(f"note: {note}")
        for finding in broken:
            tell(f"{finding.scenario}: {finding.limit}: {finding.broken}")
    raise typer.Exit(ExitCode.FAILED if broken else ExitCode.OK)


def _set(client: Client, given: str, names: str | None) -> tuple[Parameters, Mapping[str, Any], Axes]:
    """Returns the values of a set, the specification of its campaign, empty for a file, and the points of its curves as far as known."""
    identifier, mark, rank = given.rpartition("#")
    if mark and rank.isdecimal() and int(rank) > 0:
        campaign = client.campaign(client.full_id(identifier))
        ranked = client.solutions(campaign.id, limit=int(rank)).items
        if len(ranked) < int(rank):
            raise NotFoundError("set", given, f"the campaign has {len(ranked)} ranked sets")
        shapes = client.setup(campaign.id).shapes
        return ranked[int(rank) - 1].parameters, campaign.spec, {name: shape.axes for name, shape in shapes.items()}
    if Path(given).suffix.lower() not in CALIBRATION_FILES:
        document = dict(read_document(given))
        return document.get("parameters", document), {}, {}
    from drivecal.calibration_data import files
    from drivecal.calibration_data.characteristics import INDEX
    from drivecal.calibration_data.sections import axis_points, joined

    with file_faults(Path(given), "read", "give another file"):
        content = Path(given).read_bytes()
    labels = {} if names is None else files.labels_of(dict(read_document(names)))
    by_label = {label: name for name, label in labels.items()}
    listed = joined([files.read(content, given).characteristics])
    axes = {
        by_label.get(each.name, each.name): [() if axis.kind == INDEX else axis.points for axis in each.axes]
        for each in listed
        if each.values
    }
    listed += axis_points(listed)
    return {by_label.get(each.name, each.name): each.given for each in listed if each.given is not None}, {}, axes


def _refuse_other_axes(given: Axes, shapes: Mapping[str, ShapeAnswer]) -> None:
    """Raises InvalidInputError if values belong to other points than in the problem; a parameter such as `gain.x` is such points."""
    for name, shape in shapes.items():
        for letter, own, points in zip("xy", given.get(name, ()), shape.axes, strict=False):
            same = all(isclose(one, other, rel_tol=1e-6, abs_tol=1e-6) for one, other in zip(own, points, strict=False))
            if not same and f"{name}.{letter}" not in shapes:
                message = f"it has other points on axis {letter} than in the problem"
                raise InvalidInputError(Problem(f"parameters.{name}", message, "give a set of this version of the problem"))


def _refuse_unknown(limits: Sequence[SetLimit], problem: ProblemAnswer, known: Collection[str], *, has_baseline: bool) -> None:
    """Raises InvalidInputError. `known`: names of the scenarios; empty if only the server knows the scenarios of a catalogue."""
    faults = []
    for number, limit in enumerate(limits):
        field = f"limits[{number}]"
        for kind, name, names in (("score", limit.score, problem.scores), ("measure", limit.measure, problem.measures)):
            if name is not None and name not in names:
                faults.append(
                    Problem(f"{field}.{kind}", f"{problem.name} has no {kind} {name!r}", f"one of {', '.join(names)}")
                )
        for name in () if limit.scenarios == "all" or not known else limit.scenarios:
            if name not in known:
                remedy = f"one of {', '.join(known)}"
                faults.append(Problem(f"{field}.scenarios", f"{problem.name} has no scenario {name!r}", remedy))
        if limit.worse_by_at_most is not None and not has_baseline:
            faults.append(Problem(f"{field}.worse_by_at_most", "there is no baseline", "give --baseline"))
    if faults:
        raise InvalidInputError(*faults)


def _evaluators(problem: ProblemAnswer, chosen: str | None, limits: Sequence[SetLimit]) -> dict[str, str]:
    """Returns the evaluators of the scores to check by score. `chosen` by a campaign, which comes first: a score, or an
    installed evaluator of the first score that has one; None for a file."""
    first = next(iter(problem.scores))
    if chosen in problem.scores:
        first = chosen
    elif chosen is None:
        chosen = first
    else:
        first = next((name for name, entry in problem.scores.items() if entry["evaluator"] is not None), first)
    return {first: chosen} | {limit.score: limit.score for limit in limits if limit.score not in {None, first}}


def _values(parameters: Parameters, names: Collection[str], shapes: Mapping[str, ShapeAnswer]) -> Parameters:
    """Returns the values of the named parameters, of curves and maps in the place of their coefficients; `parameters` may hold others
    as well. Raises InvalidInputError if one is missing."""
    owners = {each: name for name, shape in shapes.items() for each in shape.names}
    for name, shape in shapes.items():
        given = {each for each in parameters if re.fullmatch(rf"{re.escape(name)}(_\d+)+", each)}
        if given and name not in parameters and given != set(shape.names):
            message = f"{len(given)} coefficients are given, and {name} has {len(shape.names)}"
            raise InvalidInputError(Problem(f"parameters.{name}", message, f"give {name} as a list of its values"))
    names = dict.fromkeys(name if name in parameters else owners.get(name, name) for name in names)
    missing = [name for name in names if name not in parameters]
    if missing:
        remedy = "give one value per parameter; --names has the labels of a calibration file"
        raise InvalidInputError(*(Problem(f"parameters.{name}", "the value is missing", remedy) for name in missing))
    return {name: parameters[name] for name in names}


def _evaluated(
    client: Client,
    document: Mapping[str, Any],
    evaluators: Mapping[str, str],
    wait: Callable[[Evaluation], Evaluation],
    *,
    fresh: bool = False,
) -> tuple[dict[str, dict[str, EvaluatedCell]], int, list[str]]:
    """Returns the cells of a set by score and scenario, the number of new runs that differ from stored ones, and notes.

    With `fresh`, further scores rate the stored runs if the new ones are equal, and else new runs of their own.
    """
    cells: dict[str, dict[str, EvaluatedCell]] = {}
    differing, notes = 0, dict[str, None]()
    for score, evaluator in evaluators.items():
        simulates = fresh and (not cells or differing > 0)
        evaluation = wait(client.evaluate({**document, "evaluator": evaluator, "fresh": simulates}))
        cells[score] = _cells(evaluation)
        differing += evaluation.unrepeatable
        notes |= dict.fromkeys(evaluation.notes)
    return cells, differing, list(notes)


def _cells(evaluation: Evaluation) -> dict[str, EvaluatedCell]:
    if not evaluation.items:
        tell(f"the evaluation was not carried out: {evaluation.error or evaluation.state}")
        raise typer.Exit(code_of_state(evaluation.state))
    return {item.scenario: item for item in evaluation.items}


def _rows(checked: CheckedSet, findings: Sequence[Finding]) -> Iterator[list[object]]:
    before = next(iter(checked.baseline.values()), {})
    for name, cell in checked.scenarios.items():
        broken = "; ".join(finding.limit for finding in findings if finding.scenario == name and finding.broken is not None)
        yield [name, cell.score, before[name].score if name in before else None, cell.outcome, broken]


def _document(checked: CheckedSet, findings: Sequence[Finding]) -> dict[str, Any]:
    names = ("scenario", "score", "baseline", "obtained", "broken")
    return {
        "passed": all(finding.broken is None for finding in findings),
        "notes": list(checked.notes),
        "scenarios": [dict(zip(names, row, strict=True)) for row in _rows(checked, findings)],
        "findings": [{"scenario": finding.scenario, "limit": finding.limit, "broken": finding.broken} for finding in findings],
    }


def _junit(chosen: str, findings: Sequence[Finding]) -> bytes:
    failures = sum(finding.broken is not None for finding in findings)
    suite = Element("testsuite", name=f"drivecal check {chosen}", tests=str(len(findings)), failures=str(failures), errors="0")
    for finding in findings:
        case = SubElement(suite, "testcase", classname=finding.scenario, name=finding.limit)
        if finding.broken is not None:
            SubElement(case, "failure", message=finding.broken)
    document: bytes = tostring(suite, encoding="utf-8", xml_declaration=True)
    return document


def _markdown(chosen: str, checked: CheckedSet, findings: Sequence[Finding]) -> str:
    broken = sum(finding.broken is not None for finding in findings)
    simulated = sum(cell.outcome == "simulated" for cell in checked.scenarios.values())
    lines = [
        f"### {'Passed' if not broken else 'Failed'}: `{chosen}` on {checked.problem.name}",
        "",
        f"{len(findings) - broken} of {len(findings)} checks hold; {simulated} of {len(checked.scenarios)} scenarios were simulated.",
        "",
        "| scenario | score | baseline | obtained | broken |",
        "|---|---|---|---|---|",
    ]
    for row in _rows(checked, findings):
        shown = ["" if value is None else told(value) if isinstance(value, float | int) else str(value) for value in row]
        lines.append(f"| {' | '.join(text.replace('|', chr(92) + '|') for text in shown)} |")
    return "\n".join([*lines, "", ""])
