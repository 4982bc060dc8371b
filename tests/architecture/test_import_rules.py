"""The import rules in pyproject.toml: they name every package, and find what they forbid."""

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from tests.support.tree import PROJECT, ROOTS, modules, packages

SHARED, SERVICES, WORKERS = ROOTS

DRIVER = """
import sys
roots, config = sys.argv[1:-1], sys.argv[-1]
sys.path[:] = roots + [entry for entry in sys.path if not entry.rstrip('/').endswith(('/shared', '/services', '/workers'))]
from importlinter.cli import lint_imports
sys.exit(lint_imports(config_filename=config, no_cache=True, no_logo=True))
"""
"""Lints the namespace package in copied roots, not in the installed ones."""

PLANTED = {
    "The coordinator's imports point down": ("services/drivecal/storage", "import drivecal.campaigns"),
    "The workers' imports point down": ("workers/drivecal/adapters", "import drivecal.runtime"),
    "The workers do not know the coordinator": ("workers/drivecal/runtime", "from drivecal.reduction import keys"),
    "The domain stands on the standard library and numpy": ("shared/drivecal/domain", "import pydantic"),
}
"""For rules of each root and of both kinds a folder, and what a module in it must not say."""


def rules() -> list[dict[str, Any]]:
    with (PROJECT / "pyproject.toml").open("rb") as file:
        result: list[dict[str, Any]] = tomllib.load(file)["tool"]["importlinter"]["contracts"]
    return result


def rule(name: str) -> dict[str, Any]:
    return next(item for item in rules() if item["name"] == name)


def lint(tree: Path) -> subprocess.CompletedProcess[str]:
    roots = [str(tree / name) for name in ("shared", "services", "workers")]
    command = [sys.executable, "-c", DRIVER, *roots, "pyproject.toml"]
    return subprocess.run(command, cwd=tree, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The project's modules and rules in another place."""
    tree = tmp_path_factory.mktemp("tree")
    shutil.copy(PROJECT / "pyproject.toml", tree)
    for path in modules():
        target = tree / path.relative_to(PROJECT)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, target)
    return tree


def test_every_rule_is_kept_and_rules_find_what_is_planted(copy: Path) -> None:
    clean = lint(copy)
    assert clean.returncode == 0, clean.stdout + clean.stderr
    for number, (folder, statement) in enumerate(PLANTED.values()):
        (copy / folder / f"planted{number}.py").write_text(f"{statement}\n")
    broken = lint(copy)
    assert broken.returncode == 1
    for number, name in enumerate(PLANTED):
        assert f"{name} BROKEN" in broken.stdout
        assert re.search(rf"\.planted{number}\b", broken.stdout), name


def test_the_layers_name_every_package() -> None:
    def named(name: str) -> set[str]:
        return {package for layer in rule(name)["layers"] for package in re.split(r"\s*[:|]\s*", layer)}

    assert named("The coordinator's imports point down") == packages(SERVICES) | packages(SHARED)
    assert named("The workers' imports point down") == packages(WORKERS) | packages(SHARED)


@pytest.mark.parametrize(
    ("name", "source", "forbidden"),
    [
        ("What both sides speak knows neither side", packages(SHARED), packages(SERVICES) | packages(WORKERS)),
        ("Only the backends and drivecal.local reach the workers", packages(SERVICES), packages(WORKERS)),
        ("The workers do not know the coordinator", packages(WORKERS), packages(SERVICES)),
        ("No database and no web server beside the simulation", packages(WORKERS), {"sqlalchemy", "fastapi"}),
        ("No simulator and no compiler in the coordinator", packages(SERVICES), {"libsumo", "numba"}),
    ],
)
def test_a_rule_between_roots_names_every_package(name: str, source: set[str], forbidden: set[str]) -> None:
    assert set(rule(name)["source_modules"]) == source
    assert set(rule(name)["forbidden_modules"]) >= forbidden
