"""The source tree, for tests about its shape."""

import ast
import importlib.util
from functools import cache
from pathlib import Path
from types import ModuleType

PROJECT = Path(__file__).parents[2]
ROOTS = tuple(PROJECT / name / "drivecal" for name in ("shared", "services", "workers"))


def packages(root: Path) -> set[str]:
    """The import names of a root's packages, e.g. `drivecal.runtime`. Moved packages leave folders with compiled files only behind."""
    return {f"drivecal.{folder.name}" for folder in root.iterdir() if next(folder.rglob("*.py"), None)}


def modules() -> list[Path]:
    """Every Python file of the three roots."""
    return sorted(path for root in ROOTS for path in root.rglob("*.py"))


def shown(path: Path) -> str:
    """A path as a test's name shows it."""
    return path.relative_to(PROJECT).as_posix()


def loaded(name: str, path: Path) -> ModuleType:
    """A file as a module of this name, loaded anew."""
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@cache
def parsed(path: Path) -> ast.Module:
    """The syntax tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


def statements(tree: ast.Module) -> list[ast.stmt]:
    """All statements of a file: expressions, which are most of a tree, are not looked at."""
    nodes = list(tree.body)
    for node in nodes:
        nodes += [each for block in ("body", "orelse", "finalbody", "handlers", "cases") for each in getattr(node, block, ())]
    return nodes
