"""`drivecal check`: is a set still good?"""

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from statistics import fmean, stdev
from typing import Annotated, Any, Self
from xml.etree.ElementTree import Element, SubElement, tostring

import typer
from pydantic import Field, model_validator

from drivecal.calibration_data.characteristics import INDEX, Axis, Characteristic, other_units
from drivecal.cli.application import ExitCode, app, code_of_state, say
from drivecal.cli.commands.evaluate import SECONDS_BETWEEN_QUESTIONS, SeedsOption, VehicleOption, ended
from drivecal.cli.views.output import Asked, asking, print_columns, within_text
from drivecal.cli.views.progress import pauses
from drivecal.client.client import Client
from drivecal.configuration.documents import opened_document, read_document
from drivecal.contracts.assignments import assignments
from drivecal.contracts.evaluation import EvaluatedCell, Evaluation
from drivecal.contracts.input_errors import nearest, validated
from drivecal.contracts.inventory import ProblemAnswer
from drivecal.contracts.setup import ShapeAnswer
from drivecal.contracts.specification import DECIDING, DEFAULT_PROBLEM, ConstraintSpecification, Given, GoalSpecification, Model
from drivecal.contracts.strict_json import Number
from drivecal.contracts.tables import FrontRow, Solution
from drivecal.domain.errors import InvalidInputError, NotFoundError, Problem, file_faults
from drivecal.domain.rounding import grain
from drivecal.domain.scales import score_text
from drivecal.domain.setups import base_of

Parameters = Mapping[str, Given]
Axes = Mapping[str, Sequence[Sequence[float]]]
CALIBRATION_FILES = (".dcm", ".cdfx")
INTERVAL = ("standard_error", "lower", "upper")
OF_SEEDS = (*INTERVAL, "failures", "runs")
COLUMNS = ("scenario", "score", *OF_SEEDS, "baseline", "obtained", "broken")


@dataclass(frozen=True)
class GivenSet:
    """A set to check: `spec` and `baseline` of its campaign, empty for a file; `axes`: points of its curves; `seeds` that report it; `read`
    from a calibration file, with units and faults."""

    parameters: Parameters
    spec: Mapping[str, Any] = field(default_factory=dict)
    axes: Axes = field(default_factory=dict)
    seeds: Sequence[int] = ()
    read: Mapping[str, Characteristic] = field(default_factory=dict)
    baseline: Parameters = field(default_factory=dict)


class SetLimit(GoalSpecification):
    """A limit of a score or measure in each of its scenarios, or of the share of failed runs in all of them."""

    at_least: Number | None = None
    at_most: Number | None = None
    worse_by_at_most: Annotated[float, Field(ge=0)] | None = None
    """Largest loss of a score against the baseline."""
    rate: Annotated[float, Field(ge=1e-9, lt=1)] | None = None
    """Largest share of failed runs, shown at this `confidence`."""
    confidence: Annotated[float, Field(ge=0.5, lt=1)] = 0.95

    @property
    def counts_failures(self) -> bool:
        """True if it is a limit of failed runs, and so names no value."""
        return self.rate is not None

    @model_validator(mode="after")
    def _has_a_limit(self) -> Self:
        if self.rate is not None:
            if self.model_fields_set - {"rate", "confidence", "scenarios", "name"}:
                raise ValueError("a rate is the share of failed runs: it stands alone, or with `scenarios`")
            return self
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
        if self.rate is not None:
            return f"at most {100 * self.rate:g} % of the runs fail{'' if self.scenarios == 'all' else ' in ' + ', '.join(self.scenarios)}"
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
    """A limit in a scenario. `broken` says why it does not hold, or why its runs do not tell (`unsure`); None if it holds."""

    scenario: str
    limit: str
    broken: str | None
    unsure: bool = False


