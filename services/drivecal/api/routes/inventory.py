"""What is there: scenarios, parameter spaces, references, workers."""

from __future__ import annotations

from fastapi import APIRouter

from drivecal.api.dependencies import DatabaseDependency
from drivecal.api.readiness import judge
from drivecal.contracts.inventory import (
    ParameterAnswer,
    ParameterSpaceAnswer,
    ParameterSpacePage,
    ReferenceAnswer,
    ReferencePage,
    ScenarioAnswer,
    ScenarioPage,
    WorkerAnswer,
    WorkerPage,
)
from drivecal.domain.parameters import Parameter
from drivecal.domain.setups import Setup
from drivecal.plugins import registry
from drivecal.storage import processes, setups
from drivecal.storage.setups import SetupCount
from drivecal.storage.types import now

router = APIRouter(tags=["inventory"])


@router.get("/scenarios")
def scenarios() -> ScenarioPage:
    """The scenarios of all installed catalogues."""
    return ScenarioPage(
        items=[
            ScenarioAnswer(
                id=scenario.id,
                catalogue=catalogue.name,
                title=scenario.title,
                manoeuvre=scenario.manoeuvre,
                duration=scenario.duration,
                step=scenario.step,
                vehicles=len(scenario.traffic),
            )
            for catalogue in registry.catalogues()
            for scenario in catalogue.scenarios.values()
        ]
    )


@router.get("/parameters")
def parameters() -> ParameterSpacePage:
    """The parameter spaces of all installed driving functions."""
    functions = [registry.driving_function(name) for name in registry.names("drivecal.driving_functions")]
    return ParameterSpacePage(
        items=[
            ParameterSpaceAnswer(driving_function=function.name, name=name, parameters=[_parameter(one) for one in space])
            for function in functions
            for name, space in function.spaces.items()
        ]
    )


@router.get("/references")
def references(database: DatabaseDependency) -> ReferencePage:
    """How many simulated runs the reference table holds, by setup."""
    with database.read() as connection:
        found = setups.counts(connection)
    return ReferencePage(items=[_reference(one) for one in found])


@router.get("/workers")
def workers(database: DatabaseDependency) -> WorkerPage:
    """The workers and what each is doing, as the dispatcher last reported them."""
    with database.read() as connection:
        dispatcher = processes.read(connection, processes.DISPATCHER)
    judgement = judge(dispatcher, now())
    return WorkerPage(
        items=[] if dispatcher is None else [WorkerAnswer.model_validate(one) for one in dispatcher.detail.get("workers", [])],
        dispatcher_seen_at=None if dispatcher is None else dispatcher.heartbeat_at,
        fresh=not judgement.silent,
        degraded="; ".join(judgement.problems) or None,
    )


def _parameter(parameter: Parameter) -> ParameterAnswer:
    lower, upper = float(parameter.lower), float(parameter.upper)
    return ParameterAnswer(
        name=parameter.name,
        unit=parameter.unit,
        lower=lower,
        upper=upper,
        step=float((parameter.upper - parameter.lower) / (parameter.n_values - 1)),
        n_values=parameter.n_values,
        description=parameter.description,
    )


def _reference(stored: SetupCount) -> ReferenceAnswer:
    setup = Setup.from_document(stored.document)
    return ReferenceAnswer(
        scenario=stored.scenario,
        fingerprint=stored.fingerprint,
        driving_function=f"{setup.driving_function} {setup.driving_function_version}",
        vehicle=f"{setup.vehicle} {setup.vehicle_version}",
        simulator=setup.simulator,
        runs=stored.runs,
    )
