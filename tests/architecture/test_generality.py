"""Tests of what is general knows no comfort score from 0 to 7, no points and no manoeuvre: those belong to the built-in problem."""

import ast
import re

from tests.support.tree import PROJECT, parsed

GENERAL = ("shared/drivecal", "services/drivecal", "workers/drivecal")
EXCEPT = {
    "workers/drivecal/highway": "the built-in problem",
    "services/drivecal/calibration_data": "points of curves, and numbers of a file format",
    "services/drivecal/campaigns/resolve/bench.py": "the bench of the built-in problem",
    "services/drivecal/cli/commands/demo.py": "shows the built-in problem",
    "services/drivecal/execution/scheduling/batching.py": "remembers seven batches",
    "services/drivecal/storage/retention/marking.py": "an array has seven columns",
    "shared/drivecal/contracts/inventory.py": "`manoeuvre` is a field of the API, of scenarios of the built-in problem",
    "services/drivecal/api/routes/inventory.py": "fills in that field",
    "shared/drivecal/contracts/tables.py": "files have columns for seven bins, those of the comfort score",
    "shared/drivecal/domain/roads.py": "points of lines",
    "shared/drivecal/domain/scales.py": "the comfort score",
    "shared/drivecal/domain/scenarios.py": "`manoeuvre` is a name in digests of stored runs",
    "shared/drivecal/roads": "points of lines",
}
"""Modules and folders that may, and why."""


def files() -> list[str]:
    found = [path.relative_to(PROJECT) for folder in GENERAL for path in sorted((PROJECT / folder).rglob("*.py"))]
    return [str(path) for path in found if not {str(path), *map(str, path.parents)} & EXCEPT.keys()]


def own_scale(tree: ast.Module) -> list[int]:
    """The lines with the upper end of the comfort score, or words and names of it."""
    nodes = list(ast.walk(tree))
    constants = [node for node in nodes if isinstance(node, ast.Constant)]
    numbers = [node.lineno for node in constants if type(node.value) in {int, float} and node.value == 7]
    texts = [node for node in constants if isinstance(node.value, str)]
    said = [node.lineno for node in texts if re.search(r"manoeuvre|\b(one|whole|a) points?\b|0 to 7|0\.\.7", str(node.value))]
    named = [getattr(node, "lineno", 0) for node in nodes for name in names(node) if "manoeuvre" in name.lower()]
    return [*numbers, *said, *named]


def names(node: ast.AST) -> list[str]:
    """The names that a node mentions."""
    fields = (getattr(node, field, None) for field in ("id", "attr", "arg", "name"))
    return [field for field in fields if isinstance(field, str)]


def test_a_general_module_knows_no_scale_of_its_own() -> None:
    lines = {name: own_scale(parsed(PROJECT / name)) for name in files()}
    assert lines
    assert {name: numbers for name, numbers in lines.items() if numbers} == {}, "read the scale instead"


def test_every_exception_is_there() -> None:
    assert [name for name in EXCEPT if not (PROJECT / name).exists()] == []
