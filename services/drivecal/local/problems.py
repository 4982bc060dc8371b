"""Checks a problem bundle by running it here, in child processes as on a worker: one set per scenario twice, then another one, which a
deterministic simulator gets in a new process as well."""

import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from drivecal.adapters.command import run_probe
from drivecal.adapters.environment import sessions
from drivecal.adapters.files import remove
from drivecal.adapters.kinds import simulator_of
from drivecal.adapters.process import ProcessSession
from drivecal.analysis.scoring import cut_text
from drivecal.bundles.archives import unpack
from drivecal.bundles.checks import choices_of
from drivecal.bundles.expressions import Constraint
from drivecal.bundles.installed import Bundle
from drivecal.bundles.manifest import Manifest
from drivecal.bundles.shapes import with_points
from drivecal.campaigns.resolve.bench import Bench
from drivecal.campaigns.resolve.workbench import bench_of, constraints_of, parameters_of
from drivecal.contracts.specification import ParameterEntry, ProblemSpecification
from drivecal.contracts.work import CellResult, SetupRequest
from drivecal.domain.constraints import Constraints
from drivecal.domain.errors import InvalidInputError, Problem, UnavailableError
from drivecal.domain.parameters import ParameterSpace
from drivecal.domain.values import Setting
from drivecal.plugins.simulators import Declared, NoMeasuresError, RunOutcome, SimulatorSession
from drivecal.runtime.compilation import prepare_cache

SEED = 20261121
FAULTS = (NoMeasuresError, UnavailableError, OSError)
Settings = Mapping[str, Setting]


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckedRun:
    """Result of a set in a scenario.

    `error`: why there is no result. `undefined`: why a score has no value, by name; such a score has the worth of a failed run. `cut`: true
    values of the scores that are worse than a failed run's worth, and count as it.
    """

    measures: Mapping[str, float] = field(default_factory=dict)
    failure: str | None = None
    scores: Mapping[str, float] = field(default_factory=dict)
    undefined: Mapping[str, str] = field(default_factory=dict)
    cut: Mapping[str, float] = field(default_factory=dict)
    error: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class OtherRun(CheckedRun):
    """Result of another set. `alone`: as the first run of a new process it gave the same bits; None if that was not tried. `alone_error`:
    why it has no result there."""

    alone: bool | None = None
    alone_error: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckedScenario(CheckedRun):
    """Result of a scenario's two runs, and of another set.

    `repeats`: both runs gave the same bits. `seconds`: wall-clock time of each run; `start_seconds`: time until the simulator was ready.
    `other`: None if no other set was tried. `opened`: files that its process opened, as far as they are seen.
    """

    scenario: str
    repeats: bool | None = None
    start_seconds: float = 0.0
    seconds: tuple[float, ...] = ()
    cpu_seconds: tuple[float, ...] = ()
    other: OtherRun | None = None
    opened: frozenset[str] = frozenset()


