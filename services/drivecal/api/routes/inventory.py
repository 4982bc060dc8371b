"""Inventory: scenarios, parameter spaces, references, workers."""

from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Query, Request

from drivecal.api.dependencies import DatabaseDependency
from drivecal.api.live.dispatcher_health import judge
from drivecal.api.live.worker_time import RecentWork, running, window
from drivecal.bundles.archives import files_of
from drivecal.bundles.highway import TaskScenario
from drivecal.bundles.installed import installed
from drivecal.campaigns.resolve.workbench import stored_bundles
from drivecal.contracts.inventory import (
    BrokenPluginAnswer,
    OptimizerAnswer,
    OptimizerPage,
    ParameterAnswer,
    ParameterSpaceAnswer,
    ParameterSpacePage,
    ReferenceAnswer,
    ReferencePage,
    ResourceAnswer,
    RoadAnswer,
    ScenarioAnswer,
    ScenarioDetail,
    ScenarioPage,
    VehicleAnswer,
    WaitingAnswer,
    WorkerAnswer,
    WorkerPage,
)
from drivecal.domain.errors import NotFoundError
from drivecal.domain.parameters import Parameter
from drivecal.domain.roads import reference_line
from drivecal.domain.scales import COMFORT
from drivecal.domain.scenarios import EgoStart, Scenario, TrafficVehicle
from drivecal.domain.setups import Setup
from drivecal.domain.vehicles import CLOSED_LOOP_MEASURES
from drivecal.optimizers.repair import supported
from drivecal.plugins import registry
from drivecal.storage import bundles, campaigns, processes
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
from drivecal.storage.references import setups
from drivecal.storage.references.setups import SetupCount

router = APIRouter(tags=["inventory"])

SPACING = 5.0
"""Metres between the points of a drawn line: at a radius of 300 m they miss the curve by 1 cm."""
DIGITS = 6


@router.get("/scenarios")
def scenarios() -> ScenarioPage:
    """The scenarios of all installed catalogues, and the catalogues that cannot be used."""
    items = [
        ScenarioAnswer.of(scenario, **_heading(catalogue.name, scenario))
        for catalogue in registry.catalogues()
        for scenario in catalogue.scenarios.values()
    ]
    return ScenarioPage(
        items=items, scores=[COMFORT.name], measures=dict(CLOSED_LOOP_MEASURES), broken=_broken(registry.CATALOGUES)
    )


@router.get("/scenarios/{scenario_id}")
def scenario(
    scenario_id: str, database: DatabaseDependency, catalogue: str | None = None, problem: str | None = None
) -> ScenarioDetail:
    """A scenario with its road, for drawing traces, of an installed catalogue or of a `problem` whose scenarios have tasks; `catalogue`
    chooses among equal ids."""
    own = None if problem is None else _of_problem(database, problem, scenario_id)
    if own is not None:
        return _detail(problem or "", own)
    for offered in registry.catalogues():
        if catalogue in {None, offered.name} and scenario_id in offered.scenarios:
            return _detail(offered.name, offered.scenarios[scenario_id])
    raise NotFoundError("scenario", scenario_id)


@router.get("/parameters")
def parameters() -> ParameterSpacePage:
    """The parameter spaces of all installed driving functions, and the functions that cannot be used."""
    spaces = [
        ParameterSpaceAnswer(driving_function=function.name, name=name, parameters=list(map(_parameter, space)))
        for function in registry.driving_functions()
        for name, space in function.spaces.items()
    ]
    return ParameterSpacePage(items=spaces, broken=_broken(registry.DRIVING_FUNCTIONS))


@router.get("/optimizers")
def optimizers() -> OptimizerPage:
    """The installed optimizers with their settings, and the unusable ones."""
    items = [
        OptimizerAnswer(name=plugin.name, supports=sorted(supported(plugin)), settings=plugin.settings.model_json_schema())
        for plugin in registry.optimizers()
    ]
    return OptimizerPage(items=items, broken=_broken(registry.OPTIMIZERS))


@router.get("/references")
def references(database: DatabaseDependency) -> ReferencePage:
    """Number of simulated runs in the reference table, by setup."""
    with database.read() as connection:
        counts = setups.counts(connection)
    return ReferencePage(items=[_reference(count) for count in counts])


