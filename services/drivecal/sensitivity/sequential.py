"""Runs of a design's intervals that decide a bound: from both ends inwards to the first influential interval on each side.

What is cut follows from these intervals alone (`cutting.cut`), so the rest needs no run. An interval that is influential whatever its
missing effects are (`thresholds.is_surely_influential`) takes no more samples either. Points, effects and bounds are those of the whole
design. An interval that may still turn out without influence takes all its samples, for one missing effect over the whole scale outweighs
any tolerance.

The rounds of all parameters and both sides run together, so that each has enough runs for many workers.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from drivecal.domain.parameters import Indices
from drivecal.domain.scales import COMFORT, Scale
from drivecal.sensitivity.effects import Design, Floats, measures
from drivecal.sensitivity.scenario import tells_nothing
from drivecal.sensitivity.thresholds import Threshold, is_surely_influential, verdict

PARTS = 2
"""Looks at an interval, after each of so many equal parts of its samples. More save little more and make rounds smaller (decision 026)."""


class IntervalRuns:
    """The runs of a design's intervals in a scenario, round by round: `rows` of the design's points, then their scores to `tell`.

    All rows are one round unless they are chosen one after the other (`sequential`).
    """

    def __init__(self, design: Design, threshold: Threshold, *, sequential: bool, scale: Scale = COMFORT) -> None:
        """`design`: effects of shape (n_p, n_Int, r), each with a second run of its own if they are chosen sequentially."""
        self.design = design
        self._threshold, self._scale = threshold, scale
        self._sequential = sequential
        self._made = np.zeros(len(design.points), dtype=bool)
        counts = (~np.isnan(design.steps[..., 0])).sum(axis=1).tolist()
        self._verdicts: list[list[bool | None]] = [[None] * count for count in counts]
        self._samples = np.zeros(design.steps.shape[:2], dtype=np.int64)
        self._rows: Indices | None = None
        self.scores: Floats = np.full(len(design.points), np.nan)
        """Scores of all points; NaN if a run failed or was not made."""

    @property
    def effects(self) -> Floats:
        """Elementary effects, shape (n_p, n_Int, r); NaN if a run failed or was not made."""
        return self.design.effects(self.scores, self._scale.span)

    def rows(self) -> Indices:
        """Returns the next rows to run, increasing, the same until their scores arrive; empty if no more are needed."""
        if self._rows is None:
            self._rows = self._chosen() if self._sequential else np.flatnonzero(~self._made)
        return self._rows

    def tell(self, scores: Floats) -> None:
        """Takes the scores of `rows`, shape (n_rows,)."""
        rows, self._rows = self.rows(), None
        self.scores[rows], self._made[rows] = scores, True
        if self._sequential:
            self._judge()

    def _chosen(self) -> Indices:
        """Returns the runs of the next samples on both fronts of every parameter that were not made yet."""
        samples = self.design.steps.shape[2]
        size = -(-samples // PARTS)
        wanted = np.zeros_like(self._made)
        for place in self._fronts():
            start = self._samples[place]
            for ends in (self.design.first, self.design.second):
                wanted[ends[place][start : start + size]] = True
            self._samples[place] = min(start + size, samples)
        return np.flatnonzero(wanted & ~self._made)

    def _judge(self) -> None:
        effects = self.effects
        for place in self._fronts():
            column, interval = place
            known, steps, count = effects[place], self.design.steps[place], int(self._samples[place])
            if count == known.size:
                statistics = measures(known)
                self._verdicts[column][interval] = verdict(
                    statistics, steps[~np.isnan(known)], self._threshold, self._scale
                ).influential
            elif is_surely_influential(known[:count], steps[:count], steps[count:], self._threshold, self._scale):
                self._verdicts[column][interval] = True

    def _fronts(self) -> Iterator[tuple[int, int]]:
        """Yields the column and the number of the undecided intervals next to what is decided, from both ends of each parameter.

        As long as no run scored better than a failed one the fronts pass influential intervals as well: a scenario is unknown only after
        all runs.
        """
        is_silent = tells_nothing(self.scores, self._scale)
        for column, verdicts in enumerate(self._verdicts):
            below = _front(verdicts, is_silent=is_silent)
            above = _front(verdicts[::-1], is_silent=is_silent)
            ends = {below, None if above is None else len(verdicts) - 1 - above}
            yield from ((column, interval) for interval in sorted(end for end in ends if end is not None))


def _front(verdicts: Sequence[bool | None], *, is_silent: bool) -> int | None:
    """The first undecided interval; None if there is none before the first influential one."""
    for interval, influential in enumerate(verdicts):
        if influential is None:
            return interval
        if influential and not is_silent:
            return None
    return None
