"""What is told of the sets that share the best objective."""

from __future__ import annotations

import numpy as np

from drivecal.analysis.optima import optima, regions
from drivecal.campaigns.results.optima import Alternatives


def test_some_of_many_optima_are_told_without_the_distances_of_all() -> None:
    generator = np.random.default_rng(2)
    best, worse = generator.random((9, 3)), generator.random((5, 3))
    known = Alternatives(best, worse, regions(best))
    assert len(known) == 9
    assert [*known.shown(0, 4), *known.shown(4, 8), *known.shown(8, 12)] == optima(best, worse)
    assert known.shown(20, 30) == []