@router.get("/workers")
def workers(request: Request, database: DatabaseDependency, minutes: Annotated[int, Query(ge=0, le=60)] = 0) -> WorkerPage:
    """The workers with their activity, as the dispatcher last reported them, and what they did in the last `minutes`, from the stored
    runs."""
    recent: RecentWork = request.app.state.recent_work
    with database.read() as connection:
        dispatcher = processes.read(connection, processes.DISPATCHER)
        waiting = campaigns.waits(connection)
        work = recent.read(connection) if minutes else []
        named = campaigns.named(connection, {run.campaign_sequence for run in work})
    until = now()
    judgement = judge(dispatcher, until)
    reported = {} if dispatcher is None else dispatcher.detail
    items = [WorkerAnswer.model_validate(worker) for worker in reported.get("workers", [])]
    work = [*(running(items, until) if dispatcher and not judgement.silent else ()), *work]
    return WorkerPage(
        items=items,
        resources=[ResourceAnswer.model_validate(use) for use in reported.get("resources", [])],
        waiting=[WaitingAnswer(id=number, name=name, reason=reason) for number, name, _, reason in waiting],
        dispatcher_seen_at=None if dispatcher is None else dispatcher.heartbeat_at,
        fresh=not judgement.silent,
        degraded="; ".join(judgement.problems) or None,
        window=window(work, until, minutes, named) if minutes else None,
    )


def _of_problem(database: Database, problem: str, scenario_id: str) -> Scenario | None:
    """Returns a scenario with a task, None if the problem has none of this name."""
    bundle = stored_bundles(database)(problem)
    data = bundle.manifest.scenarios.get(scenario_id)
    if data is None or not bundle.manifest.is_driven:
        return None
    declared = TaskScenario.model_validate(data)
    if (own := installed(bundle.digest)) is not None:
        return declared.on(scenario_id, (own.folder / declared.network).read_bytes())
    with database.read() as connection:
        files = files_of(bundles.archive(connection, bundle.digest))
    return declared.on(scenario_id, files[declared.network].content)


def _broken(group: str) -> list[BrokenPluginAnswer]:
    return [BrokenPluginAnswer.of(plugin) for plugin in registry.broken() if plugin.group == group]


def _heading(catalogue: str, scenario: Scenario) -> dict[str, Any]:
    return {"catalogue": catalogue, "manoeuvre": scenario.rated_as, "vehicles": len(scenario.traffic)}


def _detail(catalogue: str, scenario: Scenario) -> ScenarioDetail:
    road, ego, task = scenario.road, scenario.ego, scenario.task
    line = reference_line(road, SPACING)
    across = [road.right_edge + number * road.lane_width for number in range(road.lanes + 1)]
    left = np.column_stack([-np.sin(line[:, 3]), np.cos(line[:, 3])])
    return ScenarioDetail.of(
        scenario,
        **_heading(catalogue, scenario),
        road=RoadAnswer(
            length_m=road.length,
            lanes=road.lanes,
            lane_width_m=road.lane_width,
            reference_line=line.round(DIGITS).tolist(),
            boundaries=[(line[:, 1:3] + d * left).round(DIGITS).tolist() for d in across],
            limits=[[knot.s, knot.speed] for knot in road.limits],
        ),
        ego=_vehicle(None, ego.d, ego),
        traffic=[_vehicle(other.id, other.lane * road.lane_width, other) for other in scenario.traffic],
        start_lane=task.start_lane,
        target_lane=task.target_lane,
        speeds=[[knot.s, knot.speed] for knot in task.speeds],
    )


def _vehicle(identifier: str | None, d: float, start: EgoStart | TrafficVehicle) -> VehicleAnswer:
    return VehicleAnswer(id=identifier, s_m=start.s, d_m=d, speed_mps=start.speed, length_m=start.length, width_m=start.width)


def _parameter(parameter: Parameter) -> ParameterAnswer:
    step = (parameter.upper - parameter.lower) / (parameter.n_values - 1)
    grid = {"step": None, "n_values": None} if parameter.kind == "continuous" else {"step": step}
    return ParameterAnswer.of(parameter, **grid)


def _reference(stored: SetupCount) -> ReferenceAnswer:
    setup = Setup(stored.scenario, stored.document)
    parts = {"driving_function": setup.document.get("controller"), "vehicle": setup.document.get("vehicle")}
    return ReferenceAnswer.of(stored, simulator=setup.simulator, **parts)
