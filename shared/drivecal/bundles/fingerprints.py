"""Content of fingerprints: the inputs of a bundle's run, and of a run's score."""

from collections.abc import Mapping
from typing import Any

from drivecal.bundles.expressions import Formula
from drivecal.bundles.manifest import Manifest, ScoreEntry
from drivecal.domain.setups import canonical_json, digest
from drivecal.plugins import registry, simulators
from drivecal.plugins.ports import Evaluator
from drivecal.plugins.simulators import VERSIONS

_WITHOUT_EFFECT = {"timeout", "memory_mb", "deterministic", "random", "resources"}
"""Settings that decide whether a run has a result, or say something about it, but change no measure: a run beyond a limit has none."""


def setup_document(
    manifest: Manifest,
    scenario: str,
    files: str,
    *,
    section: Mapping[str, Any] | None = None,
    data: Mapping[str, Any] | None = None,
    varied: Mapping[str, float] | None = None,
    tools: str | None = None,
    seed: int | None = None,
) -> dict[str, Any]:
    """Returns the document of a scenario's setup.

    The document holds the probe command as well as its answer: unknown tools and tools with a known version are different setups. It also
    names variables and inputs; the answer holds digests of their values and contents on the workers.

    Args:
        manifest: the problem.
        scenario: id of the scenario.
        files: digest of every file but `problem.yaml`.
        section: the simulator's section with the plug-ins that a campaign chose, by default the manifest's.
        data: the scenario's data, by default the manifest's.
        varied: values of the problem's varied parameters.
        tools: answer of the workers about probe, variables and inputs.
        seed: seed of the run; None if the simulator does not depend on one.
    """
    section = manifest.simulator.model_dump(mode="json") if section is None else section
    data = manifest.scenarios[scenario] if data is None else data
    inputs = {name: value for name, value in section.items() if name not in _WITHOUT_EFFECT and value is not None}
    for name, part in inputs.items():
        if isinstance(part, dict):
            inputs[name] = {key: value for key, value in part.items() if value is not None}
    document: dict[str, Any] = {
        "simulator": inputs,
        "adapter": VERSIONS[section["kind"]],
        "scenario": scenario,
        "data": data,
        "files": files,
    }
    if manifest.integers:
        document["integers"] = list(manifest.integers)
    if manifest.shapes:
        document["shapes"] = {name: shape.document for name, shape in manifest.shapes.items()}
    if section["kind"] == "process":
        document["problem"] = manifest.problem
    if varied:
        document["varied"] = dict(varied)
    if tools is not None:
        document["tools"] = tools
    if seed is not None:
        document["seed"] = seed
    return document | {name: version for name, version in parts_of(section, data).items() if version is not None}


def parts_of(section: Mapping[str, Any], data: Mapping[str, Any]) -> dict[str, str | None]:
    """Returns the versions of what this installation adds to a run, as setups name them; None for parts that it does not use.

    `controller` is an installed driving function, `vehicle` an installed vehicle, `catalogue` a scenario of an installed
    catalogue, and `sumo` SUMO's library.

    Args:
        section: the simulator's section of a manifest.
        data: the scenario's data.

    Raises:
        InvalidInputError: this installation lacks one of them.
    """
    parts: dict[str, str | None] = dict.fromkeys(("controller", "vehicle", "catalogue", "sumo"))
    if section["kind"] != "highway":
        return parts
    parts["sumo"] = simulators.sumo()
    if section["controller"]["kind"] != "planner":
        return parts
    function = registry.driving_function(section["controller"]["driving_function"])
    vehicle = registry.vehicle(model_of(section["vehicle"]))
    if "catalogue" in data:
        parts["catalogue"] = registry.catalogue(data["catalogue"]).scenarios[data["scenario"]].digest
    return parts | {
        "controller": f"{function.name} {function.version}",
        "vehicle": f"{vehicle.name} {vehicle.version}",
        "sumo": simulators.loaded_sumo(),
    }


def model_of(vehicle: str | Mapping[str, Any]) -> str:
    """Returns the name of the vehicle model in a simulator's section."""
    return vehicle if isinstance(vehicle, str) else str(vehicle["model"])


def score_id(name: str, score: ScoreEntry) -> str:
    """Returns the id of a score's ratings: its name and the digest of what changes a number.

    That is the formula, or name and version of the evaluator; the worth of failed runs; and the direction, which says on which side of
    that worth scores are cut off. The range changes numbers only through the default of `failed`; tolerance and unit
    change none.
    """
    if score.formula is None:
        return evaluator_rating(registry.evaluator(score.evaluator or ""), score)
    content = {"formula": Formula(score.formula).canonical, "direction": score.direction, "failed": score.failed_worth}
    return f"{name} {digest(canonical_json(content).encode())}"


def evaluator_rating(evaluator: Evaluator, score: ScoreEntry) -> str:
    """Returns the id of an evaluator's ratings."""
    usual = (score.failed_worth, score.direction) == (0, "maximise")
    return f"{evaluator.name} {evaluator.version}" + ("" if usual else f" {score.direction} {score.failed_worth!r}")