@dataclass(frozen=True, slots=True)
class CheckedSet:
    """A set: its evaluations and the baseline's by score, and its limits. The campaign's score comes first, or the problem's first one."""

    evaluations: Mapping[str, Evaluation]
    baseline: Mapping[str, Evaluation]
    problem: ProblemAnswer
    unchecked: Sequence[str] = ()
    """Constraints of the campaign that limit no scenario by itself."""
    weights: Mapping[str, float] = field(default_factory=dict)
    """Weights of the campaign's scenarios, 1 for others; empty without weights."""

    @property
    def first(self) -> Evaluation:
        """The evaluation by the first score."""
        return next(iter(self.evaluations.values()))

    @property
    def notes(self) -> list[str]:
        """The notes of all evaluations."""
        noted = [f"{whose}{note}" for whose, each in self._each() for note in (*each.notes, each.error) if note]
        if self.problem.simulator.get("random") and not any(cell.scores for cell in self.first.items):
            noted.append("a random simulator ran once in each scenario; --seeds N tests limits by intervals")
        if self.unchecked:
            noted.append(f"not checked are the campaign's other constraints: {', '.join(self.unchecked)}")
        return list(dict.fromkeys(noted))

    def _each(self) -> Iterator[tuple[str, Evaluation]]:
        yield from (("baseline: ", each) for each in self.baseline.values())
        yield from (("", each) for each in self.evaluations.values())

    @property
    def mean(self) -> dict[str, float | None]:
        """The mean score of the set by the weights, and with several seeds its 95 % interval; None without a score in each scenario."""
        from drivecal.analysis.replicates import interval  # takes a part of a second

        if self.first.objective is None or not self.weights:
            return {name: getattr(self.first, name) for name in ("objective", *INTERVAL)}
        means = self._by_seed(self.first.items)
        spread = (stdev(means) / len(means) ** 0.5, *interval(means, None, 0.95)) if len(set(means)) > 1 else (None, None, None)
        return dict(zip(("objective", *INTERVAL), (fmean(means), *spread), strict=True))

    @property
    def beside_baseline(self) -> dict[str, dict[str, float]]:
        """By score, the mean of the set, that of the baseline, and the gain over it as `gain` has it; only scores with both means."""
        compared = {}
        for score, before in self.baseline.items():
            each = self.evaluations[score]
            if each.objective is not None and before.objective is not None:
                known = (
                    *(fmean(self._by_seed(cells.items)) for cells in (each, before)),
                    *self.gain(score, each.items, before.items),
                )
                compared[score] = dict(zip(("mean", "baseline", "gain", "gain_lower", "gain_upper"), known, strict=False))
        return compared

    def gain(self, score: str, cells: Sequence[EvaluatedCell], before: Sequence[EvaluatedCell]) -> list[float]:
        """Returns the mean gain over the baseline, and with several seeds its 95 % interval, without what a seed does to both."""
        from drivecal.analysis.replicates import interval  # takes a part of a second

        sign = -1 if self.problem.scores[score]["direction"] == "minimise" else 1
        gains = [sign * (own - other) for own, other in zip(self._by_seed(cells), self._by_seed(before), strict=True)]
        ends = interval(gains, None, 0.95) if len(gains) > 1 else ()
        return [fmean(gains), *(end for end in ends if end is not None)]

    def _by_seed(self, cells: Sequence[EvaluatedCell]) -> list[float]:
        """Returns the mean score of the cells under each seed by the weights."""
        weights = [self.weights.get(cell.scenario, 1.0) for cell in cells]
        runs = zip(*(cell.scores or [cell.score] for cell in cells), strict=True)
        return [fmean(map(float, run), weights if any(weights) else None) for run in runs]

    def findings(self, limits: Sequence[SetLimit]) -> Iterator[Finding]:
        """Yields a finding for each scenario, which needs a result, and for each limit in its scenarios."""
        for cell in self.first.items:
            why = None if cell.score is not None else cell.detail or cell.failure or "no result"
            yield Finding(cell.scenario, "has a result", why)
        for limit in limits:
            names = [cell.scenario for cell in self.first.items] if limit.scenarios == "all" else limit.scenarios
            yield from [self._failures(limit, names)] if limit.rate else (self._finding(limit, name) for name in names)
        differing = sum(each.unrepeatable for _, each in self._each())
        if differing and self.problem.simulator.get("deterministic") is not False:
            counted = f"{differing:,} runs gave another result; what else they read belongs into `inputs`"
            yield Finding("all", "new runs give the stored results", counted)

    def _failures(self, limit: SetLimit, names: Collection[str]) -> Finding:
        from drivecal.analysis.replicates import rate_bounds  # takes a part of a second

        cells, rate = [cell for cell in self.first.items if cell.scenario in names], limit.rate or 0.0
        failed, runs = map(sum, zip((0, 0), *map(_failed, cells), strict=True))
        least, most = rate_bounds(failed, runs, limit.confidence)
        if most <= rate:
            return Finding("all", limit.text, None)
        unsure, shown = least <= rate, f"{failed} of {runs} runs fail, which is {100 * least:.2g} to {100 * most:.2g} % of many"
        return Finding("all", limit.text, f"unsure: {shown}; more --seeds may tell" if unsure else shown, unsure)

    def _finding(self, limit: SetLimit, scenario: str) -> Finding:
        cell, before = _cell(self.evaluations, limit, scenario), _cell(self.baseline, limit, scenario)
        value, *within = _known(cell, limit)
        if cell is not None and value is None and cell.failures and cell.scores:  # their worth is not in the mean
            counted = f"{cell.failures} of {len(cell.scores)} runs failed, and have no value of {limit.label}"
            why = f"unsure: {counted}; limit failed runs by a rate"
            return Finding(scenario, limit.text, why, unsure=True)
        value = limit.failed if value is None else value
        if cell is None or value is None:
            return Finding(scenario, limit.text, f"no value of {limit.label}")
        shown = f"{limit.label} is {score_text(value)}{within_text(*within)}"
        low, high = (value if end is None else end for end in within)
        if limit.at_most is not None:
            least, most = low - limit.at_most, high - limit.at_most
        elif limit.at_least is not None:
            least, most = limit.at_least - high, limit.at_least - low
        else:
            if before is None or before.score is None:
                return Finding(scenario, limit.text, f"the baseline has no value of {limit.label}")
            losses = [-gain - (limit.worse_by_at_most or 0.0) for gain in self.gain(limit.score or "", [cell], [before])]
            least, most = min(losses), max(losses)
            shown += f", and {score_text(before.score)} in the baseline"
        if most <= grain(value):
            return Finding(scenario, limit.text, None)
        unsure = least <= 0
        return Finding(scenario, limit.text, f"unsure: {shown}; more --seeds may tell" if unsure else shown, unsure)


