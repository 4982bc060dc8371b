"""Packages export the names that users call, and the examples of the documentation run."""

import doctest
import importlib
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

PURE = ("analysis", "optimizers", "reduction", "sensitivity")
FACES = ("client", "local")


def package(name: str) -> ModuleType:
    return importlib.import_module(f"drivecal.{name}")


@pytest.mark.parametrize("name", FACES)
def test_a_package_exports_what_it_names_and_hides_no_module(name: str) -> None:
    exported = package(name).__all__
    assert all(hasattr(package(name), each) for each in exported)
    folder = Path(str(package(name).__file__)).parent
    assert not {path.stem for path in folder.glob("*.py")} & set(exported)


def test_the_examples_of_packages_run() -> None:
    page = Path(__file__).parents[2] / "docs" / "pages" / "how-to" / "python.md"
    for result in (doctest.testmod(package("local")), doctest.testfile(str(page), module_relative=False)):
        assert result.attempted
        assert not result.failed


@pytest.mark.parametrize("name", [*PURE, "reduction.prediction"])
def test_a_pure_package_loads_no_scipy(name: str) -> None:
    """Commands that only look things up, and the API, would wait for it."""
    code = f"import sys, drivecal.{name}; sys.exit('scipy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
