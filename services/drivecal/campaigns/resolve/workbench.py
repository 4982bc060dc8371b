"""Finds the problem that a specification names: installed plug-ins of the built-in closed loop, or a stored bundle."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from drivecal.analysis.goals import CellValue
from drivecal.bundles.manifest import Manifest
from drivecal.campaigns.resolve import resolvers
from drivecal.campaigns.resolve.bench import Bench, DrivingBench
from drivecal.campaigns.resolve.bundle_bench import Bundle, BundleBench, BundleSource, constraints_of, parameters_of
from drivecal.campaigns.resolve.diagnostics import Diagnostics
from drivecal.campaigns.resolve.goals import KnownValues
from drivecal.campaigns.resolve.spaces import Parameterised
from drivecal.contracts.specification import (
    HIGHWAY,
    CampaignSpecification,
    EvaluationSpecification,
    ProblemSpecification,
    VehicleSpecification,
)
from drivecal.domain.constraints import Constraint as Allows
from drivecal.domain.errors import NotFoundError
from drivecal.domain.measures import CLOSED_LOOP_MEASURES
from drivecal.domain.parameters import Parameter, Setting
from drivecal.domain.scales import COMFORT
from drivecal.plugins import registry
from drivecal.plugins.ports import Vehicle

LONGEST_ANSWER = 200
"""Characters of a probe's answer in a note."""

Wanted = ProblemSpecification | EvaluationSpecification
"""A specification that names a problem."""


@dataclass(frozen=True)
class Workbench:
    """Everything that a specification's problem offers; parts that do not exist are None, with their problems in the diagnostics."""

    settled: Mapping[str, Any]
    """Meaning of the settings of a specification: the digest of a bundle, its scenarios, its score."""
    scenarios: tuple[str, ...] = ()
    function: Parameterised | None = None
    vehicle: Vehicle | None = None
    vehicle_parameters: Mapping[str, float] = field(default_factory=dict)
    make: Callable[[Collection[str]], Bench] | None = None
    """Makes the bench of some scenarios."""
    baseline: Mapping[str, Setting] | None = None
    """The problem's own baseline."""
    notes: tuple[str, ...] = ()
    known: KnownValues = field(default_factory=KnownValues)


def no_bundles(name: str) -> Bundle:
    """A source without bundles."""
    raise NotFoundError("problem", name, "push it first: drivecal problem push DIR")


def find_workbench(wanted: Wanted, bundles: BundleSource, diagnostics: Diagnostics) -> Workbench:
    """Returns the problem that a specification names, as far as it exists."""
    if wanted.problem == HIGHWAY:
        return _installed(wanted, diagnostics)
    try:
        bundle = bundles(wanted.problem)
    except NotFoundError as error:
        diagnostics.add("problem", str(error), "push it with `drivecal problem push DIR`; `drivecal problem list` shows them")
        return Workbench({"problem": wanted.problem})
    return _stored(wanted, bundle, diagnostics)


def _installed(wanted: Wanted, diagnostics: Diagnostics) -> Workbench:
    catalogued = resolvers.find_scenarios(wanted.catalogue, diagnostics)
    function = diagnostics.attempt(lambda: registry.driving_function(wanted.driving_function))
    vehicle, values = resolvers.find_vehicle(wanted.vehicle, diagnostics)
    evaluator = diagnostics.attempt(lambda: registry.evaluator(wanted.evaluator))
    make = None
    if function is not None and vehicle is not None and evaluator is not None:
        driven, driver, rater = vehicle, function, evaluator

        def make(scenarios: Collection[str]) -> Bench:
            return DrivingBench({name: catalogued[name] for name in scenarios}, driver, driven, values, rater)

    known = KnownValues({COMFORT.name: CellValue(COMFORT)}, CLOSED_LOOP_MEASURES)
    return Workbench({"problem": HIGHWAY}, tuple(catalogued), function, vehicle, values, make, known=known)


