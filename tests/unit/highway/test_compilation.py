"""Stored kernels follow edits of the modules whose kernels they call."""

import ast
import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from numba.core.dispatcher import Dispatcher
from tests.support.tree import PROJECT, modules, parsed, shown

from drivecal.highway import geometry
from drivecal.highway.compilation import CacheFile, digest_of

CALLED = "from numba import njit\n@njit(cache=True)\ndef number():\n    return {}\n"
CALLER = """
import called
from called import number
from drivecal.highway.compilation import compiled_with

@compiled_with(called)
def twice():
    return 2 * number()

print(twice(), sum(twice.stats.cache_hits.values()))
"""


@pytest.mark.slow
def test_an_edit_of_a_called_module_compiles_its_callers_anew(tmp_path: Path) -> None:
    (tmp_path / "caller.py").write_text(CALLER)

    def answer(number: int) -> str:
        (tmp_path / "called.py").write_text(CALLED.format(number))
        environment = os.environ | {"PYTHONPATH": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}
        environment.pop("NUMBA_CACHE_DIR", None)
        command = [sys.executable, "-c", "import caller"]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.strip()

    assert [answer(3), answer(3), answer(4)] == ["6 0", "6 1", "8 0"]


def test_a_process_that_starts_while_another_stores_a_function_loads_no_other_one(tmp_path: Path) -> None:
    """Neither that of an earlier source nor that of another signature, which has the same number in numba's own files."""

    class Interrupted(CacheFile):
        """Lets another process act before its function is written."""

        def _save_data(self, name: str, data: Any) -> None:
            if data == "new":
                seen.append(CacheFile(str(tmp_path), "kernel", ("new",)).load("float"))
                CacheFile(str(tmp_path), "kernel", ("new",)).save("int", "of int")
            super()._save_data(name, data)

    seen: list[object] = []
    CacheFile(str(tmp_path), "kernel", ("old",)).save("float", "old")
    Interrupted(str(tmp_path), "kernel", ("new",)).save("float", "new")
    assert seen == [None]
    stored = CacheFile(str(tmp_path), "kernel", ("new",))
    assert [stored.load(key) for key in ("float", "int")] == ["new", "of int"]


def test_an_index_that_names_a_removed_type_or_is_cut_holds_no_function(tmp_path: Path) -> None:
    module = ModuleType("a_release")
    module.Removed = type("Removed", (), {"__module__": "a_release"})  # type: ignore[attr-defined]  # set by its name
    sys.modules["a_release"] = module
    CacheFile(str(tmp_path), "kernel", ("source",)).save(module.Removed(), "a function")
    del module.Removed
    assert CacheFile(str(tmp_path), "kernel", ("source",)).load("int") is None
    [index] = tmp_path.glob("*.nbi")
    index.write_bytes(index.read_bytes()[:-5])
    stored = CacheFile(str(tmp_path), "kernel", ("source",))
    stored.save("int", "another function")
    assert stored.load("int") == "another function"
    index.unlink()
    index.mkdir()  # cannot be read
    assert CacheFile(str(tmp_path), "kernel", ("source",)).load("int") is None


def kernels(module: ModuleType) -> list[Any]:
    """The kernels that a module defines."""
    return [value for value in vars(module).values() if isinstance(value, Dispatcher) and value.__module__ == module.__name__]


def called(module: ModuleType) -> set[ModuleType]:
    """The other modules whose kernels a module's kernels call, directly or through others."""
    names = {name for kernel in kernels(module) for name in kernel.py_func.__code__.co_names}
    others = {value.__module__ for name in names if isinstance(value := vars(module).get(name), Dispatcher)}
    direct = {import_module(name) for name in others - {module.__name__}}
    return direct.union(*(called(other) for other in direct))


def constants_of(path: Path) -> set[ModuleType]:
    """The modules of the motorway whose constants a module imports; they are compiled in."""
    nodes = [node for node in parsed(path).body if isinstance(node, ast.ImportFrom) and node.module is not None]
    names = {str(node.module) for node in nodes if any(alias.name.isupper() for alias in node.names)}
    return {import_module(name) for name in names if name.startswith("drivecal.highway")}


@pytest.mark.parametrize(
    "path", [path for path in modules() if "njit" in path.read_text() or "compiled_with(" in path.read_text()], ids=shown
)
def test_kernels_name_all_modules_whose_kernels_they_call(path: Path) -> None:
    module = import_module(".".join(path.relative_to(PROJECT / "workers").with_suffix("").parts))
    others = called(module)
    for kernel in kernels(module):
        index = getattr(kernel._cache, "_cache_file", None)
        if index is not None:
            _, _, *digests = index._source_stamp
            # The digests may include modules of constants; else the driving function's version includes these.
            assert digests in ([digest_of(others)] if others else [], [digest_of(others | constants_of(path))])


def test_modules_that_call_others_are_found() -> None:
    assert called(import_module("drivecal.highway.drive.geometry")) == {geometry}
