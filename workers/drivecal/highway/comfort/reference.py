"""Plug-in of the reference evaluator. Pure Python, so that the coordinator can re-rate stored metrics with it."""

from collections.abc import Mapping

from drivecal.domain.evaluations import Rating
from drivecal.highway.comfort import scale
from drivecal.highway.manoeuvres import Manoeuvre
from drivecal.plugins.ports import Evaluator


class ReferenceEvaluator:
    """Rates by the reference comfort scale, see `drivecal.highway.comfort.scale`."""

    name = "reference"
    version = "1"

    def rate(self, rated_as: str, metrics: Mapping[str, float]) -> Rating:
        """Rates a run that did not fail."""
        return scale.rate(Manoeuvre(rated_as), metrics)


REFERENCE: Evaluator = ReferenceEvaluator()
