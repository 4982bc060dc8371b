"""Setups of the built-in motorway and of the driving functions in `plugins`, as a coordinator sends them to workers."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from tests.support.plugins.misbehaving import MISBEHAVING

from drivecal.bundles.installed import installed_problems
from drivecal.campaigns.resolve.problem import resolve
from drivecal.contracts.specification import CampaignSpecification
from drivecal.contracts.work import SetupRequest
from drivecal.domain.setups import fingerprint_of
from drivecal.plugins.ports import DrivingFunction

FOLDER = Path(__file__).parent / "plugins"
"""Driving functions as a coordinator that has them installed would send them."""
ARCHIVES = {problem.digest: problem.archive for problem in installed_problems().values()}
"""Problem bundles that the real backends of the tests know, by digest."""


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


def misbehaving_setup(scenario: str = "S1", function: DrivingFunction = MISBEHAVING) -> SetupRequest:
    return driven(scenario, function=function)
