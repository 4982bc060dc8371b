"""Reasons why a stored set may, or may not, answer a cell: their differing parameters, and the regions of these values.

Reference keys only show whether two sets belong to the same class (`drivecal.reduction.keys`). This module finds the parameters that
separate them, and puts the reason into a sentence. Pure.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from drivecal.contracts.assignments import value_text
from drivecal.contracts.evaluation import Difference, Explanation, InspectedLot, Prediction, Reference, Region
from drivecal.domain.influence import InfluenceMap
from drivecal.domain.parameters import ParameterSet
from drivecal.domain.scales import score_text
from drivecal.domain.values import TEXTS
from drivecal.reduction.keys import MapColumns
from drivecal.reduction.prediction import Bools, Floats

Integers = npt.NDArray[np.int64]


class Nearest(NamedTuple):
    """A stored set: the number of parameters that block it, its distance in them, its place in the order of references, its evaluation.
    The nearest sorts first."""

    blocking: int
    distance: float
    place: tuple[int, ...]
    evaluation: int


class CellComparison:
    """Compares one cell with stored sets, under an influence map in one scenario."""

    def __init__(
        self, influence_map: InfluenceMap, scenario: str, names: Sequence[str], values: Integers, ranges: Integers
    ) -> None:
        """`values` are the cell's, coded by `keys.billionths_matrix`, in the order of `names`, shape (n_p,). `ranges` are the parameters'
        extents in billionths, positive, shape (n_p,): the units of distances."""
        self._names = tuple(names)
        self._map = MapColumns(influence_map, scenario, names)
        self._values = values
        self._ranges = ranges

    def blocking(self, stored: Integers) -> Bools:
        """Returns the parameters of stored sets that forbid reuse, for `stored` coded as the cell's values; both of shape (n, n_p)."""
        blocks: Bools = self._map.codes(stored) != self._map.codes(self._values)
        return blocks

    def distances(self, stored: Integers, blocking: Bools) -> Floats:
        """Euclidean, of the blocking parameters alone, each in units of its range, shape (n,): what differs elsewhere does not matter.

        Another choice is as far away as the whole range.
        """
        total = np.zeros(len(stored))
        for column in range(len(self._names)):  # one column after the other: the same bits whatever the number of rows
            share = (stored[:, column] - self._values[column]) / self._ranges[column]
            if self._values[column] >= TEXTS:
                share = np.sign(share)
            total += np.where(blocking[:, column], share * share, 0.0)
        return np.sqrt(total)

    def nearest(self, stored: Integers, places: Integers, evaluations: Integers) -> Nearest | None:
        """Returns the stored set with the fewest blocking parameters; None without stored sets.

        Among equal ones, the smallest distance decides, then the first of the `places`, shape (n, k), which order references. `evaluations`
        are their ids, shape (n,). To combine two chunks of stored sets, take the smaller result.
        """
        if not len(stored):
            return None
        blocking = self.blocking(stored)
        counts, distances = blocking.sum(axis=1), self.distances(stored, blocking)
        columns = [places[:, column] for column in reversed(range(places.shape[1]))]
        first = int(np.lexsort([*columns, distances, counts])[0])
        place = tuple(int(place) for place in places[first])
        return Nearest(int(counts[first]), float(distances[first]), place, int(evaluations[first]))

    def differences(self, cell: ParameterSet, stored: ParameterSet) -> list[Difference]:
        """Returns the parameters that differ between a stored set and the cell's, in the order of the names."""
        by_name = dict(zip(stored.names, stored.codes, strict=True))
        values = np.array([by_name[name] for name in self._names], dtype=np.int64)
        blocking = self.blocking(values[np.newaxis, :])[0]
        own, others = self._regions(self._values), self._regions(values)
        return [
            Difference(
                parameter=name,
                value=cell.floats[name],
                reference_value=stored.floats[name],
                region=own[column],
                reference_region=others[column],
                lower=None if known.lower is None else float(known.lower),
                upper=None if known.upper is None else float(known.upper),
                blocks=bool(blocking[column]),
            )
            for column, (name, known) in enumerate(zip(self._names, self._map.influences, strict=True))
            if values[column] != self._values[column]
        ]

    def _regions(self, values: Integers) -> list[Region]:
        """Returns the regions of a set's values, shape (n_p,)."""
        conditions = [~self._map.covers(values), ~self._map.matters, values < self._map.lower, values > self._map.upper]
        regions: list[Region] = np.select(conditions, ["outside", "anywhere", "below", "above"], "influential").tolist()
        return regions


