"""Finds the problem that a specification names, installed or pushed, with the plug-ins that it chooses."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from sqlalchemy import Connection

from drivecal.analysis.goals import CellValue
from drivecal.bundles.archives import files_digest
from drivecal.bundles.checks import choices_of
from drivecal.bundles.expressions import Constraint
from drivecal.bundles.fingerprints import model_of
from drivecal.bundles.highway import TaskScenario
from drivecal.bundles.installed import Bundle, installed
from drivecal.bundles.manifest import CommandSimulator, Manifest
from drivecal.campaigns.resolve import resolvers
from drivecal.campaigns.resolve.bench import Bench
from drivecal.campaigns.resolve.goals import KnownValues
from drivecal.campaigns.resolve.spaces import Function
from drivecal.contracts.specification import (
    CampaignSpecification,
    EvaluationSpecification,
    Given,
    ProblemSpecification,
    VehicleSpecification,
)
from drivecal.domain.constraints import Constraint as Allows
from drivecal.domain.errors import Diagnostics, NotFoundError
from drivecal.domain.parameters import Parameter
from drivecal.domain.setups import base_of
from drivecal.domain.vehicles import VehicleParameter
from drivecal.plugins import registry
from drivecal.plugins.ports import ConstrainedFunction, DrivingFunction, Evaluator, SeriesEvaluator
from drivecal.storage import bundles
from drivecal.storage.engine.database import Database

LONGEST_ANSWER = 200
"""Characters of a probe's answer in a note."""
MOST_READ = 64
"""Bundles that a process keeps: their content never changes, and the digest of their files takes a look at all of them."""

_read: dict[str, Bundle] = {}
Wanted = ProblemSpecification | EvaluationSpecification
"""A specification that names a problem."""
BundleSource = Callable[[str], Bundle]
"""Returns a problem by name or digest. Raises NotFoundError."""


def installed_bundles(name: str) -> Bundle:
    """Returns an installed problem. Raises NotFoundError."""
    bundle = installed(name)
    if bundle is None:
        raise NotFoundError("problem", name, "push it first: drivecal problem push DIR")
    return bundle


def stored_bundles(database: Database) -> BundleSource:
    """Returns a source that reads a database, and the installed problems."""

    def find(name: str) -> Bundle:
        with database.read() as connection:
            return bundles_of(connection)(name)

    return find


def bundles_of(connection: Connection) -> BundleSource:
    """Returns a source that reads through a connection, and the installed problems."""

    def find(name: str) -> Bundle:
        if (own := installed(name)) is not None:
            return own
        stored = bundles.named(connection, name)
        bundle = _read.get(stored.digest)
        if bundle is None:
            files = files_digest(bundles.archive(connection, stored.digest))
            bundle = Bundle(stored.digest, files, Manifest.model_validate(stored.manifest))
            if len(_read) >= MOST_READ:
                _read.clear()
            _read[stored.digest] = bundle
        return bundle

    return find


def moved(connection: Connection, then: str, now: str) -> list[str]:
    """Returns the coefficients of a problem that mean another curve or map in another one. Raises NotFoundError."""
    before, after = (bundles_of(connection)(each).manifest.coefficients for each in (then, now))
    return [name for name, form in before.items() if after.get(name) != form]


def with_tools(source: BundleSource, tools: str | None) -> BundleSource:
    """Returns a source whose bundles know what their `probe` answers."""
    return source if tools is None else lambda name: replace(source(name), tools=tools)


@dataclass(frozen=True)
class Workbench:
    """Everything that a specification's problem offers; parts that do not exist are None, with their problems in the diagnostics."""

    settled: Mapping[str, Any]
    """Meaning of the settings of a specification: the digest of a bundle, its scenarios, its score."""
    scenarios: tuple[str, ...] = ()
    function: Function | None = None
    varied: tuple[VehicleParameter, ...] = ()
    values: Mapping[str, float] = field(default_factory=dict)
    """Values of the side conditions."""
    vehicles: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """The same by variant."""
    make: Callable[[Collection[str], Mapping[str, Mapping[str, float]]], Bench] | None = None
    """Makes the bench of some scenarios, with the values of those where they are others."""
    baseline: Mapping[str, Given] | None = None
    """The problem's own baseline."""
    notes: tuple[str, ...] = ()
    known: KnownValues = field(default_factory=KnownValues)