def _cell(evaluations: Mapping[str, Evaluation], limit: SetLimit, scenario: str) -> EvaluatedCell | None:
    items = [each.items for score, each in evaluations.items() if limit.score in {None, score}][:1]
    return next((item for listed in items for item in listed if item.scenario == scenario), None)


def _known(cell: EvaluatedCell | None, limit: SetLimit) -> tuple[float | None, float | None, float | None]:
    """Returns the value that is limited, and the ends of its interval."""
    if cell is None or limit.measure is None:
        return (None, None, None) if cell is None else (cell.score, cell.lower, cell.upper)
    return (cell.metrics or {}).get(limit.measure), *cell.within.get(limit.measure, (None, None))


def _failed(cell: EvaluatedCell) -> tuple[int, int]:
    """Returns the number of failed runs, and of all runs."""
    return (cell.failures, len(cell.scores)) if cell.scores else (int(cell.failure is not None), 1)


@app.command()
@asking
def check(
    client: Client,
    chosen: Annotated[
        str,
        typer.Argument(
            metavar="SET", help="A JSON, YAML, DCM or CDFX file, or ID#RANK of a campaign, on its front if it has one."
        ),
    ],
    problem: Annotated[str | None, typer.Option(help="The problem; by default the campaign's, or highway.")] = None,
    limits: Annotated[str | None, typer.Option(metavar="FILE", help="Limits of scores and measures, YAML or JSON.")] = None,
    baseline: Annotated[
        str | None, typer.Option(metavar="SET", help="A set to compare with, as SET, or `campaign`: its own.")
    ] = None,
    names: Annotated[str | None, typer.Option(metavar="FILE", help="Labels of the parameters in DCM and CDFX files.")] = None,
    variant: Annotated[str | None, typer.Option(metavar="NAME", help="Of ID#RANK: rank and check it for this variant.")] = None,
    vehicle_parameters: VehicleOption = None,
    seeds: SeedsOption = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Simulate the set and the baseline again.")] = False,
    junit: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the findings as JUnit XML.")] = None,
    summary: Annotated[Path | None, typer.Option(metavar="FILE", help="Append a summary in Markdown.")] = None,
    timeout: Annotated[float | None, typer.Option(min=0, help="Seconds to wait at most; then exit status 6.")] = None,
) -> Asked:
    """Check whether a set keeps its limits in every scenario; exit status 1 if not, and if its runs do not tell. Only what changed is
    simulated. A set of a campaign runs under the seeds that report it, with --seeds N under N seeds beginning there."""
    differing = {} if vehicle_parameters is None else assignments(vehicle_parameters.split(","), "--vehicle-parameters")
    wanted: list[SetLimit] = []
    if limits is not None:
        with opened_document(limits) as document:
            wanted = validated(LimitsFile, document).limits
    if names is not None and not any(Path(given).suffix.lower() in CALIBRATION_FILES for given in (chosen, baseline or "")):
        raise typer.BadParameter("only DCM and CDFX files have labels", param_hint="--names")
    given = _set(client, chosen, names, variant)
    parameters, spec, reported = given.parameters, given.spec, given.seeds
    known = client.problem(problem or spec.get("problem", DEFAULT_PROBLEM))
    # another push may have other scenarios, but a variant names its own
    copied = DECIDING if variant or problem is None else DECIDING - {"catalogue"}
    settings = {name: spec[name] for name in copied if name in spec} | {"problem": known.digest}
    settings["vehicle"] = _vehicle(settings, differing)
    first = min(reported, default=1)  # a set looks better than it is under the seeds before, which chose it
    settings["seeds"] = list(range(first, first + seeds)) if seeds and reported else seeds or list(reported) or 1
    listed = settings.get("catalogue") or known.scenarios
    _refuse_another_form(given, known)
    own_limits, unchecked = _of_campaign(spec, known, () if isinstance(listed, str) else listed, rates=seeds is not None)
    _refuse_unknown(wanted, known, () if isinstance(listed, str) else listed, has_baseline=baseline is not None)
    wanted = [*own_limits, *wanted]
    aims = [aim["score"] for aim in spec.get("objectives") or () if aim.get("score") in known.scores]
    evaluators = _evaluators(known, spec.get("evaluator"), [*(limit.score for limit in wanted), *aims])
    own = parameters if spec and problem is None else known.parameters  # a driving function has its own
    wait = partial(ended, client, timeout=timeout, waiting=pauses(SECONDS_BETWEEN_QUESTIONS, timeout))
    compared: dict[str, Evaluation] = {}
    if baseline is not None:
        before = GivenSet(given.baseline) if baseline == "campaign" and given.baseline else _set(client, baseline, names)
        _refuse_another_form(before, known)
        values = _values(before.parameters, own, known.shapes)
        compared = _evaluated(client, settings | {"parameters": values}, evaluators, wait, fresh=fresh)
    document = settings | {"parameters": _values(parameters, own, known.shapes)}
    evaluations = _evaluated(client, document, evaluators, wait, fresh=fresh)
    checked = CheckedSet(evaluations, compared, known, unchecked, spec.get("weights") or {})
    findings, label = list(checked.findings(wanted)), chosen if variant is None else f"{chosen} for {variant}"
    if junit is not None:
        with file_faults(junit, "written", "give another file"):
            junit.write_bytes(_junit(label, findings))
    if summary is not None:
        with file_faults(summary, "written", "give another file"), summary.open("a", encoding="utf-8") as stream:
            stream.write(_markdown(label, checked, findings))
    broken = [finding for finding in findings if finding.broken is not None]

    def show() -> None:
        columns = [name for name in COLUMNS if name not in OF_SEEDS or any(cell.scores for cell in checked.first.items)]
        print_columns(columns, [[row[name] for name in columns] for row in _rows(checked, findings)])
        mean, by = checked.mean, "by the campaign's weights" if checked.weights else "without weights"
        if within := within_text(mean["lower"], mean["upper"]):
            typer.echo(f"mean score of the scenarios, {by}: {score_text(mean['objective'])}{within}")
        for score, beside in checked.beside_baseline.items():
            within = within_text(beside.get("gain_lower"), beside.get("gain_upper"))
            paired = f"{beside['gain']:.4g}{within and f'{within} by equal seeds'}"
            means = f"mean {score} {by} {score_text(beside['mean'])}, of the baseline {score_text(beside['baseline'])}"
            typer.echo(f"{means}; gain over it, below 0 for a loss: {paired}")
        if findings:
            tried = "; ".join(dict.fromkeys(finding.limit for finding in findings))
            typer.echo(f"kept in {len(findings) - len(broken)} of {len(findings)} places: {tried}")
        for note in [*checked.notes, *([] if findings else ["no limit was tested; --limits FILE gives some"])]:
            say(f"note: {note}")
        for finding in broken:
            say(f"{finding.scenario}: {finding.limit}: {finding.broken}")

    return _document(checked, findings), show, ExitCode.FAILED if broken else ExitCode.OK