def sentence(explanation: Explanation) -> str:
    """Returns an explanation in a few sentences; only its other fields are read."""
    text = _sentence(explanation)
    return text if explanation.outcome is not None else f"{text} Its answer is awaited."


def _sentence(explanation: Explanation) -> str:
    reference = explanation.reference
    stored = "an evaluation that was deleted" if reference is None else _place(reference, explanation.campaign)
    match explanation.reason:
        case "repeated" if reference is not None and reference.claimed:
            names = ", ".join(reference.claimed)
            return f"Repeated: {stored} is of an earlier version; claims of problem.yaml about {names} make the two sets equal."
        case "repeated":
            return f"Repeated: {stored} has the same parameter set in the same setup."
        case "reused":
            return f"Reused: {stored} differs only where {explanation.scenario} is not influenced: {_values(explanation.differences)}."
        case "predicted":
            return f"Predicted: {_prediction(explanation.prediction)}."
        case "checked":
            checked = _prediction(explanation.prediction) if reference is None else f"{stored} was to answer it"
            return f"Simulated as a check: {checked}. {_verdict(explanation)}"
        case "failed":
            return f"Failed: none of {explanation.attempts} attempts gave a result."
        case "simulated":
            return f"Simulated: {_nearest(explanation, stored)}."


def _nearest(explanation: Explanation, nearest: str) -> str:
    if explanation.lot is not None and explanation.lot.verdict == "rejected":
        return f"its lot was rejected, {_inspection(explanation.lot)}"
    prediction = explanation.prediction
    doubt = "" if prediction is None else f"; its prediction was not accepted (confidence {100 * prediction.confidence:.0f} %)"
    if explanation.reference is None:
        return f"nothing was stored for this setup when the campaign asked{doubt}"
    blocking = [difference for difference in explanation.differences if difference.blocks]
    if not blocking:
        return f"{nearest} would fit, but had no result when the campaign asked, or reuse was off{doubt}"
    none = f"none of {explanation.stored:,} stored sets is the same, or alike by a map"
    return f"{none}; the nearest, {nearest}, differs in {_values(blocking)}{doubt}"


def _prediction(prediction: Prediction | None) -> str:
    if prediction is None:
        return "it was predicted"
    text = f"the prediction is {score_text(prediction.score)} with a confidence of {100 * prediction.confidence:.0f} %"
    return text if prediction.lot is None else f"{text}; of its lot, {_inspection(prediction.lot)}"


def _inspection(lot: InspectedLot) -> str:
    if lot.errors is None:
        return f"{lot.sample} of {lot.size} are still to be simulated"
    return f"{lot.sample} of {lot.size} were simulated and {lot.errors} were wrong (at most {lot.acceptance} may be)"


def _verdict(explanation: Explanation) -> str:
    check = explanation.check
    if check is None or check.agrees is None or explanation.score is None:
        return "The two cannot be compared: one has no result."
    scores = f"the simulation gave {score_text(explanation.score)}, the answer was {score_text(check.expected)}"
    if check.agrees:
        return f"They agree: {scores}."
    return f"The answer is wrong: {scores}." if check.wrong else f"They differ by no more than the tolerance: {scores}."


def _place(reference: Reference, campaign: str) -> str:
    place = f"{reference.stage} iteration {reference.iteration + 1}, individual {reference.individual}"
    owner = "" if reference.campaign == campaign else f" of campaign {reference.campaign}"
    return f"evaluation {reference.evaluation} ({place}{owner})"


def _values(differences: Sequence[Difference]) -> str:
    return "; ".join(
        f"{difference.parameter} ({value_text(difference.value)} here, {value_text(difference.reference_value)} there)"
        for difference in differences
    )
