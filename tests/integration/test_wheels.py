"""The wheel and its three layers, each installed by pip into a fresh environment, with sizes and times. `make test-packages`."""

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from zipfile import ZipFile

import pytest
from tests.support.tree import PROJECT

pytestmark = [pytest.mark.packages, pytest.mark.timeout(3600)]

LARGEST_MB = {"": 150, "local": 1250, "cluster": 1600}
"""Sizes that no change may exceed unnoticed. Of the local layer half is SUMO and the compiler of the kernels; 500 MB were wanted."""


SHOWN = 8
"""Number of printed packages, largest first."""
SIZES = """
import json
from importlib import metadata

sizes = {}
for package in metadata.distributions():
    files = [package.locate_file(file) for file in package.files or ()]
    sizes[package.name] = sum(file.stat().st_size for file in files if file.is_file()) / 1e6
print(json.dumps(sizes))
"""


@dataclass(frozen=True)
class Installed:
    """A layer in an environment of its own, and an empty home folder next to it."""

    python: Path
    megabytes: float

    @property
    def environment(self) -> Mapping[str, str]:
        home = self.python.parents[2] / "home"
        home.mkdir(exist_ok=True)
        kept = {name: value for name, value in os.environ.items() if not name.startswith(("DRIVECAL_", "PYTHON", "RAY_"))}
        return kept | {"HOME": str(home), "DRIVECAL_HOME": str(home / "drivecal"), "NO_COLOR": "1"}

    def drivecal(self, *words: str) -> subprocess.CompletedProcess[str]:
        command = [str(self.python.with_name("drivecal")), *words]
        return subprocess.run(
            command, cwd=self.environment["HOME"], env=self.environment, capture_output=True, text=True, check=False
        )

    def has(self, module: str) -> bool:
        code = f"import importlib.util, sys; sys.exit(importlib.util.find_spec({module!r}) is None)"
        return subprocess.run([self.python, "-c", code], cwd=self.python.parent, check=False).returncode == 0


def megabytes(folder: Path) -> float:
    """Size of the files below a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file() and not path.is_symlink()) / 1e6


def largest(python: Path) -> str:
    """The largest packages of an environment with their MB."""
    sizes: dict[str, float] = json.loads(subprocess.run([python, "-c", SIZES], capture_output=True, check=True).stdout)
    return ", ".join(f"{name} {size:.0f}" for name, size in sorted(sizes.items(), key=lambda item: -item[1])[:SHOWN])


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built as by pip but with the build requirements of this environment."""
    folder = tmp_path_factory.mktemp("dist")
    began = time.monotonic()
    subprocess.run([sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)], cwd=PROJECT, check=True)
    (built,) = folder.glob("*.whl")
    print(f"\n{built.name}: {built.stat().st_size / 1e6:.1f} MB, built in {time.monotonic() - began:.0f} s")
    return built


@pytest.fixture(scope="module")
def constraints(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The versions of the lock, without its hashes: with hashes pip would ask for one of our own wheel, too."""
    lock = (PROJECT / "deploy" / "requirements.lock").read_text()
    file = tmp_path_factory.mktemp("lock") / "constraints.txt"
    file.write_text("\n".join(re.findall(r"^([a-zA-Z0-9_.\[\],-]+==[^\\\n]+)", lock, re.MULTILINE)))
    return file


@pytest.fixture(scope="module")
def layer(wheel: Path, constraints: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Installed]:
    """Installs the layer of an extra at its first use."""

    @cache
    def installed(extra: str) -> Installed:
        folder = tmp_path_factory.mktemp(extra or "client")
        subprocess.run([sys.executable, "-m", "venv", str(folder / "env")], check=True)
        empty, began = megabytes(folder / "env"), time.monotonic()
        pip = [str(folder / "env" / "bin" / "python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        subprocess.run([*pip, "--constraint", str(constraints), f"{wheel}[{extra}]" if extra else str(wheel)], check=True)
        made = Installed(folder / "env" / "bin" / "python", megabytes(folder / "env") - empty)
        name = f"drivecal[{extra}]" if extra else "drivecal"
        print(f"\n{name}: {made.megabytes:.0f} MB installed in {time.monotonic() - began:.0f} s, with {largest(made.python)}")
        return made

    return installed


def test_the_wheel_holds_the_page_the_documentation_and_nothing_else(wheel: Path) -> None:
    with ZipFile(wheel) as archive:
        names = set(archive.namelist())
    assert {name.split("/")[0].partition("-")[0] for name in names} == {"drivecal"}
    for wanted in ("api/static/index.html", "api/help/index.html", "client/templates/python/problem.yaml", "domain/py.typed"):
        assert f"drivecal/{wanted}" in names
    assert not [name for name in names if name.endswith("missing.txt") or "/test_" in name or "node_modules" in name]


@pytest.mark.parametrize("extra", ["", "local", "cluster"])
def test_each_layer_does_what_it_is_for_and_names_the_extra_of_the_rest(layer: Callable[[str], Installed], extra: str) -> None:
    installed = layer(extra)
    assert installed.megabytes <= LARGEST_MB[extra]
    assert re.fullmatch(r"drivecal \d+\.\d+\.\d+\n", installed.drivecal("--version").stdout)
    assert installed.drivecal("problem", "init", "python", "mine").returncode == 0
    assert installed.drivecal("list", "--url", "http://127.0.0.1:9").returncode == 4  # no server listens there
    assert (installed.has("sqlalchemy"), installed.has("ray")) == (extra != "", extra == "cluster")
    stored = installed.drivecal("db", "check", "--database-url", "sqlite:///none.db")
    if not extra:
        assert (stored.returncode, "drivecal[local]" in stored.stderr) == (2, True)
        return
    assert "drivecal[" not in stored.stderr
    checked = installed.drivecal("problem", "check", "mine")
    assert checked.returncode == 0, checked.stderr
    if extra == "local":
        with_ray = installed.drivecal("serve", "--port", "0", "--backend", "ray")
        assert (with_ray.returncode, "drivecal[cluster]" in with_ray.stderr) == (2, True), with_ray.stderr


def test_the_demo_runs_on_one_machine_without_ray(layer: Callable[[str], Installed]) -> None:
    installed = layer("local")
    began, home = time.monotonic(), Path(installed.environment["HOME"])
    command = [str(installed.python.with_name("drivecal")), "demo", "--json"]
    said = []
    with (
        (home / "summary.json").open("w") as summary,
        subprocess.Popen(
            command, cwd=home, env=installed.environment, stdout=summary, stderr=subprocess.PIPE, text=True
        ) as process,
    ):
        assert process.stderr is not None
        for line in process.stderr:
            said.append(line)
            if "http://" in line:  # the page answers, then the workers are ready
                print(f"\ndrivecal demo: {line.strip()} ({time.monotonic() - began:.0f} s after the command)", end="")
    print(f"\ndrivecal demo: the end after {time.monotonic() - began:.0f} s")
    assert process.returncode == 0, "".join(said)
    done = json.loads((home / "summary.json").read_text())
    assert [done[name]["state"] for name in ("campaign", "rerun")] == ["succeeded", "succeeded"]
    assert done["rerun"]["cells"]["simulated"] < done["campaign"]["cells"]["simulated"]
