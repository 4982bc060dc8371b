"""Setups of a campaign, studies of its results, and the trust that it deserves."""

from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import version
from math import prod
from typing import Any

from fastapi import APIRouter
from sqlalchemy import Connection

from drivecal.analysis.chosen import Chosen
from drivecal.analysis.trust import Compromises, Driven, Search, Validated, trust
from drivecal.api.dependencies import DatabaseDependency, computed
from drivecal.api.http.bodies import StrictRoute
from drivecal.api.http.queries import ImportanceQuery, PlaceQuery
from drivecal.api.responses import calibration, campaign_answer
from drivecal.api.tables.chosen import set_at
from drivecal.api.tables.front import bound_text
from drivecal.api.tables.influence import importance
from drivecal.api.tables.ranking import earlier_best, later_best
from drivecal.campaigns.resolve.maps import measure
from drivecal.campaigns.resolve.meanings import Meanings, meanings
from drivecal.campaigns.resolve.resolved_spec import ResolvedSpec, resolved_spec, stored_document, stored_scale
from drivecal.campaigns.results.failures import causes_of
from drivecal.campaigns.results.front import CampaignFront, baseline_of, front_of
from drivecal.contracts.campaign import Study, StudyPage
from drivecal.contracts.evaluation import FailurePage
from drivecal.contracts.results import ImportanceAnswer, TrustAnswer
from drivecal.contracts.setup import CampaignSetup, ScenarioSetup, SearchedParameter
from drivecal.contracts.tables import RobustnessRow, ValidationRow
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.parameters import Parameter, Value
from drivecal.domain.setups import BundleSetup, DrivenSetup
from drivecal.storage import campaigns, generations, results, studies
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
from drivecal.storage.references import setups
from drivecal.storage.studies import StoredStudy

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["results"], route_class=StrictRoute)

SAME_FOR_A_MAP = ("setups", "evaluator", "space", "fixed")
"""Parts of the setup that a validation shares with every campaign whose map it confirms, beside the measure of the scale."""


@router.get("/setup")
def setup(campaign_id: str, database: DatabaseDependency) -> CampaignSetup:
    """The parameters, versions and fingerprints that the campaign began with; while it is queued, those of today."""
    with database.read() as connection:
        campaign = calibration(campaigns.get(connection, campaign_id))
        begun_with = resolved_spec(campaign)
        documents = setups.documents(connection, list(begun_with.setups.values()))
        words = meanings(connection, campaign.spec)
    return CampaignSetup(
        evaluator=begun_with.evaluator,
        parameters=[_searched(parameter, begun_with.space.fixed, words) for parameter in begun_with.space.parameters],
        scenarios=[_scenario(name, begun_with, documents, words) for name in begun_with.weights],
        server=version("drivecal"),
        constraints=[] if begun_with.goals is None else [bound_text(bound) for bound in begun_with.goals.bounds],
    )


@router.get("/importance")
@computed
def show_importance(campaign_id: str, query: ImportanceQuery, database: DatabaseDependency) -> ImportanceAnswer:
    """Dependence of the objective, or of the score of one scenario, on each parameter, among the sets of the search, under the campaign's
    weights and score or others."""
    with database.read() as connection:
        campaign = calibration(campaigns.get(connection, campaign_id), ", which has no search")
    return importance(database, campaign, resolved_spec(campaign), query)


@router.get("/studies")
def list_studies(campaign_id: str, database: DatabaseDependency) -> StudyPage:
    """The robustness and validation studies of its best sets and its map, its own and those of other campaigns, newest first."""
    with database.read() as connection:
        campaign = calibration(campaigns.get(connection, campaign_id))
        made = _about(connection, campaign)
    return StudyPage(items=[_study(study, campaign) for study in made])


@router.get("/trust")
@computed
def read_trust(campaign_id: str, query: PlaceQuery, database: DatabaseDependency) -> TrustAnswer:
    """A light for the campaign's result, or for the set at a place of its search, green, amber or red, and the reasons in words, the
    gravest first."""
    if query.place is None:
        return trust_in(database, campaign_id)
    with database.read() as connection:
        campaign = calibration(campaigns.get(connection, campaign_id), ", which needs no light")
    front = front_of(database, campaign, resolved_spec(campaign))
    chosen = set_at(database, campaign, front, query.place, baseline_of(database, campaign, front))
    return trust_in(database, campaign_id, front, chosen)


def trust_in(
    database: Database, campaign_id: str, front: CampaignFront | None = None, chosen: Chosen | None = None
) -> TrustAnswer:
    """Returns the light of a campaign's result, or of a `chosen` set. `front`: the campaign's, if it is known already."""
    with database.read() as connection:
        campaign = calibration(campaigns.get(connection, campaign_id), ", which needs no light")
        first = None if campaign.rerun_of is None else campaigns.get(connection, campaign.rerun_of, deleted=True)
        made = [study for study in _about(connection, campaign) if study.state == CampaignState.SUCCEEDED]
        documents = [(study, studies.get(connection, study.campaign_sequence, study.stage) or {"items": []}) for study in made]
        search, withdrawn = _search(connection, campaign), results.withdrawn(connection, campaign.sequence)
    validated = [
        Validated(study.campaign, [ValidationRow.model_validate(item) for item in document["items"]])
        for study, document in documents
        if study.stage == StageName.VALIDATION
    ]
    driven = [
        Driven(study.campaign, [RobustnessRow.model_validate(item) for item in document["items"]])
        for study, document in documents
        if study.stage == StageName.ROBUSTNESS and studies.is_in_own_vehicle(study, campaign)
    ]
    begun = replace(campaign, spec=stored_document(campaign.spec))  # with the settings that earlier releases had
    earlier = None if first is None else earlier_best(database, campaign, first)
    compromises = _compromises(database, campaign, front)
    later = None if compromises is not None else later_best(database, campaign, withdrawn)
    answer = campaign_answer(begun, now(), silent=None)
    return trust(answer, validated, driven, earlier, search, compromises, chosen, later, withdrawn)