def parameters_of(manifest: Manifest) -> tuple[Parameter, ...]:
    """Returns all parameters of a manifest."""
    return tuple(Parameter.declared(name, **entry.model_dump()) for name, entry in manifest.scalars.items())


def constraints_of(manifest: Manifest) -> dict[str, Allows]:
    """Returns the constraints of a manifest by their text."""
    known = choices_of(manifest)
    return {text: Constraint(text, known) for text in manifest.conditions}


def bench_of(wanted: Wanted, source: BundleSource = installed_bundles) -> Bench:
    """Returns the bench of all scenarios that a specification names. Raises InvalidInputError with every problem."""
    diagnostics = Diagnostics()
    workbench = find_workbench(wanted, source, diagnostics)
    return diagnostics.found(workbench.make)(workbench.scenarios, {})


def find_workbench(wanted: Wanted, source: BundleSource, diagnostics: Diagnostics) -> Workbench:
    """Returns the problem that a specification names, as far as it exists."""
    try:
        bundle = source(wanted.problem)
    except NotFoundError as error:
        diagnostics.add("problem", str(error), "push it with `drivecal problem push DIR`; `drivecal problem list` shows them")
        return Workbench({"problem": wanted.problem})
    manifest = bundle.manifest
    data = _scenarios(wanted.catalogue, manifest, diagnostics)
    if manifest.has_planner:  # with all defaults, so that equal scenarios have equal fingerprints
        data = {
            name: TaskScenario.model_validate(each).model_dump(mode="json") if "task" in each else each
            for name, each in data.items()
        }
    scored = _score(wanted, manifest, diagnostics)
    section = manifest.simulator.model_dump(mode="json")
    plugin: DrivingFunction | None = None
    if manifest.has_planner:
        drives = wanted.driving_function or section["controller"]["driving_function"]
        plugin = diagnostics.attempt(lambda: registry.driving_function(drives))
        varied, values, known = _vehicle(wanted.vehicle, manifest, section, diagnostics)
        function = None if plugin is None else _driven(manifest, section, plugin)
        if plugin is not None:
            section["controller"]["driving_function"] = plugin.name
    else:
        _refuse_driving_settings(wanted, manifest.problem, diagnostics)
        varied = manifest.varied_parameters  # the vehicle, if there is one, is the problem's own
        known = {each.name: each for each in varied}
        _check_parameters(wanted.vehicle.parameters, manifest.problem, known, diagnostics)
        values = {name: entry.nominal for name, entry in manifest.varied.items()} | wanted.vehicle.parameters
        function = _declared(manifest)
    vehicles = {}
    for name, variant in wanted.variants.items() if isinstance(wanted, CampaignSpecification) else ():
        _check_parameters(variant.vehicle.parameters, manifest.problem, known, diagnostics, f"variants.{name}.vehicle")
        vehicles[name] = values | variant.vehicle.parameters
    offered = Workbench({"problem": bundle.digest}, tuple(data), function, varied, values, vehicles, notes=_notes(bundle))
    if scored is None or function is None:
        return offered
    score, evaluator = scored
    rates_series = isinstance(evaluator, SeriesEvaluator)
    if rates_series and evaluator is not None and not manifest.has_planner:
        diagnostics.add("evaluator", f"{evaluator.name} rates time series of drivecal's own runs", "name another evaluator")
    parameters = next(iter(function.spaces.values()))

    def make(chosen: Collection[str], others: Mapping[str, Mapping[str, float]]) -> Bench:
        listed = {name: data[base_of(name)] for name in chosen}
        simulated = section, varied, values, others
        return Bench(bundle, score, function.name, parameters, listed, *simulated, evaluator)

    settled: dict[str, Any] = {"problem": bundle.digest, "evaluator": score}
    if evaluator is not None and evaluator.name != manifest.scores[score].evaluator:
        settled["evaluator"] = evaluator.name
    if plugin is not None:
        settled |= {"driving_function": plugin.name, "vehicle": wanted.vehicle.model_copy(update={"model": section["vehicle"]})}
    if isinstance(wanted, ProblemSpecification) and not any("catalogue" in each for each in data.values()):
        settled["catalogue"] = list(data)
    scores = {
        name: CellValue(entry.scale(name), None if name == score else entry.formula)
        for name, entry in manifest.scores.items()
        if name == score or entry.formula is not None
    }
    values_of_goals = KnownValues(scores, manifest.reported, shapes=function.shapes)
    return replace(offered, settled=settled, make=make, baseline=manifest.baseline, known=values_of_goals)


