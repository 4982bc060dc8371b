"""What is general knows no comfort score from 0 to 7, no points and no manoeuvre: those belong to the built-in problem."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from tests.support.tree import PROJECT, parsed

GENERAL = [
    *(
        f"services/drivecal/{name}"
        for name in ("analysis", "execution", "optimizers", "reduction", "report", "sensitivity", "storage")
    ),
    *(f"services/drivecal/{name}" for name in ("campaigns", "dispatch", "client", "cli/views")),
    "shared/drivecal/bundles",
    "workers/drivecal/adapters",
]
BUILT_IN = {
    "services/drivecal/campaigns/resolve/bench.py": "the bench of the built-in problem",
    "services/drivecal/execution/scheduling/batching.py": "remembers seven batches",
}
"""Modules that may, and why."""


def files() -> list[str]:
    found = [path for folder in GENERAL for path in sorted((PROJECT / folder).rglob("*.py"))]
    names = [str(path.relative_to(PROJECT)) for path in found if "migrations" not in path.parts]
    return [name for name in names if name not in BUILT_IN]


def own_scale(tree: ast.Module) -> list[int]:
    """The lines with the upper end of the comfort score, or words of it."""
    constants = [node for node in ast.walk(tree) if isinstance(node, ast.Constant)]
    numbers = [node.lineno for node in constants if type(node.value) in {int, float} and node.value == 7]
    texts = [node for node in constants if isinstance(node.value, str)]
    said = [node.lineno for node in texts if re.search(r"manoeuvre|\b(one|whole|a) points?\b|0 to 7|0\.\.7", str(node.value))]
    return [*numbers, *said]


def test_a_general_module_knows_no_scale_of_its_own() -> None:
    lines = {name: own_scale(parsed(PROJECT / name)) for name in files()}
    assert lines
    assert {name: numbers for name, numbers in lines.items() if numbers} == {}, "read the scale instead"


def test_every_exception_is_there() -> None:
    assert [name for name in BUILT_IN if not Path(PROJECT / name).is_file()] == []
