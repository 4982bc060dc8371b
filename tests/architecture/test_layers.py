"""Tests of what each layer of the installation can do: client and command line alone, one machine without Ray, a cluster."""

import subprocess
import sys
from functools import cache
from importlib.metadata import distribution, packages_distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from tests.architecture.test_configuration import project

from drivecal.adapters import kinds
from drivecal.cli import application

NOBODY = "http://127.0.0.1:9"
WITHOUT = """
import sys
from importlib.machinery import PathFinder

find = PathFinder.find_spec
PathFinder.find_spec = lambda name, *others: None if name.partition(".")[0] in {absent!r} else find(name, *others)
"""
COMMAND = "from drivecal.cli.__main__ import app; app(sys.argv[1:])"


@cache
def layer(extra: str | None) -> frozenset[str]:
    """The distributions that `pip install drivecal[extra]` brings, with all that they need."""
    declared = project()["project"]
    wanted = [Requirement(entry) for entry in declared["dependencies"]]
    extras = declared["optional-dependencies"]
    if extra is not None:
        wanted += [Requirement(entry) for entry in extras[extra]]
    names: set[str] = set()
    while wanted:
        requirement = wanted.pop()
        name = canonicalize_name(requirement.name)
        if name == "drivecal":
            wanted += [Requirement(entry) for chosen in requirement.extras for entry in extras[chosen]]
            continue
        if name not in names:
            names.add(name)
            wanted += [inner for inner in map(Requirement, distribution(name).requires or []) if _applies(inner, requirement)]
    return frozenset(names)


def _applies(inner: Requirement, outer: Requirement) -> bool:
    return inner.marker is None or any(inner.marker.evaluate({"extra": extra}) for extra in ("", *outer.extras))


def absent(extra: str | None) -> set[str]:
    """The modules of all packages of this environment that a layer does not bring."""
    there = layer(extra)
    return {
        module
        for module, owners in packages_distributions().items()
        if not {canonicalize_name(owner) for owner in owners} & {*there, "drivecal"} and module not in sys.stdlib_module_names
    }


def run(extra: str | None, code: str, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    script = WITHOUT.format(absent=absent(extra)) + code
    return subprocess.run(
        [sys.executable, "-c", script, *map(str, arguments)], capture_output=True, text=True, check=False, timeout=1800
    )


def test_the_layers_hold_what_they_are_for() -> None:
    client, local, cluster = layer(None), layer("local"), layer("cluster")
    assert client < local < cluster
    assert {"sqlalchemy", "fastapi", "libsumo", "numba"} <= local - client
    assert "ray" in cluster - local


@pytest.mark.slow("words1", "words2")
@pytest.mark.parametrize(
    "words", [("--help",), ("problem", "init", "python", "mine", "--folder", "{}"), ("list", "--url", NOBODY)]
)
def test_the_client_alone_runs_commands_that_need_no_more(words: tuple[str, ...], tmp_path: Path) -> None:
    done = run(None, COMMAND, *(word.format(tmp_path / "mine") for word in words))
    assert done.returncode == (4 if NOBODY in words else 0), done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("words", [("serve", "--port", "0"), ("db", "check", "--database-url", "sqlite:///{}")])
def test_a_command_that_needs_more_names_the_extra(words: tuple[str, ...], tmp_path: Path) -> None:
    done = run(None, COMMAND, *(word.format(tmp_path / "a.db") for word in words))
    assert done.returncode == 2, done.stderr
    assert "drivecal[local]" in done.stderr


def test_the_extra_that_a_message_names_brings_the_missing_module() -> None:
    named = application.EXTRAS | kinds.EXTRAS
    owners = packages_distributions()
    brought = {name: {canonicalize_name(owner) for owner in owners[name]} & layer(extra) for name, extra in named.items()}
    assert {name for name, packages in brought.items() if not packages} == set()


@pytest.mark.slow
@pytest.mark.parametrize("words", [("--backend", "ray"), ("--ray-address", "10.0.0.1:6379")])
def test_a_server_on_ray_names_the_extra_before_it_starts(words: tuple[str, ...], tmp_path: Path) -> None:
    done = run("local", COMMAND, "serve", "--port", "0", "--home", tmp_path, *words)
    assert done.returncode == 2, done.stderr
    assert "drivecal[cluster]" in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_one_machine_needs_no_ray() -> None:
    done = run(
        "local",
        "import drivecal.api.__main__, drivecal.dispatch.__main__, drivecal.execution.processes.backend, drivecal.cli.__main__",
    )
    assert done.returncode == 0, done.stderr
