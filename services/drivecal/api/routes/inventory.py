"""Inventory: scenarios, parameter spaces, references, workers."""

from typing import Annotated

from fastapi import APIRouter, Query, Request

from drivecal.api.dependencies import DatabaseDependency
from drivecal.api.live.dispatcher_health import judge
from drivecal.api.live.worker_time import RecentWork, running, window
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
    ScenarioAnswer,
    ScenarioPage,
    WaitingAnswer,
    WorkerAnswer,
    WorkerPage,
)
from drivecal.domain.parameters import Parameter
from drivecal.domain.scales import COMFORT
from drivecal.domain.setups import Setup
from drivecal.domain.vehicles import CLOSED_LOOP_MEASURES
from drivecal.plugins import registry
from drivecal.storage import campaigns, processes
from drivecal.storage.engine.types import now
from drivecal.storage.references import setups
from drivecal.storage.references.setups import SetupCount

router = APIRouter(tags=["inventory"])


@router.get("/scenarios")
def scenarios() -> ScenarioPage:
    """The scenarios of all installed catalogues, and the catalogues that cannot be used."""
    items = [
        ScenarioAnswer.of(scenario, catalogue=catalogue.name, manoeuvre=scenario.rated_as, vehicles=len(scenario.traffic))
        for catalogue in registry.catalogues()
        for scenario in catalogue.scenarios.values()
    ]
    return ScenarioPage(
        items=items, scores=[COMFORT.name], measures=dict(CLOSED_LOOP_MEASURES), broken=_broken(registry.CATALOGUES)
    )


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
        OptimizerAnswer(name=plugin.name, supports=sorted(plugin.supports), settings=plugin.settings.model_json_schema())
        for plugin in registry.optimizers()
    ]
    return OptimizerPage(items=items, broken=_broken(registry.OPTIMIZERS))


@router.get("/references")
def references(database: DatabaseDependency) -> ReferencePage:
    """Number of simulated runs in the reference table, by setup."""
    counts = database.query(setups.counts)
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
    unknown = {"state": "not known", "scenario": None, "since": None} if judgement.silent else {}
    items = [WorkerAnswer.model_validate(worker | unknown) for worker in reported.get("workers", [])]
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


def _broken(group: str) -> list[BrokenPluginAnswer]:
    return [plugin for plugin in registry.broken() if plugin.group == group]


def _parameter(parameter: Parameter) -> ParameterAnswer:
    step = (parameter.upper - parameter.lower) / (parameter.n_values - 1)
    grid = {"step": None, "n_values": None} if parameter.kind == "continuous" else {"step": step}
    return ParameterAnswer.of(parameter, **grid)


def _reference(stored: SetupCount) -> ReferenceAnswer:
    setup = Setup(stored.scenario, stored.document)
    parts = {"driving_function": setup.document.get("controller"), "vehicle": setup.document.get("vehicle")}
    return ReferenceAnswer.of(stored, simulator=setup.simulator, **parts)
