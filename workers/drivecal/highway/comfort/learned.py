"""Plug-in of the learned evaluator. Light enough for the coordinator: workers import the kernels when they rate."""

from collections.abc import Mapping
from functools import cached_property

from drivecal.domain.evaluations import Rating
from drivecal.highway.comfort.reference import Manoeuvre
from drivecal.highway.comfort.regressions import arrays_of, shipped
from drivecal.plugins.arrays import content_digest
from drivecal.plugins.ports import Evaluator, Series


class Learned:
    """Rates time series by MiniRocket features and ridge regression, after Moser et al. [38]; see `learned.md` next to this file."""

    name = "learned"

    @cached_property
    def version(self) -> str:
        """Version derived from the arrays. Raises DamagedArraysError if they cannot be used."""
        return f"1.{content_digest(arrays_of(shipped()))[:8]}"

    def rate(self, rated_as: str, metrics: Mapping[str, float]) -> Rating:
        """Raises ValueError: metrics cannot replace time series."""
        raise ValueError(f"a {rated_as} with {len(metrics)} metrics and no time series cannot be rated; simulate it again")

    def rate_series(self, rated_as: str, series: Series) -> Rating:
        """Rates a run that did not fail.

        Raises ValueError if it is shorter than 10 s or longer than 30 s, and DamagedArraysError if the arrays cannot be used.
        """
        from drivecal.highway.comfort.rocket import channels_of, rating_of  # numba belongs to workers

        return rating_of(shipped()[Manoeuvre(rated_as)], channels_of(series.dynamics, series.offset))


LEARNED: Evaluator = Learned()
