"""The example packages, installed by pip as a user's own: a planner that drives and an optimizer that searches."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.support.tree import PROJECT

pytestmark = pytest.mark.slow
PACKAGES = PROJECT / "deploy" / "examples" / "packages"

DRIVE = """
import json
from drivecal import local

sets = [{"rate": rate, "gain": 0.4, "headway": 1.2} for rate in (0.3, 1.2)]
runs = [local.evaluate(parameters, driving_function="lane_follower").cells.values() for parameters in sets]
print(json.dumps([[(cell.scenario, cell.score, cell.rating, cell.failure, cell.error) for cell in cells] for cells in runs]))
"""
SEARCH = """
import json
import numpy as np
from drivecal.campaigns.resolve.problem import resolve
from drivecal.contracts.specification import CampaignSpecification
from drivecal.plugins import registry

plugin = registry.optimizer("hill_climbing")
settings = plugin.settings(kind="hill_climbing", population=12, iterations=40, seed=3)
n_values, expert = np.array([101, 101]), np.array([[7, 7]])
first = plugin.create(settings, n_values, expert)
second, best = first, []
for iteration in range(settings.iterations):
    points = first.ask().population
    assert points.min() >= 0 and (points < n_values).all()
    assert iteration or (points[0] == [7, 7]).all()
    objectives = -((points - [30, 70]) ** 2).sum(axis=1).astype(float)
    best.append(float(objectives.max()))
    objectives[iteration % 12] = np.nan  # a set without a result
    second.tell(objectives, objectives)
    if first is not second:
        first.tell(objectives, objectives)
        assert first.ask().population.tolist() == second.ask().population.tolist()
    second = plugin.restore(settings, n_values, json.loads(json.dumps(first.state())))
problem = resolve(CampaignSpecification(driving_function="lane_follower", optimizer={"kind": "hill_climbing", "population": 20}))
print(json.dumps([best[0], max(best), list(problem.space.parameter_set([0, 0, 0]).floats), problem.optimization.population]))
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder into which pip has installed both packages, whose requirements are there already."""
    folder = tmp_path_factory.mktemp("packages")
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--target", str(folder)]
    subprocess.run([*install, *(str(path.parent) for path in PACKAGES.glob("*/pyproject.toml"))], check=True)
    return folder


def printed(code: str, installed: Path) -> Any:
    """Returns what a program prints as JSON, with the packages on its path."""
    environment = os.environ | {"PYTHONPATH": str(installed)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_the_planner_drives_and_its_parameters_matter(installed: Path) -> None:
    slow, fast = printed(DRIVE, installed)
    assert [len(slow), len(fast)] == [6, 6]
    assert slow != fast
    for scenario, score, _, failure, error in [*slow, *fast]:
        assert error is None, (scenario, error)
        assert failure is None or score == 0
    assert sum(row[3] is None for row in slow) >= 4


def test_the_optimizer_climbs_and_goes_on_from_its_state(installed: Path) -> None:
    first, best, names, population = printed(SEARCH, installed)
    assert best > first
    assert best > -50
    assert (names, population) == (["rate", "gain", "headway"], 20)


@pytest.mark.parametrize("path", sorted(PACKAGES.glob("*/*.py")), ids=lambda path: path.stem)
def test_an_example_is_short(path: Path) -> None:
    assert len([line for line in path.read_text().splitlines() if line.strip()]) <= 60