def _declared(manifest: Manifest) -> Function:
    """Returns the parameters of a manifest. Its ranges are limits: its author has not claimed that it works beyond them."""
    parameters = parameters_of(manifest)
    limits = {each.name: (float(each.lower), float(each.upper)) for each in parameters if not each.choices}
    spaces = {manifest.problem: parameters}
    return Function(manifest.problem, spaces, limits, constraints_of(manifest), manifest.shapes)


def _driven(manifest: Manifest, section: Mapping[str, Any], plugin: DrivingFunction) -> Function:
    """Returns the parameters of a driving function; in the manifest's ranges by default if it is the manifest's."""
    constraints = plugin.constraints if isinstance(plugin, ConstrainedFunction) else {}
    if plugin.name != section["controller"]["driving_function"]:
        return Function(plugin.name, plugin.spaces, plugin.limits, constraints)
    own = _declared(manifest)
    whole = len(own.spaces[manifest.problem]) == len(next(iter(plugin.spaces.values())))
    further = plugin.spaces if whole else {}
    spaces = {**own.spaces, **{name: space for name, space in further.items() if name not in own.spaces}}
    return Function(plugin.name, spaces, plugin.limits, {**constraints, **own.constraints})


def _vehicle(
    wanted: VehicleSpecification, manifest: Manifest, section: dict[str, Any], diagnostics: Diagnostics
) -> tuple[tuple[VehicleParameter, ...], dict[str, float], dict[str, VehicleParameter]]:
    """Returns the varied parameters of the planner's vehicle, the values of all its parameters, and all that can be given, by name. Puts
    its model into the section."""
    own = section["vehicle"]
    vehicle = diagnostics.attempt(lambda: registry.vehicle(wanted.model or model_of(own)))
    if vehicle is None:
        return (), {}, {}
    section["vehicle"] = vehicle.name
    known = {parameter.name: parameter for parameter in vehicle.parameters}
    nominal = {name: parameter.nominal for name, parameter in known.items()}
    if vehicle.name != model_of(own):
        _check_parameters(wanted.parameters, vehicle.name, known, diagnostics)
        return vehicle.parameters, nominal | wanted.parameters, known
    changes = {} if isinstance(own, str) else {name: each for name, each in own.items() if each is not None and name in known}
    varied = manifest.varied_parameters
    known |= {each.name: each for each in varied}
    _check_parameters(wanted.parameters, vehicle.name, known, diagnostics)
    return varied, nominal | changes | {each.name: each.nominal for each in varied} | wanted.parameters, known


def _check_parameters(
    given: Mapping[str, float],
    owner: str,
    known: Mapping[str, VehicleParameter],
    diagnostics: Diagnostics,
    section: str = "vehicle",
) -> None:
    """Adds a problem for each given value whose parameter is unknown or whose range does not hold it."""
    for name, value in given.items():
        field, parameter = f"{section}.parameters.{name}", known.get(name)
        if parameter is None:
            remedy = f"one of {', '.join(known)}" if known else "leave it out"
            diagnostics.add(field, f"{owner} has no such parameter", remedy)
        elif not parameter.minimum <= value <= parameter.maximum:
            remedy = f"between {parameter.minimum:g} and {parameter.maximum:g} {parameter.unit}"
            diagnostics.add(field, f"{value:g} {parameter.unit} is outside its range", remedy)


