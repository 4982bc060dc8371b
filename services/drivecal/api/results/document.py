"""The document of a campaign's results, from stored rows."""

import json
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from math import prod
from typing import Any

from sqlalchemy import Connection

from drivecal.analysis.goals import SCORE, Objective
from drivecal.analysis.replicates import rate_bounds
from drivecal.analysis.savings import MapOrigin, account
from drivecal.analysis.trust import BesideBaseline, Chosen, Compromises, Evidence, SearchCourse, trust
from drivecal.api.responses import campaign_answer
from drivecal.api.results.curves import shapes_with_good_sets
from drivecal.api.tables.front import bound_text, bounded_texts, summary
from drivecal.api.tables.ranking import variants_of
from drivecal.campaigns.resolve.maps import measure
from drivecal.campaigns.resolve.resolved_spec import ResolvedSpec, specification_of, stored_scale
from drivecal.campaigns.resolve.spaces import Function
from drivecal.campaigns.resolve.workbench import bundles_of, find_workbench
from drivecal.campaigns.results.failures import causes_of
from drivecal.campaigns.results.front import CampaignFront, StoredRanking, front_of
from drivecal.contracts.assignments import value_text
from drivecal.contracts.campaign import Study
from drivecal.contracts.evaluation import FailureCause
from drivecal.contracts.results import Accounting, CampaignResults, ResultTrust, StudyResult
from drivecal.contracts.setup import CampaignSetup, ScenarioSetup, SearchedParameter
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.errors import Diagnostics
from drivecal.domain.evaluations import Outcome
from drivecal.domain.parameters import Parameter
from drivecal.domain.setups import Setup
from drivecal.domain.values import Value
from drivecal.storage import campaigns, evaluations, generations, lots, results, studies
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.types import now
from drivecal.storage.references import influence_maps, setups
from drivecal.storage.studies import StoredStudy

SAME_FOR_A_MAP = ("setups", "evaluator", "space", "fixed")
"""Parts of the setup that a validation shares with every campaign whose map it confirms, in addition to the measure of the scale."""


def results_of(
    stored: StoredRanking, front: CampaignFront | None = None, place: tuple[int, int] | None = None
) -> CampaignResults:
    """Returns the document. `front`: the campaign's, or a variant's, if it is known already. `place`: iteration and individual of a set
    that the verdicts are about, in the place of the best. Raises NotFoundError if the search has no such place."""
    database, campaign = stored.database, stored.campaign
    known = setup_of(stored)
    with database.read() as connection:
        answered = any(cells.get("requested") for cells in campaign.stages.values())
        accounting = account_of(connection, campaign) if answered else None
        causes = causes_of(connection, campaign) if answered else []
        made = studies_of(connection, campaign)
    objectives = campaign.resolution is not None and bool(campaign.spec.get("objectives")) and campaign.best is not None
    if front is None and (objectives or place is not None):
        front = front_of(stored)
    chosen = None if front is None or place is None else set_at(front, place)
    is_best = chosen is not None and campaign.best is not None and chosen.parameters == campaign.best.parameters
    if is_best and front is not None and len(front.goals.objectives) == 1 and front.goals == stored.resolved.goals:
        chosen = None  # its verdicts are the campaign's; a variant has its own
    return CampaignResults(
        campaign=campaign_answer(campaign, now(), silent=None),
        setup=known,
        trust=_trust(stored, made, causes, front, chosen),
        accounting=accounting,
        front=summary(front) if objectives and front is not None else None,
        failures=causes,
        variants=variants_of(stored),
        studies=made,
    )


def setup_of(stored: StoredRanking) -> CampaignSetup:
    """Returns the parameters, versions and fingerprints that a campaign began with; while it is queued, the current ones."""
    campaign, begun_with = stored.campaign, stored.resolved
    with stored.database.read() as connection:
        documents = setups.documents(connection, list(begun_with.setups.values()))
        words = _descriptions(_function(connection, campaign))
    scenarios = [_scenario(name, begun_with, documents) for name in begun_with.weights]
    return CampaignSetup(
        evaluator=begun_with.evaluator,
        parameters=[_searched(parameter, begun_with.space.fixed, words) for parameter in begun_with.space.parameters],
        scenarios=scenarios,
        server=version("drivecal"),
        settings=settings_of(campaign.spec, scenarios, begun_with.evaluator),
        constraints=[bound_text(bound) for bound in begun_with.goals.bounds],
        shapes=shapes_with_good_sets(stored),
    )


def studies_of(connection: Connection, campaign: StoredCampaign) -> list[StudyResult]:
    """Returns the studies that succeeded with their rows, those in the campaign's own vehicle first, the newest first."""
    made = [study for study in about(connection, campaign) if study.state == CampaignState.SUCCEEDED]
    result = []
    for study in sorted(made, key=lambda each: not studies.is_in_own_vehicle(each, campaign)):
        document = studies.get(connection, study.campaign_sequence, study.stage) or {"items": []}
        if document["items"]:
            result.append(StudyResult(study=study_answer(study, campaign), **{study.stage: document["items"]}))
    return result