def trial_set(manifest: Manifest) -> dict[str, Setting]:
    """Returns the baseline, or the middle of the space. Raises InvalidInputError if the middle breaks a constraint."""
    values: Mapping[str, Setting] | None = manifest.start
    if values is None:
        space = ParameterSpace(parameters_of(manifest))
        values = space.parameter_set((each.n_values - (each.kind != "choice")) // 2 for each in space.parameters).floats
        for text in manifest.conditions:
            if not Constraint(text, choices_of(manifest)).holds(values):
                message = f"the middle of the space breaks {text!r}"
                raise InvalidInputError(Problem("baseline", message, "give a baseline to try"))
    return {name: _typed(entry, values[name]) for name, entry in manifest.scalars.items()}


def other_set(manifest: Manifest) -> dict[str, Setting] | None:
    """Returns a set that is not the `trial_set` and keeps all constraints, drawn with a fixed seed; None if none was drawn."""
    constraints = Constraints(ParameterSpace(parameters_of(manifest)), constraints_of(manifest))
    last, generator, tried = constraints.space.n_values - 1, np.random.default_rng(SEED), trial_set(manifest)
    for _ in range(20):  # until one is another one
        try:
            [row] = constraints.region(0 * last, last).sample(1, generator)
        except InvalidInputError:
            break
        values = constraints.space.parameter_set(row.tolist()).floats
        other = {name: _typed(entry, values[name]) for name, entry in manifest.scalars.items()}
        if other != tried:
            return other
    return None


def run_problem(
    manifest: Manifest, archive: bytes, parameters: Settings, other: Settings | None = None
) -> Iterator[CheckedScenario]:
    """Yields the result of each scenario. Raises UnavailableError if this machine cannot run the simulator."""
    if manifest.has_planner:
        prepare_cache()
    wanted = [ProblemSpecification(problem=manifest.problem, evaluator=name) for name in manifest.scores]
    benches = {bench.score: bench for bench in (bench_of(each, lambda _: Bundle("", "", manifest)) for each in wanted)}
    told = next((each for each in benches.values() if each.needs_series), next(iter(benches.values())))
    rated = {name: each for name, each in benches.items() if not each.needs_series or each.evaluator is told.evaluator}
    with _unpacked(archive) as folder:
        for setup in told.requests.values():
            yield _checked(setup, rated, folder, parameters, other)


def ask_probe(manifest: Manifest, archive: bytes) -> str | None:
    """Returns what this machine reports of tools and inputs outside of the folder, None if none are declared. Raises UnavailableError."""
    if not manifest.simulator.asks_workers:
        return None
    with _unpacked(archive) as folder:
        return run_probe(manifest.simulator.model_dump(mode="json"), folder)


@contextmanager
def _unpacked(archive: bytes) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="drivecal-") as made:
        folder = Path(made) / "bundle"
        unpack(archive, folder)
        try:
            yield folder
        finally:
            remove(folder)


def _checked(
    setup: SetupRequest, benches: Mapping[str, Bench], folder: Path, parameters: Settings, other: Settings | None
) -> CheckedScenario:
    manifest, declared = next(iter(benches.values())).bundle.manifest, Declared.of(setup, watched=True)
    scenario, section = setup.scenario, setup.simulator

    def opened() -> closing[SimulatorSession]:
        return closing(simulator_of(section).open(section, scenario, setup.data, folder, declared))

    def run(session: SimulatorSession, values: Settings, *, series: bool) -> tuple[RunOutcome, float]:
        began = time.perf_counter()
        outcome = session.evaluate(with_points({**values, **setup.varied}, manifest.shapes, section), series=series)
        return outcome, time.perf_counter() - began

    began, started = time.perf_counter(), 0.0
    elsewhere, bits, opened_files = None, None, frozenset[str]()
    try:
        with opened() as session:
            started = time.perf_counter() - began
            first, first_seconds = run(session, parameters, series=bool(manifest.series))
            second, second_seconds = run(session, parameters, series=bool(manifest.series))
            if isinstance(session, ProcessSession):
                opened_files = frozenset(each for each in session.opened() if not Path(each).is_relative_to(folder.resolve()))
            if other is not None:
                try:
                    outcome, _ = run(session, other, series=False)
                    elsewhere, bits = OtherRun(**_rated(benches, scenario, outcome)), _bits(outcome)
                except FAULTS as error:
                    elsewhere = OtherRun(error=str(error))
    except FAULTS as error:
        return CheckedScenario(scenario=scenario, error=str(error), start_seconds=started)
    repeats = _bits(first) == _bits(second)
    is_asked = manifest.simulator.deterministic and not manifest.simulator.renews  # one process of it does several runs
    if other is not None and elsewhere is not None and bits is not None and repeats and is_asked:
        try:
            with opened() as session:
                elsewhere = replace(elsewhere, alone=_bits(run(session, other, series=False)[0]) == bits)
        except FAULTS as error:
            elsewhere = replace(elsewhere, alone_error=str(error))
    return CheckedScenario(
        scenario=scenario,
        repeats=repeats,
        start_seconds=started,
        seconds=(first_seconds, second_seconds),
        cpu_seconds=(first.cpu_seconds, second.cpu_seconds),
        other=elsewhere,
        opened=opened_files,
        **_rated(benches, scenario, first),
    )


