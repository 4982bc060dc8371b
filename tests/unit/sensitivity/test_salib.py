"""SALib's radial design and `radial_ee` as an independent implementation, where no step is zero; and what it does where one is."""

import numpy as np
import pytest
from SALib.analyze import radial_ee
from SALib.sample.radial import radial_sobol
from SALib.test_functions import Sobol_G
from scipy.stats import qmc

from drivecal.domain.parameters import Indices
from drivecal.sensitivity.designs import COLUMNS, Design, Floats, SobolRows, radial_design, snapped
from drivecal.sensitivity.thresholds import measures

DIMENSIONS, SAMPLES = 6, 64
A = np.array([0.0, 1.0, 4.5, 9.0, 99.0, 0.5])
PROBLEM = {"num_vars": DIMENSIONS, "names": [f"x{i}" for i in range(DIMENSIONS)], "bounds": [[0, 1]] * DIMENSIONS}


class PlainRows(SobolRows):
    """The sequence as SALib takes it, not scrambled."""

    def __init__(self, dimensions: int) -> None:
        super().__init__(dimensions, 0)
        self._engine = qmc.Sobol(dimensions, scramble=False)


def designed(grid: int, rows: SobolRows, shortest: float) -> Design:
    n_values = np.full(DIMENSIONS, grid)
    return radial_design(n_values, rows, np.zeros_like(n_values), n_values - 1, SAMPLES, shortest)


def in_their_order(points: Indices) -> Indices:
    """Sample by sample, each base point first."""
    return points.reshape(DIMENSIONS + 1, SAMPLES, DIMENSIONS).transpose(1, 0, 2).reshape(-1, DIMENSIONS)


def g_function(unit: Floats) -> Floats:
    return np.asarray(Sobol_G.evaluate(unit, A))


def assert_agreement(design: Design, grid: int) -> None:
    unit = in_their_order(design.points) / (grid - 1)
    theirs = radial_ee.analyze(PROBLEM, unit, g_function(unit), SAMPLES, seed=1)
    ours = [measures(row) for row in design.effects(7 * g_function(design.points / (grid - 1)))]
    for name in ("mu", "mu_star", "sigma"):
        assert [getattr(our, name) for our in ours] == pytest.approx(theirs[name], rel=1e-9, abs=1e-12)


def test_the_design_is_salibs_but_for_its_zero_steps() -> None:
    grid = 2**20
    n_values = np.full(DIMENSIONS, grid)
    theirs = snapped(radial_sobol.sample(PROBLEM, SAMPLES), np.zeros_like(n_values), n_values - 1)
    ours = in_their_order(designed(grid, PlainRows(COLUMNS * DIMENSIONS), shortest=0).points)
    theirs, ours = (points.reshape(SAMPLES, DIMENSIONS + 1, DIMENSIONS) for points in (theirs, ours))
    made = np.any(theirs[:, 1:] != theirs[:, :1], axis=2)
    assert made.mean() > 0.95
    assert np.array_equal(ours[:, 0], theirs[:, 0])
    assert np.array_equal(ours[:, 1:][made], theirs[:, 1:][made])
    assert np.all(np.any(ours[:, 1:] != ours[:, :1], axis=2))


@pytest.mark.parametrize("shortest", [0, 0.25])
@pytest.mark.parametrize("grid", [12, 1001])
def test_figures_agree_with_salibs_where_no_step_is_zero(grid: int, shortest: float) -> None:
    for seed in range(3):
        assert_agreement(designed(grid, SobolRows(COLUMNS * DIMENSIONS, seed), shortest), grid)