def account_of(connection: Connection, campaign: StoredCampaign) -> Accounting:
    """Returns savings of cells answered without a simulation, cost of the sensitivity stage, and the break-even of its map."""
    rows = evaluations.costs_by_outcome(connection, campaign.sequence)
    predictors: dict[str, float] = defaultdict(float)
    # `released` sums up the lots of whole generations
    for lot in lots.of_campaign(connection, campaign.sequence, Outcome.PREDICTED):
        predictors[lot.scenario] += lot.seconds
    known = [*campaign.error_rate, *(row.scenario for row in rows if row.stage is StageName.CALIBRATION)]
    return account(
        campaign.id,
        dict.fromkeys(known),
        rows,
        _map_origin(connection, campaign),
        evaluations.confirmed(connection, campaign.sequence),
        predictors,
        0.0 if campaign.search is None else campaign.search.reuse_seconds,
        evaluations.runs_by_purpose(connection, campaign.sequence),
        sum(cells.get("lost", 0) for cells in campaign.stages.values()),
    )


def _map_origin(connection: Connection, campaign: StoredCampaign) -> MapOrigin | None:
    """Returns the map in use and what it cost; None without a map."""
    if campaign.influence_map_id is None:
        return None
    stored = influence_maps.get(connection, campaign.influence_map_id)
    if stored.basis is None:
        return MapOrigin(stored.id, made_by=None)
    maker = campaigns.get(connection, stored.source)
    return MapOrigin(stored.id, maker.id, evaluations.costs_by_outcome(connection, maker.sequence))


def _trust(
    stored: StoredRanking,
    made: list[StudyResult],
    causes: list[FailureCause],
    front: CampaignFront | None,
    chosen: Chosen | None,
) -> ResultTrust:
    campaign = stored.campaign
    with stored.database.read() as connection:
        search = _search(connection, stored)
        is_random = evaluations.are_seeded(connection, campaign.sequence)
    noise = stored.sets.by_objective()[1] if is_random and campaign.state.ended else []
    if search is not None and search.course and campaign.best is not None and campaign.best.alternatives > 1:
        search = replace(search, regions=stored.best_regions())
    best, goals, bounded = campaign.best, stored.resolved.goals, list[str]()
    if best is not None and best.constraints:
        bounded = bounded_texts(goals, (best.constraints[name] for name in goals.bound_names), best.replicates)
    unknown = is_random and campaign.state.ended and not (noise and all(each.is_known for each in noise))
    compromises = _compromises(stored, front)
    has_failures = any(cause.kind == "failed" for cause in causes)
    at_worst = _at_worst(stored, front, chosen)
    known = Evidence(made, search, compromises, chosen, bounded, at_worst, has_failures, is_random, unknown)
    return trust(campaign_answer(campaign, now(), silent=None), known)


def _at_worst(stored: StoredRanking, front: CampaignFront | None, chosen: Chosen | None) -> list[str]:
    """Returns the scores by scenario that count as a failed run's, though the runs of the judged sets did not fail."""
    goals, best = stored.resolved.goals, stored.sets.best() if stored.campaign.cells.cut else None
    if best is None:
        return []
    judged: Collection[int] = {best[0].parameter_set}
    if chosen is not None:
        judged = {chosen.parameter_set}
    elif front is not None and len(goals.objectives) > 1:
        judged = front.ranks.keys()
    worst: dict[tuple[str, str], set[int]] = {}
    for cell in stored.answers:
        for goal in (*goals.objectives, *goals.bounds) if cell.parameter_set in judged and not cell.failed else ():
            key, scale = goal.value.key, goal.value.scale
            value = cell.score if key == SCORE else cell.values.get(key)
            if scale is not None and cell.scenario in goal.shares and value == scale.failed:
                worst.setdefault((scale.name, cell.scenario), set()).add(cell.parameter_set)
    of = f" of {len(judged):,} sets" if len(judged) > 1 else ""
    return [f"{name} in {scenario}{of and f' ({len(sets):,}{of})'}" for (name, scenario), sets in worst.items()]


