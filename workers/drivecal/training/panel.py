"""A simulated panel that rates manoeuvres: the reference scale as people with different tastes would read it. No human rated anything.

Rater i gives round(clip(7 - g_i (7 - r) + b_i + e)): r is the reference rating, g_i ~ N(1, 0.1) how strict the rater is, b_i ~ N(0, 0.4)
how friendly, e ~ N(0, 0.6) what the same rater would not repeat. The panel's rating is the mean of all raters, its score that mean
rounded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivecal.plugins.ports import Floats

RATERS = 15
STRICTNESS, FRIENDLINESS, INCONSISTENCY = 0.1, 0.4, 0.6
BEST = 7.0


@dataclass(frozen=True, slots=True)
class Panel:
    """`strictness`, `friendliness`: of each rater, shape (n,)."""

    strictness: Floats
    friendliness: Floats

    @classmethod
    def of(cls, seed: int) -> Panel:
        """A panel of `RATERS`."""
        rng = np.random.default_rng(seed)
        return cls(rng.normal(1.0, STRICTNESS, RATERS), rng.normal(0.0, FRIENDLINESS, RATERS))

    def rate(self, reference: float, rng: np.random.Generator) -> float:
        """The panel's rating of a manoeuvre with this reference rating."""
        heard = BEST - (BEST - reference) * self.strictness + self.friendliness + rng.normal(0.0, INCONSISTENCY, RATERS)
        return float(np.floor(np.clip(heard, 0.0, BEST) + 0.5).mean())