def _set(client: Client, given: str, names: str | None, variant: str | None = None) -> GivenSet:
    identifier, mark, rank = given.rpartition("#")
    if mark and rank.isdecimal() and int(rank) > 0:
        campaign = client.campaign(identifier)
        is_front = len(campaign.spec.get("objectives") or []) > 1 and variant is None
        ranked: Sequence[Solution | FrontRow] = (
            client.front(campaign.id) if is_front else client.solutions(campaign.id, limit=int(rank), variant=variant).items
        )
        if len(ranked) < int(rank):
            raise NotFoundError("set", given, f"the {'front' if is_front else 'campaign'} has {len(ranked)} ranked sets")
        shapes = client.setup(campaign.id).shapes
        chosen = ranked[int(rank) - 1]
        axes: Axes = {name: shape.axes for name, shape in shapes.items()}
        spec = campaign.spec if variant is None else _of_variant(campaign.spec, variant, list(chosen.scores))
        return GivenSet(chosen.parameters, spec, axes, chosen.seeds, baseline=getattr(campaign.baseline, "parameters", {}))
    if variant is not None:
        raise typer.BadParameter("only a campaign's set, ID#RANK, has variants", param_hint="--variant")
    if given != "-" and not Path(given).exists():
        raise NotFoundError("file", given, "the best set of a campaign is ID#1")
    if Path(given).suffix.lower() == ".csv":
        raise typer.BadParameter("a set is read from YAML, JSON, DCM or CDFX, not from CSV")
    if Path(given).suffix.lower() not in CALIBRATION_FILES:
        document = dict(read_document(given))
        if not isinstance(parameters := document.get("parameters", document), dict):
            raise InvalidInputError(Problem("parameters", "they are no names with values", "give a value for each parameter"))
        return GivenSet(parameters)
    from drivecal.calibration_data import files
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
    known = {by_label.get(each.name, each.name): each for each in listed if each.given is not None}
    return GivenSet({name: each.given for name, each in known.items()}, axes=axes, read=known)


