"""Setups of the built-in motorway, as a coordinator sends them to workers."""

from collections.abc import Mapping
from dataclasses import replace

from drivecal.bundles.installed import installed_problems
from drivecal.campaigns.resolve.problem import resolve
from drivecal.contracts.specification import CampaignSpecification
from drivecal.contracts.work import SetupRequest
from drivecal.domain.setups import fingerprint_of
from drivecal.plugins.ports import DrivingFunction


def driven(
    scenario: str = "S1",
    vehicle: str = "single_track",
    values: Mapping[str, float] | None = None,
    evaluator: str = "reference",
    function: DrivingFunction | None = None,
) -> SetupRequest:
    """Returns the setup of a scenario; `function` need not be installed."""
    document = {"vehicle": {"model": vehicle, "parameters": dict(values or {})}, "evaluator": evaluator}
    request = resolve(CampaignSpecification.model_validate(document)).bench.requests[scenario]
    if function is None:
        return request
    controller = {**request.simulator["controller"], "driving_function": function.name}
    return changed(
        replace(
            request,
            simulator={**request.simulator, "controller": controller},
            parameters=tuple(parameter.name for parameter in next(iter(function.spaces.values()))),
        ),
        controller=f"{function.name} {function.version}",
    )


def changed(request: SetupRequest, **parts: object) -> SetupRequest:
    """Returns a setup with other parts of its document."""
    document = {**request.document, "simulator": dict(request.simulator), **parts}
    return replace(request, document=document, run_fingerprint=fingerprint_of(document))


def bare(scenario: str = "S1", evaluator: str | None = "reference", fingerprint: str | None = None) -> SetupRequest:
    """Returns a setup for schedulers and scripted runners, which no worker could simulate."""
    controller = {"kind": "planner", "driving_function": "frenet", "values": {}}
    section = {"kind": "highway", "controller": controller, "vehicle": "single_track"}
    digest = installed_problems()["highway"].digest
    mark = fingerprint or f"fingerprint of {scenario}"
    names: tuple[str, ...] = ()
    return SetupRequest(digest, "highway", scenario, {}, section, names, names, names, names, names, mark, evaluator=evaluator)
