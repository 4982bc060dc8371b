"""Checks of requests, and what they are expected to cost, without a change of the database."""

import math
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any, TypeVar

from sqlalchemy import Connection

from drivecal.api.dependencies import Limits
from drivecal.api.live.dispatcher_health import judge
from drivecal.api.tables.ranking import solution_pages
from drivecal.campaigns.cells.earlier import earlier_versions, sample, unclaimed
from drivecal.campaigns.comparison import ComparisonProblem, resolve_comparison
from drivecal.campaigns.resolve.bench import Bench
from drivecal.campaigns.resolve.maps import check_basis, warnings_of
from drivecal.campaigns.resolve.outside import indices_of
from drivecal.campaigns.resolve.problem import CalibrationProblem, resolve
from drivecal.campaigns.resolve.workbench import moved, stored_bundles
from drivecal.campaigns.results.front import StoredRanking
from drivecal.campaigns.stages.prediction_validation import check_predictions, runs_at_most
from drivecal.campaigns.stages.robustness import check_source
from drivecal.contracts.campaign import STUDIES, ExpectedRuns, Pace
from drivecal.contracts.comparison import ComparisonSpecification, ExpectedComparison
from drivecal.contracts.outside.sets import ProposedSet
from drivecal.contracts.specification import CampaignSpecification, GoalSpecification, MapReference, Values
from drivecal.domain.errors import Diagnostics, InvalidInputError, NotFoundError, Problem, TooLargeError, restated
from drivecal.storage import campaigns, processes
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
from drivecal.storage.outside import imported
from drivecal.storage.references import influence_maps, runs
from drivecal.storage.references.influence_maps import StoredInfluenceMap

MAP = "sensitivity.map"
Specified = TypeVar("Specified", CampaignSpecification, ComparisonSpecification)
ASSUMED_MILLISECONDS = 8.0
"""CPU time of one simulation in the built-in scenarios, on a machine of today."""


