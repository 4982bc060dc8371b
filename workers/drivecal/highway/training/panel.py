"""A simulated panel that applies the reference scale with individual tastes. No human rated any manoeuvre.

Rater i gives round(clip(7 - g_i (7 - r) + b_i + e)), with the reference rating r, strictness g_i ~ N(1, 0.1), friendliness
b_i ~ N(0, 0.4) and inconsistency e ~ N(0, 0.6), which varies between ratings. The panel's rating is the mean of all raters, its score the
rounded mean.
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
    """Raters with their `strictness` and `friendliness`, shape (n,)."""

    strictness: Floats
    friendliness: Floats

    @classmethod
    def of(cls, seed: int) -> Panel:
        """Draws a panel of `RATERS` raters."""
        rng = np.random.default_rng(seed)
        return cls(rng.normal(1.0, STRICTNESS, RATERS), rng.normal(0.0, FRIENDLINESS, RATERS))

    def rate(self, reference: float, rng: np.random.Generator) -> float:
        """Returns the panel's rating of a manoeuvre with this reference rating."""
        ratings = BEST - (BEST - reference) * self.strictness + self.friendliness + rng.normal(0.0, INCONSISTENCY, RATERS)
        return float(np.floor(np.clip(ratings, 0.0, BEST) + 0.5).mean())
