"""Sets that share the best objective."""

import numpy as np

from drivecal.analysis.optima import regions
from drivecal.campaigns.results.optima import Alternatives


def test_slices_of_many_optima_are_those_of_all() -> None:
    generator = np.random.default_rng(2)
    best, worse = generator.random((9, 3)), generator.random((5, 3))
    known = Alternatives(best, worse, regions(best))
    assert len(known) == 9
    assert [*known.shown(0, 4), *known.shown(4, 8), *known.shown(8, 12)] == known.shown(0, 9)
    assert known.shown(20, 30) == []