def _of_variant(spec: Mapping[str, Any], name: str, scenarios: Sequence[str]) -> Mapping[str, Any]:
    """Returns a campaign's spec with a variant's `scenarios`, as a ranking names them, and its vehicle. Raises InvalidInputError."""
    own, listed = spec["variants"][name].get("vehicle") or {}, [base_of(each) for each in scenarios]
    if isinstance(catalogue := spec.get("catalogue"), str) and catalogue not in {spec.get("problem", DEFAULT_PROBLEM), *listed}:
        raise InvalidInputError(Problem("--variant", f"its scenarios are of the catalogue {catalogue}", "leave it out"))
    return {**spec, "catalogue": listed, "vehicle": _vehicle(spec, own.get("parameters") or {})}


def _of_campaign(
    spec: Mapping[str, Any], problem: ProblemAnswer, listed: Collection[str], *, rates: bool
) -> tuple[list[SetLimit], list[str]]:
    """Returns the constraints of a campaign that limit each scenario by itself, and with `rates` the share of failed runs, in the `listed`
    scenarios that have a weight (none are listed if only the server knows them), and the names of the others."""
    limits, others, weights = list[SetLimit](), list[str](), spec.get("weights") or {}
    confidence = (spec.get("replicates") or {}).get("confidence", 0.95)
    for each in map(ConstraintSpecification.model_validate, spec.get("constraints") or ()):
        names_of = ("name", "rate") if each.counts_failures else ("score", "measure", "name", "failed", "at_least", "at_most")
        bounds = {name: value for name in names_of if (value := getattr(each, name)) is not None}
        chosen = listed if each.scenarios == "all" else each.scenarios
        names = [name for name in chosen if not listed or (name in listed and weights.get(name, 1) > 0)]
        is_known = rates if each.counts_failures else each.score in problem.scores or each.measure in problem.measures
        if each.aggregate is not None or (each.rate is not None and not each.counts_failures) or not is_known:
            others.append(each.label)
        elif names or not listed:
            scenarios = "all" if len(names) == len(listed) else names
            limits.append(SetLimit.model_validate({**bounds, "scenarios": scenarios, "confidence": confidence}))
    return limits, others


