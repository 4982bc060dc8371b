"""Problems of the hostile kind and a neighbour that works, and what each attack costs: for the embedded server and for the cluster."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import yaml
from tests.support import attacks
from tests.support.attacks import ATTACKS
from tests.support.serve import until

from drivecal.adapters import confinement
from drivecal.adapters.seclusion import Seclusion
from drivecal.client import Client
from drivecal.contracts.evaluation import EvaluatedCell

WORKING: dict[str, Any] = {
    "problem": "neighbour",
    "parameters": {"x": {"lower": 0, "upper": 100, "step": 1}},
    "simulator": {"kind": "python", "file": "works.py", "timeout": 30, "memory_mb": 300, "deterministic": True},
    "scenarios": {"one": {}, "two": {}},
    "measures": {"y": "m"},
    "scores": {"cost": {"formula": "abs(y - 37)", "direction": "minimise", "range": [0, 100]}},
}
NEIGHBOUR = {
    "problem": "neighbour",
    "sensitivity": None,
    "reduction": {"mode": "off"},
    "optimizer": {"kind": "genetic", "population": 16, "iterations": 3, "seed": 1},
}
"""All of its cells are simulated, however often it is submitted."""
WORKS = "def evaluate(parameters, data):\n    return {'y': parameters['x']}\n"
CAUSES = {
    "fork_bomb": "processes, more than",
    "memory_of_one": "MemoryError",
    "memory_of_many": "MB of memory",
    "memory_that_is_shared": "MB of memory",
    "memory_without_end": "MemoryError",
    "hang": "no answer",
    "flood": "no answer",
    "fills_the_disk_with_small_files": "no answer",
    "fills_the_disk_with_a_large_file": "no answer",
    "nests_folders": "exit code 0",
    "answers_for_others": "the answer's id is 0",
    "null_pointer": "SIGSEGV",
    "leaves_at_once": "exit code 0",
    "unprintable_error": "exit code 1",
    "pushes_a_problem": "HTTP Error 403",
    "reaches_others": "ConnectionRefusedError",
    "connects_to_local_sockets": "PermissionError",
    "sends_to_local_sockets": "PermissionError",
    "overwrites_shared_memory": "Error: [Errno",
    "changes_attributes": "Read-only file system",
    "reads_the_secret_of_another_server": "PermissionError",
    "writes_outside": "Error: [Errno",
    "overwrites_the_database": "Error: [Errno",
    "holds_up_the_database": "PermissionError",
    "reads_the_secret": "PermissionError",
    "reads_the_environment": "PermissionError",
    "writes_to_the_cache": "Error: [Errno",
    "kills_the_server": "PermissionError",
    "kills_everything": "PermissionError",
}
"""A part of what the server reports of each attack without an answer."""
UNNOTICED = {"daemon", "ends_with_a_crash", "crashes_when_collected", "listens", "opens_sockets"}
"""Attacks that answer first, and gain nothing."""
LANDLOCK = {
    "overwrites_the_database": 1,
    "holds_up_the_database": 1,
    "reads_the_secret": 1,
    "reads_the_secret_of_another_server": 1,
    "overwrites_shared_memory": 1,
    "changes_attributes": 1,
    "reads_the_environment": 1,
    "writes_outside": 1,
    "writes_to_the_cache": 1,
    "kills_the_server": confinement.SCOPES_SINCE,
    "kills_everything": confinement.SCOPES_SINCE,
}
"""The version of Landlock that holds an attack back. Without it the attack is left out, because it would succeed."""


def attacker(data: Mapping[str, Any], name: str = "attacker", memory_mb: int = 300) -> dict[str, Any]:
    """Returns a problem whose parameter `attack` names its attack; `attacks` describes `data`."""
    return {
        "problem": name,
        "parameters": {"attack": {"choices": sorted(ATTACKS)}},
        "simulator": {"kind": "python", "file": "attacks.py", "timeout": 15, "memory_mb": memory_mb},
        "scenarios": {"only": dict(data)},
        "measures": {"y": "m"},
        "scores": {"cost": {"formula": "y", "direction": "minimise", "range": [0, 1]}},
    }


def push(client: Client, folder: Path, manifest: Mapping[str, Any], code: str) -> None:
    """Pushes a problem with one file of code."""
    bundle = folder / manifest["problem"]
    bundle.mkdir()
    (bundle / "problem.yaml").write_text(yaml.safe_dump(dict(manifest)))
    (bundle / manifest["simulator"]["file"]).write_text(code)
    client.push_problem(bundle)


def push_attacker(client: Client, folder: Path, manifest: Mapping[str, Any]) -> None:
    """Pushes a manifest of `attacker` with the attacks."""
    push(client, folder, manifest, Path(attacks.__file__).read_text())


def held_back(names: Iterable[str]) -> list[str]:
    """The attacks that this machine's kernel holds back."""
    is_secluded = Seclusion.make([], 1 << 20) is not None
    held = [name for name in names if confinement.version() >= LANDLOCK.get(name, 0)]
    return held if is_secluded else [name for name in held if name != "changes_attributes"]


def attack(client: Client, name: str, problem: str = "attacker") -> str:
    """Posts one attack as a single evaluation; returns its id."""
    return client.evaluate({"problem": problem, "evaluator": "cost", "parameters": {"attack": name}}).id


def is_pending(client: Client, identifier: str) -> bool:
    """Returns whether a single evaluation has not ended."""
    return client.evaluation(identifier).state in {"queued", "running"}


def ended(client: Client, identifier: str) -> EvaluatedCell:
    """The cell of a single evaluation, once it has ended."""
    until(lambda: not is_pending(client, identifier), identifier, 300)
    return client.evaluation(identifier).items[0]


def inside(folder: Path) -> list[psutil.Process]:
    """The processes that work in a folder or below, such as simulators."""
    result = []
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            if process.status() != psutil.STATUS_ZOMBIE and Path(process.cwd()).is_relative_to(folder):
                result.append(process)
    return result


def assert_costs(cells: Mapping[str, EvaluatedCell], causes: Mapping[str, str]) -> dict[str, str]:
    """Each attack of `causes` costs its cell and is reported by a part of its text; the others answer and gain nothing. Returns what is
    reported of the lost cells."""
    lost = {name: cell.detail or "" for name, cell in cells.items() if cell.outcome == "failed"}
    assert lost.keys() == causes.keys() & cells.keys()
    unexpected = {name: text for name, text in lost.items() if causes[name] not in text}
    assert unexpected == {}, unexpected
    assert all(text.isprintable() for text in lost.values())
    assert {cell.score for name, cell in cells.items() if name not in lost} == {1.0}
    return lost