def _rated(benches: Mapping[str, Bench], scenario: str, outcome: RunOutcome) -> dict[str, Any]:
    """Returns the fields of a `CheckedRun`."""
    declared = next(iter(benches.values())).bundle.manifest.measures
    rating, score = (None, None) if outcome.rating is None else (outcome.rating.rating, outcome.rating.score)
    result = CellResult(0, rating, score, outcome.measures, outcome.failure, 0.0)
    rated = {
        name: bench.rate_result(scenario, result)
        if bench.needs_series
        else bench.rate(scenario, outcome.measures, outcome.failure)
        for name, bench in benches.items()
    }
    known = {name: scored for name, scored in rated.items() if scored is not None}
    return {
        "measures": {name: value for name, value in outcome.measures.items() if name in declared},
        "failure": outcome.failure,
        "scores": {name: scored.score for name, scored in known.items()},
        "undefined": {name: scored.undefined for name, scored in known.items() if scored.undefined is not None},
        "cut": {name: scored.cut for name, scored in known.items() if scored.cut is not None},
    }


OF_THE_SYSTEM = ("/usr", "/lib", "/lib32", "/lib64", "/bin", "/sbin", "/etc", "/proc", "/sys", "/dev", "/run")
"""Folders whose files count as the machine's own."""


def undeclared(manifest: Manifest, checked: Sequence[CheckedScenario]) -> list[str]:
    """Returns a warning for each file that a run opened outside of the problem's folder and that `simulator.inputs` does not cover.

    Files of the system, of the installation of Python, and of runs themselves are left out.
    """
    own = (*OF_THE_SYSTEM, sys.prefix, sys.base_prefix, sys.exec_prefix, str(sessions()), str(Path(__file__).parents[3]))
    covered = [Path(each) for each in (*own, *(each for each in manifest.simulator.inputs or () if isinstance(each, str)))]
    covered += [path.resolve() for path in covered]
    opened = sorted({Path(path) for result in checked for path in result.opened})
    return [
        f"a run opened {path} outside of the problem's folder: add it to `simulator.inputs` in problem.yaml, or stored runs are reused"
        " after it changed"
        for path in opened
        if path.is_file() and not any(form.is_relative_to(each) for each in covered for form in (path, path.resolve()))
    ][:MOST_WARNINGS]


MOST_WARNINGS = 20
"""Files that are listed."""


def cut_scores(manifest: Manifest, checked: Sequence[CheckedScenario]) -> list[str]:
    """Returns a warning for each score that is cut off, with its true value."""
    runs = [(run, f"{each.scenario}{where}") for each in checked for run, where in ((each, ""), (each.other, ", set 2"))]
    return [
        cut_text(where, name, value, manifest.scores[name].failed_worth)
        for run, where in runs
        if run is not None
        for name, value in run.cut.items()
    ]


FAR = 0.5
"""Distance of a score from its range, in widths of the range, from which on the range is doubtful."""
NARROW = 1e-3
"""Share of a range that the scores of all scenarios take together, below which the range is doubtful."""


def doubtful_ranges(manifest: Manifest, checked: Sequence[CheckedScenario]) -> list[str]:
    """Returns a warning for each score whose range is far from what was measured, with the values."""
    warnings = []
    for name, entry in manifest.scores.items():
        valued = [run for run in checked if run.failure is None and name in run.scores and name not in run.undefined]
        values = [run.cut.get(name, run.scores[name]) for run in valued]
        if not values:
            continue
        (lower, upper), least, most = entry.range, min(values), max(values)
        width = upper - lower
        measured = f"{least:g}" if least == most else f"{least:g} to {most:g}"
        if most < lower - FAR * width or least > upper + FAR * width:
            warnings.append(
                f"scores.{name}.range is [{lower:g}, {upper:g}], and the measured scores are {measured}: thresholds of an analysis"
                " are shares of the range, and without `failed` a score beyond its worse end counts as that of a failed run"
            )
        elif 0 < most - least < NARROW * width:
            share = f"{(most - least) / width:.2g} of it ({measured})"
            warnings.append(
                f"scores.{name}.range is [{lower:g}, {upper:g}], and the measured scores take {share}: a narrower range tells them apart"
            )
    return warnings


def _bits(outcome: RunOutcome) -> tuple[object, ...]:
    """Returns a result such that equal means the same bits: 0.0 is not -0.0."""
    measures = {name: float(value).hex() for name, value in outcome.measures.items()}
    series = {name: [float(value).hex() for value in values] for name, values in outcome.series.items()}
    return outcome.failure, measures, series


def _typed(entry: ParameterEntry, value: Setting) -> Setting:
    return int(value) if entry.integer else value