def _notes(bundle: Bundle) -> tuple[str, ...]:
    section = bundle.manifest.simulator
    given_seed = isinstance(section, CommandSimulator) and any("{seed}" in word for word in section.command)
    unsaid = "its command gets {seed}, and problem.yaml does not say `random: true`: each set runs under seed 1 alone"
    notes = (unsaid,) if given_seed and not section.random else ()
    if not section.asks_workers or bundle.tools is None:
        return notes
    answer = " ".join(bundle.tools.split())
    shown = answer if len(answer) <= LONGEST_ANSWER else f"{answer[:LONGEST_ANSWER]}..."
    asked = "tools and inputs outside of the folder" if section.probe is None else f"`{' '.join(section.probe)}`"
    return (*notes, f"{asked}: the answer on the workers is {shown!r}; results under another one are not reused")


def _refuse_driving_settings(wanted: Wanted, problem: str, diagnostics: Diagnostics) -> None:
    given = {"driving_function": wanted.driving_function, "vehicle.model": wanted.vehicle.model}
    for name, value in given.items():
        if value is not None:
            diagnostics.add(name, f"the problem {problem} has its own simulator", "leave it out, or name another problem")


def _scenarios(catalogue: str | list[str] | None, manifest: Manifest, diagnostics: Diagnostics) -> dict[str, Mapping[str, Any]]:
    """Returns the data of the chosen scenarios, from the manifest and, for drivecal's own planner, from installed catalogues."""
    if catalogue in (None, manifest.problem):
        return dict(manifest.scenarios)
    listed = [catalogue] if isinstance(catalogue, str) else catalogue
    own: dict[str, Mapping[str, Any]] = {name: data for name, data in manifest.scenarios.items() if name in listed}
    others = catalogue if isinstance(catalogue, str) else [name for name in listed if name not in own]
    if manifest.has_planner and others and not (isinstance(catalogue, str) and own):
        result = resolvers.find_scenarios(others, listed, diagnostics)
        return {**own} | {name: {"catalogue": owner, "scenario": name} for name, (owner, _) in result.items()}
    for index, name in enumerate(listed):
        if name not in manifest.scenarios:
            remedy = f"one of {', '.join(manifest.scenarios)}"
            diagnostics.add(f"catalogue[{index}]", f"{manifest.problem} has no scenario {name!r}", remedy)
    return own


def _score(wanted: Wanted, manifest: Manifest, diagnostics: Diagnostics) -> tuple[str, Evaluator | None] | None:
    """Returns the campaign's score, and the evaluator that computes it, None for a formula.

    `evaluator` names the score; if it is missing, the first objective with a score does, else the manifest's first score counts. If
    `evaluator` is an installed evaluator, it replaces the evaluator of the first score that has one.
    """
    evaluator, scores = wanted.evaluator, manifest.scores
    rated = next((name for name, entry in scores.items() if entry.evaluator is not None), None)
    if evaluator in scores:
        name = evaluator
    elif evaluator is None:
        objectives = wanted.objectives if isinstance(wanted, CampaignSpecification) else None
        named = [each.score for each in objectives or () if each.score in scores]
        name = next((score for score in named if score is not None), next(iter(scores)))
    elif rated is not None:
        result = diagnostics.attempt(lambda: registry.evaluator(evaluator))
        return None if result is None else (rated, result)
    else:
        diagnostics.add("evaluator", f"{manifest.problem} has no score {evaluator!r}", f"one of {', '.join(scores)}")
        return None
    chosen = scores[name].evaluator
    if chosen is None:
        return name, None
    result = diagnostics.attempt(lambda: registry.evaluator(chosen))
    return None if result is None else (name, result)