def _compromises(database: Database, campaign: StoredCampaign, front: CampaignFront | None) -> Compromises | None:
    """Returns the front of several objectives in numbers, without sets before the end; None with a single objective."""
    if campaign.resolution is None or not has_several_objectives(campaign):
        return None
    if not campaign.state.ended:
        return Compromises(0, None)
    front = front or front_of(database, campaign, resolved_spec(campaign))
    baseline = baseline_of(database, campaign, front)
    copied = sum(bool(member.solution.reused) for member in front.members)
    return Compromises(len(front.members), None if baseline is None else front.dominating(baseline), copied)


@router.get("/failures")
def failures(campaign_id: str, database: DatabaseDependency) -> FailurePage:
    """The causes of its failed cells with their counts: no result, failures of the system under test, scores without a value."""
    with database.read() as connection:
        campaign = campaigns.get(connection, campaign_id)
        return FailurePage(items=causes_of(connection, campaign))


def has_several_objectives(campaign: StoredCampaign) -> bool:
    """Returns whether a campaign has a front in the place of a best set."""
    goals = resolved_spec(campaign).goals
    return goals is not None and len(goals.objectives) > 1


def _search(connection: Connection, campaign: StoredCampaign) -> Search | None:
    """Returns the course of an ended search; None before its end."""
    if campaign.state != CampaignState.SUCCEEDED or campaign.resolution is None:
        return None
    begun_with = resolved_spec(campaign)
    searched = [parameter for parameter in begun_with.space.searched if parameter.kind != "choice" and parameter.n_values > 2]
    ranges = {parameter.name: (float(parameter.lower), float(parameter.upper)) for parameter in searched}
    course = [] if has_several_objectives(campaign) else generations.course(connection, campaign.sequence)
    whole = campaign.pruned_at is None and all(parameter.kind != "continuous" for parameter in begun_with.space.searched)
    grid = prod(parameter.n_values for parameter in begun_with.space.searched) if whole else 0
    requested = campaign.cells.proposed // max(1, len(begun_with.weights))
    is_exact = 100 * requested >= grid > 0  # else the share is negligible, and counting takes as long as reading the campaign
    if is_exact:
        scenario = next(iter(begun_with.weights))
        requested = results.number_of_sets(connection, campaign.sequence, StageName.CALIBRATION, scenario)
    return Search(course, ranges, requested, grid, is_exact)


def _searched(parameter: Parameter, fixed: Mapping[str, Value], words: Meanings) -> SearchedParameter:
    as_it_is = {name: getattr(parameter, name) for name in SearchedParameter.model_fields if name != "fixed"}
    held = fixed.get(parameter.name)
    value = held if held is None or isinstance(held, str) else float(held)
    description = words.parameters.get(parameter.name, "")
    return SearchedParameter.model_validate(as_it_is | {"fixed": value, "description": description})


def _scenario(
    name: str, begun_with: ResolvedSpec, documents: Mapping[str, Mapping[str, Any]], words: Meanings
) -> ScenarioSetup:
    fingerprint = begun_with.setups[name]
    known: dict[str, Any] = {"title": words.scenarios.get(name, "")}
    document = documents.get(fingerprint, {})
    if "files" in document:
        known |= {"simulator": BundleSetup(name, document).simulator, "files": document["files"]}
    elif document:
        made_of = DrivenSetup.from_document(document)
        known |= {field: getattr(made_of, field) for field in ("scenario_digest", "simulator", "step_seconds", "seed")}
        known["driving_function"] = f"{made_of.driving_function} {made_of.driving_function_version}"
        known["vehicle"] = f"{made_of.vehicle} {made_of.vehicle_version}"
        known["vehicle_parameters"] = dict(made_of.vehicle_parameters)
    return ScenarioSetup(scenario=name, weight=begun_with.weights[name], fingerprint=fingerprint, **known)


def _about(connection: Connection, campaign: StoredCampaign) -> list[StoredStudy]:
    made = studies.about(connection, campaign.id, campaign.sequence, campaign.influence_map_id)
    return [study for study in made if _of_the_same(study, campaign)]


def _vehicle(spec: Mapping[str, Any]) -> str | None:
    model: str | None = (spec.get("vehicle") or {}).get("model")
    return model


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


def _study(made: StoredStudy, campaign: StoredCampaign) -> Study:
    as_it_is = {name: getattr(made, name) for name in Study.model_fields if hasattr(made, name)}
    own = studies.is_in_own_vehicle(made, campaign)
    return Study(**as_it_is, settings=made.spec.get(made.stage) or {}, vehicle=_vehicle(made.spec), in_own_vehicle=own)
