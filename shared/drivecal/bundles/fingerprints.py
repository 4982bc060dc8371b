"""Content of fingerprints: the inputs of a bundle's run, and of a run's score."""

from collections.abc import Mapping
from typing import Any

from drivecal.bundles.expressions import Formula
from drivecal.bundles.manifest import Manifest, ScoreEntry
from drivecal.domain.setups import canonical_json, digest
from drivecal.plugins import registry, setups
from drivecal.plugins.simulators import VERSIONS

_WITHOUT_EFFECT = {"timeout", "memory_mb", "deterministic"}
"""Settings that decide whether a run has a result, or say something about it, but change no measure: a run beyond a limit has none."""


def setup_document(manifest: Manifest, scenario: str, files: str, tools: str | None = None) -> dict[str, Any]:
    """Returns the document of a scenario's setup. `files`: digest of every file but `problem.yaml`; `tools`: what the
    probe answers on the workers.

    The probe stays beside its answer: results of unknown tools are not those of tools with a known version. So do the names of
    variables, whose values on workers are not known here.
    """
    section = manifest.simulator.model_dump(mode="json", exclude=_WITHOUT_EFFECT, exclude_none=True)
    for part in (section, section.get("controller"), section.get("vehicle")):
        if isinstance(part, dict) and part.get("reset") is True:
            del part["reset"]  # as before there was this field
    return {
        "simulator": section,
        "adapter": VERSIONS[manifest.simulator.kind],
        "scenario": scenario,
        "data": manifest.scenarios[scenario],
        "files": files,
    } | _said(manifest, tools)


def _said(manifest: Manifest, tools: str | None) -> dict[str, Any]:
    """Returns further inputs of a run: the versions of other tools, of SUMO and of the built-in planner, which values are sent as whole
    numbers, and the problem's name in the greeting of a process."""
    said: dict[str, Any] = {"integers": list(manifest.integers)} if manifest.integers else {}
    if manifest.simulator.kind == "process":
        said["problem"] = manifest.problem
    section = manifest.simulator.model_dump(mode="json")
    said |= {name: version for name, version in parts_of(section).items() if version is not None}
    if tools is not None:
        said["tools"] = tools
    return said


def parts_of(section: Mapping[str, Any]) -> dict[str, str | None]:
    """Returns the versions of what this installation adds to a run of a simulator's section, as setups name them: `controller`, the
    built-in one, and `sumo`, SUMO's library. None if the section does not use it.

    Raises InvalidInputError if this installation has no such controller.
    """
    is_highway = section["kind"] == "highway"
    is_planner = is_highway and section["controller"]["kind"] == "planner"
    return {
        "controller": registry.simulator("highway").controllers["planner"] if is_planner else None,
        "sumo": setups.sumo() if is_highway else None,
    }


def score_id(name: str, score: ScoreEntry) -> str:
    """Returns the id of a score's ratings: its name and the digest of what changes a number.

    That is the formula, the worth of failed runs, and the direction, which says on which side of that worth scores are cut off. The range
    changes numbers only through the default of `failed`; tolerance and unit change none.
    """
    content = {"formula": Formula(score.formula).canonical, "direction": score.direction, "failed": score.failed_worth}
    return f"{name} {digest(canonical_json(content).encode())}"