def pace(connection: Connection, limits: Limits, bench: Bench, simulations: int) -> Pace:
    """Returns the time of simulations of a bench, whose resources exist."""
    measured = runs.recent_milliseconds(connection, [setup.fingerprint for setup in bench.setups.values()])
    dispatcher = processes.read(connection, processes.DISPATCHER)
    workers = None
    if dispatcher is not None and not judge(dispatcher, now()).silent:
        exist, wanted = limits.settings.resources, [request.resources for request in bench.requests.values()]
        at_a_time = [exist[name] // count for each in wanted for name, count in each.items() if count]
        workers = min([len(dispatcher.detail.get("workers", [])), *at_a_time]) or None
    each = measured or ASSUMED_MILLISECONDS
    seconds = None if workers is None else simulations * each / 1000 / workers
    return Pace(milliseconds=each, measured=measured is not None, workers=workers, seconds=seconds)


def expected(database: Database, limits: Limits, specification: CampaignSpecification) -> ExpectedRuns:
    """Returns the expected cost of a campaign. Raises InvalidInputError and TooLargeError as `submit` does."""
    problem = checked(database, limits, specification)
    runs = problem.expected_runs()
    with database.read() as connection:
        used = stored_parts(connection, problem)
        warnings = warnings_of(connection, problem, used, now())
        runs = runs.model_copy(update={"validation": runs.validation + runs_at_most(connection, problem)})
        versions = [] if problem.specification.reduction.mode == "off" else earlier_versions(connection, problem.bench)
        claims = len(sample(connection, problem.bench, versions, problem.space, sys.maxsize))
        warnings += [] if claims else unclaimed(connection, problem.bench.bundle.digest, problem.bench.bundle.manifest)
        at_most = claims + runs.sensitivity_at_most + runs.calibration_at_most + sum(getattr(runs, study) for study in STUDIES)
        known = pace(connection, limits, problem.bench, at_most)
    warnings += [f"claims of problem.yaml: {claims} stored cells at most are simulated again first"] if claims else []
    # nothing is known of a simulator that never ran
    guessed = not known.measured and not problem.bench.bundle.manifest.has_planner
    each, seconds, chosen = known.milliseconds, known.seconds, problem.optimization
    if seconds is not None and chosen is not None:
        search = seconds * runs.calibration_at_most / max(1, at_most)
        choice = CELL_MILLISECONDS / 1000 * runs.calibration_at_most if chosen.plugin.name == "surrogate" else 0.0
        minutes = math.inf if chosen.budget is None or chosen.budget.minutes is None else chosen.budget.minutes
        seconds += min(search + choice, 60.0 * minutes) - search
    time = {} if guessed else {"milliseconds": each, "measured": known.measured, "seconds": seconds}
    notes = [*warnings, *runs.notes, *(advice(problem, runs.calibration_at_most, each) if known.measured and each else [])]
    return runs.model_copy(update={"notes": notes, "workers": known.workers, **time})


CELL_MILLISECONDS = 20.0
"""CPU time of `surrogate` for the choice of a cell, with some hundred answers of six scenarios."""
WORTHWHILE_MILLISECONDS = 200.0
"""Time of a simulation from which on a careful choice costs less than a tenth of it."""
MOST_MODELLED = 5_000
"""Simulations up to which `surrogate` is advised."""


def advice(problem: CalibrationProblem, simulations: int, milliseconds: float) -> list[str]:
    """Returns notes on a better choice of the optimizer, if there is one.

    Args:
        problem: the campaign.
        simulations: at most, of its search.
        milliseconds: time of one simulation.
    """
    chosen = problem.optimization
    if chosen is None:
        return []
    if chosen.plugin.name == "surrogate" and milliseconds < CELL_MILLISECONDS:
        takes = f"a simulation takes {milliseconds:.3g} ms, and the choice of a cell about {CELL_MILLISECONDS:g} ms of a core"
        remedy = "with several times the simulations `optimizer: {kind: genetic}` may find as good a set in the same time"
        return [f"{takes}: {remedy}"]
    if chosen.has_populations and milliseconds >= WORTHWHILE_MILLISECONDS and simulations <= MOST_MODELLED:
        better = "`optimizer: {kind: surrogate}` and a budget find better sets on most problems (docs: optimizers)"
        return [f"for {simulations:,} simulations of {milliseconds:.3g} ms, {better}"]
    return []


def resolved(database: Database, specification: CampaignSpecification, *, again: bool = False) -> CalibrationProblem:
    """Returns the resolved campaign, whose start sets include the sets of `start_results`. Raises InvalidInputError with every fault, a
    missing map's included. `again`: it was resolved before, and the results may have been deleted since."""
    wanted, bundles = specification.optimizer, stored_bundles(database)
    goals = {name: given for name in ("objectives", "constraints") if (given := getattr(specification, name))}
    measured = {name: [_with_set(database, goal, specification.problem) for goal in given] for name, given in goals.items()}
    specification = _with_full_ids(database, specification.model_copy(update=measured))
    try:
        problem = resolve(specification, bundles)
        if wanted is None or wanted.start_results is None:
            return problem
        sets = _imported_sets(database, problem, wanted.start_results, again=again)
        begin = [*wanted.start_sets, *(each for each in sets if each not in wanted.start_sets)]
        begun = wanted.model_copy(update={"start_sets": begin})
        with restated(lambda each: replace(each, field="optimizer.start_results")):
            return resolve(specification.model_copy(update={"optimizer": begun}), bundles)
    except InvalidInputError as error:
        own = error.problems
    diagnostics = Diagnostics()
    if isinstance(specification.sensitivity, MapReference):
        diagnostics.attempt(lambda: database.query(_stored_map, specification))
    raise InvalidInputError(*own, *diagnostics.problems)


def _with_full_ids(database: Database, specification: Specified) -> Specified:
    """Returns a specification with the whole ids of the map and the campaigns that it names; unknown ones stay."""
    whole: dict[str, Any] = {}
    names: dict[str, tuple[str, Callable[[Connection, str], Any]]] = dict.fromkeys(STUDIES, ("of", campaigns.get))
    names["sensitivity"] = "map", influence_maps.get
    with database.read() as connection:
        for section, (name, stored) in names.items():
            settings: Any = getattr(specification, section, None)
            if given := getattr(settings, name, None):
                with suppress(NotFoundError):
                    whole[section] = settings.model_copy(update={name: stored(connection, given).id})
    return specification.model_copy(update=whole)


def _with_set(database: Database, goal: GoalSpecification, problem: str) -> GoalSpecification:
    """Returns a goal with the values of the set of a campaign, `ID` or `ID#2`, from which it counts changes; unknown ones stay."""
    for name in ("changes", "distance"):
        if isinstance(given := getattr(goal, name), str) and given != "baseline":
            identifier, mark, rank = given.partition("#")
            try:
                with database.read() as connection:
                    campaign = campaigns.get(connection, identifier)
                    if moved(connection, campaign.spec["problem"], problem):
                        return goal
            except NotFoundError:
                return goal
            place = 1 if not mark else int(rank) if rank.isdecimal() else 0
            ranked = solution_pages(StoredRanking.of(database, campaign))
            for solution in ranked.solutions(max(0, place - 1), place):
                return goal.model_copy(update={name: solution.parameters})
    return goal


def _imported_sets(database: Database, problem: CalibrationProblem, source: str, *, again: bool) -> list[Values]:
    """Returns the sets of a source of results from elsewhere, at the nearest grid points, each once."""
    field, name = "optimizer.start_results", problem.bench.bundle.manifest.problem
    rows = database.query(imported.listing, name, source)
    if not rows and not again:
        raise InvalidInputError(
            Problem(field, f"{name} has no results of {source!r}", f"`drivecal results list {name}` lists what there is")
        )
    if any(row.form != problem.bench.bundle.manifest.form for row in rows):
        remedy = f"delete them (`drivecal results delete {name}`) and import them again, with curves as lists of values"
        raise InvalidInputError(Problem(field, "its sets belong to other curves or maps than the problem has now", remedy))
    given = dict.fromkeys(row.parameters for row in rows)
    sets = [ProposedSet(key=str(number), parameters=dict(each.floats)) for number, each in enumerate(given)]
    remedy = "name the sets that fit in `start_sets`, or change the bounds"
    with restated(lambda fault: Problem(field, str(fault), remedy)):
        points = problem.space.parameter_sets(indices_of(problem, sets, Diagnostics()))
    return [dict(each.floats) for each in points]


def refuse_without(limits: Limits, bench: Bench) -> None:
    """Raises InvalidInputError if a run needs more of a resource than the server has."""
    exist, diagnostics = limits.settings.resources, Diagnostics()
    lacking = {
        name: (scenario, count)
        for scenario, request in bench.requests.items()
        for name, count in request.resources.items()
        if count > exist.get(name, 0)
    }
    for name, (scenario, count) in lacking.items():
        message = f"scenario {scenario} needs {count} {name}, and this server has {exist.get(name, 0)}"
        remedy = f"start the server with --resources {name}={count} or more, or leave the scenario out"
        diagnostics.add("problem", message, remedy)
    diagnostics.raise_if_any()


def checked(database: Database, limits: Limits, given: CampaignSpecification, *, again: bool = False) -> CalibrationProblem:
    """Returns the campaign as `resolved`. Raises TooLargeError if its stages propose too many cells, and InvalidInputError if it needs more
    of a resource than there is."""
    problem, largest = resolved(database, given, again=again), limits.settings.largest_campaign
    refuse_without(limits, problem.bench)
    runs = problem.expected_runs()
    stages = {"optimizer": runs.calibration_proposed, "sensitivity": runs.sensitivity_at_most} | {
        study: getattr(runs, study) for study in STUDIES
    }
    total = sum(stages.values())
    if total <= largest:
        return problem
    stage = max(stages, key=lambda name: stages[name])
    message = f"the campaign may propose {total:,} cells, {stages[stage]:,} of them here"
    wanted, what = problem.optimization, "samples or scenarios"
    if stage == "optimizer" and wanted is not None and wanted.iterations is None:
        message += f": a budget of {runs.calibration_proposed:,} simulations"
        what = "budget.simulations"
    elif stage == "optimizer" and wanted is not None:
        sizes = f"{wanted.population:,} individuals x {wanted.iterations:,} iterations x {len(problem.scenarios)} scenarios"
        message, what = f"{message}: {sizes}", "population, iterations or scenarios"
    raise TooLargeError(Problem(stage, message, f"this server takes {largest:,}; reduce {what}"))


def expected_comparison(database: Database, limits: Limits, specification: ComparisonSpecification) -> ExpectedComparison:
    """Returns the expected cost of a comparison. Raises InvalidInputError and TooLargeError as `compare` does."""
    problem = checked_comparison(database, limits, specification)
    with database.read() as connection:
        compared_map(connection, problem)
        known = pace(connection, limits, problem.problems[0].bench, problem.at_most)
    return ExpectedComparison.of(
        known,
        runs=len(problem.runs),
        proposed=problem.proposed,
        at_most=problem.at_most,
        notes=list(dict.fromkeys(note for resolved in problem.problems for note in resolved.notes)),
    )


def checked_comparison(database: Database, limits: Limits, specification: ComparisonSpecification) -> ComparisonProblem:
    """Returns the resolved comparison. Raises TooLargeError and InvalidInputError as `checked` does."""
    problem = resolve_comparison(_with_full_ids(database, specification), stored_bundles(database))
    refuse_without(limits, problem.problems[0].bench)
    if problem.proposed > limits.settings.largest_campaign:
        message = f"the {len(problem.runs):,} campaigns of the comparison may propose {problem.proposed:,} cells"
        remedy = f"this server takes {limits.settings.largest_campaign:,}; reduce populations, iterations, seeds, optimizers or scenarios"
        raise TooLargeError(Problem("populations", message, remedy))
    return problem


def compared_map(connection: Connection, problem: ComparisonProblem) -> str | None:
    """Returns the id of the influence map that the comparison names. Raises InvalidInputError if it does not fit the campaigns."""
    return next((named_map(connection, row) for row in problem.problems if row.specification.sensitivity is not None), None)


def stored_parts(connection: Connection, problem: CalibrationProblem) -> str | None:
    """Returns the id of the map that a campaign names. Raises InvalidInputError if the map or a campaign that it names does not fit."""
    diagnostics = Diagnostics()
    used = diagnostics.attempt(lambda: named_map(connection, problem))
    diagnostics.attempt(lambda: check_source(connection, problem))
    diagnostics.attempt(lambda: check_predictions(connection, problem))
    diagnostics.raise_if_any()
    return used


def _stored_map(connection: Connection, specification: CampaignSpecification) -> StoredInfluenceMap | None:
    if not isinstance(specification.sensitivity, MapReference):
        return None
    try:
        return influence_maps.get(connection, specification.sensitivity.map)
    except NotFoundError as error:
        raise InvalidInputError(Problem(MAP, str(error), "`drivecal influence-maps list` prints what there is")) from error


def named_map(connection: Connection, problem: CalibrationProblem) -> str | None:
    """Returns the id of the map that a campaign names. Raises InvalidInputError if it does not exist or fit the campaign."""
    stored = _stored_map(connection, problem.specification)
    if stored is None:
        return None
    if stored.driving_function != problem.bench.function:
        message, remedy = f"the map is about {stored.driving_function!r}", f"name or post a map of {problem.bench.function!r}"
        raise InvalidInputError(Problem(MAP, message, remedy))
    check_basis(stored, problem)
    return stored.id