def _compromises(stored: StoredRanking, front: CampaignFront | None) -> Compromises | None:
    """Returns the front of several objectives in numbers, without sets before the end; None with a single objective."""
    campaign = stored.campaign
    if campaign.resolution is None or len(stored.resolved.goals.objectives) == 1:
        return None
    if not campaign.state.ended:
        return Compromises(0, None)
    front = front or front_of(stored)
    baseline, last = front.baseline, max((each.iteration for each in front.ranked), default=0)
    return Compromises(
        len(front.members),
        None if baseline is None else front.dominating(baseline),
        is_close=baseline is not None and baseline.parameter_set in front.unbeaten,
        copied=sum(bool(member.solution.reused) for member in front.members),
        failing=sum(bool(member.solution.failed) for member in front.members),
        failed=list(dict.fromkeys(scenario for member in front.members for scenario in member.solution.failed)),
        late=sum(2 * member.solution.iteration > last for member in front.members),
    )


def set_at(front: CampaignFront, place: tuple[int, int]) -> Chosen:
    """Returns the set at a `place` of the search, its iteration and individual, with its objectives and the objectives of the
    baseline. Raises NotFoundError if the search has no such place."""
    campaign, scenario, baseline = front.stored.campaign, next(iter(front.goals.objectives[0].shares)), front.baseline
    with front.stored.database.read() as connection:
        cell = results.by_id(connection, next(iter(results.cells_at(connection, campaign.sequence, *place, scenario).values())))
    parameters = cell.parameters.floats
    judged = next((each for each in front.ranked if each.parameter_set == cell.parameter_set_id), None)
    if judged is None:
        return Chosen(parameters, is_judged=False)
    if baseline is not None and judged.parameter_set in front.reports:
        baseline = front.reports.get(baseline.parameter_set, baseline)
    judged = front.reports.get(number := judged.parameter_set, judged)
    whole = front.stored.sets.get(number) or judged  # by all of its seeds
    compared: list[BesideBaseline] = []
    if baseline:
        amounts = zip(front.goals.objectives, judged.judgement.amounts, baseline.judgement.amounts, strict=True)
        compared = [
            BesideBaseline(goal.name, value, before, goal.sign, goal.unit, _tolerance(goal, len(front.goals.objectives)))
            for goal, value, before in amounts
        ]
    return Chosen(
        parameters=parameters,
        parameter_set=number,
        compared=compared,
        copied=judged.reused,
        failed=judged.failed,
        scenarios=len(judged.scores),
        bounded=bounded_texts(front.goals, judged.judgement.bounded, judged.replicates),
        failures=whole.failures,
        failure_interval=rate_bounds(*front.stored.sets.failed_runs(number)) if whole.replicates > 1 else None,
        violation=judged.violation,
        undecided=judged.is_undecided,
        baseline_violation=0.0 if baseline is None or baseline.is_undecided else baseline.violation,
    )


def _tolerance(goal: Objective, objectives: int) -> float:
    """Returns the differences that do not count: the objective's own; if it is the only one, else the tolerance of its score's scale."""
    if goal.tolerance or objectives > 1 or goal.value.scale is None:
        return goal.tolerance
    return goal.value.scale.tolerance


def _search(connection: Connection, stored: StoredRanking) -> SearchCourse | None:
    """Returns the course of an ended search; None before its end."""
    campaign, begun_with = stored.campaign, stored.resolved
    if not campaign.state.ended or campaign.resolution is None:
        return None
    searched = [parameter for parameter in begun_with.space.searched if parameter.kind != "choice" and parameter.n_values > 2]
    ranges = {parameter.name: (float(parameter.lower), float(parameter.upper)) for parameter in searched}
    function = _function(connection, campaign)
    coefficients = {name for shape in (function.shapes.values() if function else ()) for name in shape.names}
    titles = {name: words for name, words in _descriptions(function).items() if name in coefficients}
    limits = {} if function is None else {each.name: _limits(function, each) for each in searched}
    course = [] if len(begun_with.goals.objectives) > 1 else generations.course(connection, campaign.sequence)
    whole = all(parameter.kind != "continuous" for parameter in begun_with.space.searched)
    grid = prod(parameter.n_values for parameter in begun_with.space.searched) if whole else 0
    requested = campaign.cells.proposed // max(1, len(begun_with.weights))
    # a search by the cell leaves scenarios of sets out; of a long one, the share is negligible, and counting takes as long as reading it
    is_exact = grid > 0 and (campaign.cells.proposed <= 10_000 or 100 * requested >= grid)
    if is_exact:
        requested = results.number_of_sets(connection, campaign.sequence, StageName.CALIBRATION)
    return SearchCourse(course, ranges, requested, grid, is_exact, titles=titles, limits=limits)


def _searched(parameter: Parameter, fixed: Mapping[str, Value], descriptions: Mapping[str, str]) -> SearchedParameter:
    held = fixed.get(parameter.name)
    value = held if held is None or isinstance(held, str) else float(held)
    return SearchedParameter.of(parameter, fixed=value, description=descriptions.get(parameter.name, ""))


def _function(connection: Connection, campaign: StoredCampaign) -> Function | None:
    """Returns what a campaign tests; None for a problem or driving function that is gone."""
    return find_workbench(specification_of(campaign), bundles_of(connection), Diagnostics()).function