def _vehicle(settings: Mapping[str, Any], differing: Mapping[str, Any]) -> Mapping[str, Any]:
    """Returns the vehicle of settings, with other values of these parameters."""
    vehicle = settings.get("vehicle") or {}
    return {**vehicle, "parameters": {**(vehicle.get("parameters") or {}), **differing}}


def _refuse_another_form(given: GivenSet, problem: ProblemAnswer) -> None:
    """Raises InvalidInputError if values have other units or belong to other points than in the problem; a parameter such as `gain.x` is
    such points."""
    shapes = problem.shapes
    wanted = {name: Characteristic(name, unit=str(entry.get("unit", "1"))) for name, entry in problem.parameters.items()}
    wanted |= {
        name: Characteristic(name, unit=shape.unit, axes=tuple(Axis("", unit=unit) for unit in shape.axis_units))
        for name, shape in shapes.items()
    }
    for name, each in given.read.items():
        if name in wanted and each.fault is not None:
            raise InvalidInputError(each.fault)
        for differing in other_units(each, wanted.get(name, each)):
            raise InvalidInputError(
                Problem(f"parameters.{name}", f"the file has {differing}", "give a set in the problem's units")
            )
    for name, shape in shapes.items():
        for letter, own, points in zip("xy", given.axes.get(name, ()), shape.axes, strict=False):
            same = all(math.isclose(one, other, rel_tol=1e-6, abs_tol=1e-6) for one, other in zip(own, points, strict=False))
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
                remedy = f"one of {', '.join(names)}, or the problem that has it: --problem"
                faults.append(Problem(f"{field}.{kind}", f"{problem.name} has no {kind} {name!r}", remedy))
        for name in () if limit.scenarios == "all" or not known else limit.scenarios:
            if name not in known:
                remedy = nearest(name, list(known))
                faults.append(Problem(f"{field}.scenarios", f"no scenario {name!r} is checked", remedy))
        if limit.worse_by_at_most is not None and not has_baseline:
            faults.append(Problem(f"{field}.worse_by_at_most", "there is no baseline", "give --baseline"))
    if faults:
        raise InvalidInputError(*faults)