@dataclass(frozen=True)
class BundleFunction:
    """A bundle's parameters, as spaces are made of them."""

    name: str
    parameters: tuple[Parameter, ...]
    constraints: Mapping[str, Allows]
    """Constraints by their text."""

    @property
    def spaces(self) -> Mapping[str, tuple[Parameter, ...]]:
        """The manifest's own space, which every default names."""
        return {HIGHWAY: self.parameters, self.name: self.parameters}

    @property
    def limits(self) -> Mapping[str, tuple[float | None, float | None]]:
        """The manifest's ranges: its author has not claimed that it works beyond them. A push with wider ones keeps all results."""
        return {
            parameter.name: (float(parameter.lower), float(parameter.upper))
            for parameter in self.parameters
            if not parameter.choices
        }


def _stored(wanted: Wanted, bundle: Bundle, diagnostics: Diagnostics) -> Workbench:
    manifest = bundle.manifest
    _refuse_driving_settings(wanted, manifest.problem, diagnostics)
    scenarios = _scenarios(wanted.catalogue, manifest, diagnostics)
    score = _score(wanted, manifest, diagnostics)
    function = BundleFunction(manifest.problem, parameters_of(manifest), constraints_of(manifest))
    make = None if score is None else lambda chosen: BundleBench(bundle, tuple(chosen), score)
    settled: dict[str, Any] = {"problem": bundle.digest, "evaluator": score}
    if isinstance(wanted, ProblemSpecification):
        settled["catalogue"] = list(scenarios)
    scores = {
        name: CellValue(entry.scale(name), None if name == score else entry.formula) for name, entry in manifest.scores.items()
    }
    known = KnownValues() if score is None else KnownValues(scores, manifest.reported)
    return Workbench(settled, scenarios, function, make=make, baseline=manifest.baseline, notes=_notes(bundle), known=known)


def _notes(bundle: Bundle) -> tuple[str, ...]:
    probe = bundle.manifest.simulator.probe
    if probe is None or bundle.tools is None:
        return ()
    answer = " ".join(bundle.tools.split())
    shown = answer if len(answer) <= LONGEST_ANSWER else f"{answer[:LONGEST_ANSWER]}..."
    return (f"`{' '.join(probe)}` answers {shown!r} on the workers: results under another answer are not reused",)


def _refuse_driving_settings(wanted: Wanted, problem: str, diagnostics: Diagnostics) -> None:
    defaults = {"driving_function": "frenet", "vehicle": VehicleSpecification()}
    for name, default in defaults.items():
        if getattr(wanted, name) != default:
            diagnostics.add(name, f"the problem {problem} has its own simulator", f"leave it out, or give problem: {HIGHWAY}")


def _scenarios(catalogue: str | list[str], manifest: Manifest, diagnostics: Diagnostics) -> tuple[str, ...]:
    listed = [catalogue] if isinstance(catalogue, str) else catalogue
    if listed in ([HIGHWAY], [manifest.problem]):
        return tuple(manifest.scenarios)
    for index, name in enumerate(listed):
        if name not in manifest.scenarios:
            remedy = f"one of {', '.join(manifest.scenarios)}"
            diagnostics.add(f"catalogue[{index}]", f"{manifest.problem} has no scenario {name!r}", remedy)
    return tuple(name for name in manifest.scenarios if name in listed)


def _score(wanted: Wanted, manifest: Manifest, diagnostics: Diagnostics) -> str | None:
    """Returns the campaign's score: the evaluator, or else the first that an objective names, or else the manifest's first."""
    evaluator = wanted.evaluator
    if evaluator in manifest.scores:
        return evaluator
    if evaluator == "reference":  # the default of the built-in problem
        objectives = wanted.objectives if isinstance(wanted, CampaignSpecification) else None
        named = [each.score for each in objectives or () if each.score in manifest.scores]
        return next((score for score in named if score is not None), next(iter(manifest.scores)))
    diagnostics.add("evaluator", f"{manifest.problem} has no score {evaluator!r}", f"one of {', '.join(manifest.scores)}")
    return None