def _limits(function: Function, parameter: Parameter) -> tuple[str | None, str | None]:
    """Returns the `limits` of `SearchCourse` for a parameter."""
    owner = next((name for name, shape in function.shapes.items() if parameter.name in shape.names), parameter.name)
    own, limits = function.name in function.spaces, function.limits.get(parameter.name, (None, None))
    ends = ("lower", parameter.lower, limits[0]), ("upper", parameter.upper, limits[1])
    lower, upper = (
        "" if limit != float(end) else f"`{key}: {value_text(limit)}` of {owner}" if own else None for key, end, limit in ends
    )
    return lower, upper


def _descriptions(function: Function | None) -> dict[str, str]:
    spaces = {} if function is None else function.spaces
    return {parameter.name: parameter.description for space in spaces.values() for parameter in space}


def _scenario(name: str, begun_with: ResolvedSpec, documents: Mapping[str, Mapping[str, Any]]) -> ScenarioSetup:
    fingerprint = begun_with.setups[name]
    known: dict[str, Any] = {}
    if fingerprint in documents:
        setup = Setup(name, documents[fingerprint])
        data = setup.document["data"]
        known |= {"simulator": setup.simulator, "files": setup.document["files"], "title": str(data.get("title", ""))}
        known |= {"driving_function": setup.document.get("controller"), "vehicle": setup.document.get("vehicle")}
        known |= {"vehicle_parameters": dict(setup.varied) or None}
    return ScenarioSetup(scenario=name, weight=begun_with.weights[name], fingerprint=fingerprint, **known)


def about(connection: Connection, campaign: StoredCampaign) -> list[StoredStudy]:
    """Returns the studies of a campaign's best sets and its map, also by other campaigns, the newest first."""
    made = studies.about(connection, campaign.id, campaign.sequence, campaign.influence_map_id)
    return [study for study in made if _of_the_same(study, campaign)]


def _of_the_same(made: StoredStudy, campaign: StoredCampaign) -> bool:
    """Returns whether a study is about this campaign: about its sets, or about its map with equal scenarios, space, evaluator and scale."""
    if made.campaign_sequence == campaign.sequence or made.stage == "robustness":
        return True
    theirs, ours = made.resolution, campaign.resolution
    return theirs is not None and ours is not None and is_same_for_a_map(theirs, ours)


def is_same_for_a_map(theirs: Mapping[str, Any], ours: Mapping[str, Any]) -> bool:
    """Returns whether campaigns with these resolutions can use the same maps."""
    alike = measure(stored_scale(theirs)) == measure(stored_scale(ours))
    return alike and all(theirs.get(field) == ours.get(field) for field in SAME_FOR_A_MAP)


def study_answer(made: StoredStudy, campaign: StoredCampaign) -> Study:
    """Returns a study of the results of a campaign."""
    own, settings = studies.is_in_own_vehicle(made, campaign), made.spec.get(made.stage) or {}
    return Study.of(made, settings=settings, vehicle=(made.spec.get("vehicle") or {}).get("model"), in_own_vehicle=own)


def settings_text(value: object) -> str:
    """Returns settings in one line, without empty ones."""
    if isinstance(value, list):
        return "; ".join(map(settings_text, value))
    if not isinstance(value, dict):
        return value if isinstance(value, str) else json.dumps(value)
    kept = {name: item for name, item in value.items() if name != "kind" and item is not None and item not in ([], {})}
    settings = ", ".join(f"{name} {item if isinstance(item, str) else json.dumps(item)}" for name, item in kept.items())
    return ": ".join(filter(None, [value.get("kind"), settings]))


_SECTIONS = ("baseline", "optimizer", "budget", "objectives", "constraints", "variants", "sensitivity", "reduction")
ASKED = {"Held fixed": "fixed", **{name.capitalize(): name for name in (*_SECTIONS, "robustness", "validation")}}
"""Fields of a specification by the words for them."""
USED = {"Driving function": "driving_function", "Vehicle": "vehicle", "Simulator": "simulator", "Files": "files"}
"""Fields of a scenario's setup by the words for them."""


def settings_of(spec: Mapping[str, Any], scenarios: Sequence[ScenarioSetup], evaluator: str) -> dict[str, str]:
    """Returns what was asked for in words: problem, versions in use, settings of the stages."""
    used = {
        title: ", ".join(dict.fromkeys(value for scenario in scenarios if (value := getattr(scenario, field))))
        for title, field in USED.items()
    }
    problem = {"Problem": str(spec.get("problem", ""))}
    stages = {title: settings_text(spec[field]) for title, field in ASKED.items() if spec.get(field)}
    known = problem | used | {"Evaluator": evaluator} | stages
    return {title: text for title, text in known.items() if text}