def _evaluators(problem: ProblemAnswer, chosen: str | None, further: Sequence[str | None]) -> dict[str, str]:
    """Returns the evaluators of the scores to check by score. `chosen` by a campaign, which comes first: a score, or an
    installed evaluator of the first score that has one; None for a file."""
    first = next(iter(problem.scores))
    if chosen in problem.scores:
        first = chosen
    elif chosen is None:
        chosen = first
    else:
        first = next((name for name, entry in problem.scores.items() if entry["evaluator"] is not None), first)
    return {first: chosen} | {score: score for score in further if score is not None and score != first}


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
        remedy = "give one value per parameter; --problem names another problem, --names has the labels of a calibration file"
        raise InvalidInputError(*(Problem(f"parameters.{name}", "the value is missing", remedy) for name in missing))
    return {name: parameters[name] for name in names}


def _evaluated(
    client: Client,
    document: Mapping[str, Any],
    evaluators: Mapping[str, str],
    wait: Callable[[Evaluation], Evaluation],
    *,
    fresh: bool = False,
) -> dict[str, Evaluation]:
    """Returns the evaluations of a set by score.

    With `fresh`, further scores rate the stored runs if the new ones are equal, and else new runs of their own.
    """
    evaluations: dict[str, Evaluation] = {}
    for score, evaluator in evaluators.items():
        simulates = fresh and (not evaluations or any(each.unrepeatable for each in evaluations.values()))
        evaluation = wait(client.evaluate({**document, "evaluator": evaluator, "fresh": simulates}))
        if not evaluation.items:
            say(f"the evaluation was not carried out: {evaluation.error or evaluation.state}")
            raise typer.Exit(code_of_state(evaluation.state))
        evaluations[score] = evaluation
    return evaluations


def _rows(checked: CheckedSet, findings: Sequence[Finding], unsure: str = " (unsure)") -> Iterator[dict[str, Any]]:
    before = {cell.scenario: cell.score for each in list(checked.baseline.values())[:1] for cell in each.items}
    for cell in checked.first.items:
        name, own = cell.scenario, {each: getattr(cell, each) for each in ("score", *INTERVAL)}
        own |= zip(("failures", "runs"), _failed(cell), strict=True)
        failed = [finding for finding in findings if finding.scenario == name and finding.broken is not None]
        broken = "; ".join(finding.limit + (unsure if finding.unsure else "") for finding in failed)
        yield {"scenario": name, **own, "baseline": before.get(name), "obtained": cell.outcome, "broken": broken}


def _document(checked: CheckedSet, findings: Sequence[Finding]) -> dict[str, Any]:
    beside = checked.beside_baseline
    return {
        "passed": all(finding.broken is None for finding in findings),
        "notes": checked.notes,
        **checked.mean,
        **{name: value for name, value in next(iter(beside.values()), {}).items() if name != "mean"},
        "beside_baseline": beside,
        "scenarios": list(_rows(checked, findings, "")),
        "findings": [asdict(finding) for finding in findings],
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
    simulated = sum(cell.outcome == "simulated" for cell in checked.first.items)
    lines = [
        f"### {'Passed' if not broken else 'Failed'}: `{chosen}` on {checked.problem.name}",
        "",
        f"{len(findings) - broken} of {len(findings)} checks hold; {simulated} of {len(checked.first.items)} scenarios were simulated.",
        "",
        f"| {' | '.join(COLUMNS)} |",
        f"|{'---|' * len(COLUMNS)}",
    ]
    for row in _rows(checked, findings):
        shown = ["" if raw is None else score_text(raw) if isinstance(raw, float | int) else str(raw) for raw in row.values()]
        lines.append(f"| {' | '.join(text.replace('|', chr(92) + '|') for text in shown)} |")
    lines += [f"\n{finding.scenario}: {finding.limit}: {finding.broken}" for finding in findings if finding.broken]
    return "\n".join([*lines, "", ""])
