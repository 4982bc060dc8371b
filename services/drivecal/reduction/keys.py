"""Reference keys: Figure 6 of the paper as an equality, so that it needs no scan of the table.

A stored set is a valid reference for a new set in a scenario when for every parameter P_sens = 0, or the values are equal, or both lie
below PB_sens lower, or both above PB_sens upper. That is an equivalence relation; its classes are named by a key that holds the
value if it is influential, `below` or `above` if it is not, and `any` if the parameter has no influence.
"""

import hashlib
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from drivecal.domain.influence import InfluenceMap
from drivecal.domain.parameters import ParameterSet, billionths, code

BELOW, ANY, ABOVE = np.iinfo(np.int64).min, np.iinfo(np.int64).min + 1, np.iinfo(np.int64).max
"""Codes that neither a value in billionths nor a text can take."""


class ReferenceKeys:
    """Computes the keys of an influence map and scenario, for sets of the parameters `names`."""

    def __init__(self, influence_map: InfluenceMap, scenario: str, names: Sequence[str]) -> None:
        self._order = np.argsort(np.array(names))
        ordered = [names[position] for position in self._order]
        influences = [influence_map.influence(scenario, name) for name in ordered]
        self._header = "\0".join([scenario, *ordered]).encode()
        ranges = [influence_map.ranges.get(name) for name in ordered]
        self._lowest = np.array([BELOW if bounds is None else billionths(bounds[0]) for bounds in ranges], dtype=np.int64)
        self._highest = np.array([ABOVE if bounds is None else billionths(bounds[1]) for bounds in ranges], dtype=np.int64)
        self._choices = {
            column: np.array([code(choice) for choice in influence_map.choices[name]], dtype=np.int64)
            for column, name in enumerate(ordered)
            if name in influence_map.choices
        }
        self._matters = np.array([influence.influential for influence in influences])
        self._lower = np.array(
            [BELOW if influence.lower is None else billionths(influence.lower) for influence in influences], dtype=np.int64
        )
        self._upper = np.array(
            [ABOVE if influence.upper is None else billionths(influence.upper) for influence in influences], dtype=np.int64
        )

    def codes(self, values: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """The class of every value, shape (n, n_p), for `values` as `billionths_matrix` codes them, in the order of `names`.

        Columns of the result are sorted by parameter name.
        """
        ordered = values[:, self._order]
        codes = np.where(ordered < self._lower, BELOW, np.where(ordered > self._upper, ABOVE, ordered))
        covered = (ordered >= self._lowest) & (ordered <= self._highest)  # of other values the map says nothing
        for column, analysed in self._choices.items():
            covered[:, column] = np.isin(ordered[:, column], analysed)
        return np.where(covered, np.where(self._matters, codes, ANY), ordered)

    def keys(self, values: npt.NDArray[np.int64]) -> list[bytes]:
        """Returns a key of 16 bytes per row of `values`, shape (n, n_p), as `codes` takes them."""
        start = hashlib.blake2b(self._header, digest_size=16)
        rows = np.ascontiguousarray(self.codes(values), dtype="<i8")
        width = rows.shape[1] * 8
        data = rows.tobytes()
        keys: list[bytes] = []
        for offset in range(0, len(data), width):
            digest = start.copy()
            digest.update(data[offset : offset + width])
            keys.append(digest.digest())
        return keys


def billionths_matrix(parameter_sets: Sequence[ParameterSet]) -> npt.NDArray[np.int64]:
    """The values of parameter sets with the same names, shape (n, n_p): in billionths, texts as `domain.values.code`."""
    return np.array([parameter_set.codes for parameter_set in parameter_sets], dtype=np.int64).reshape(len(parameter_sets), -1)


def keys_under(influence_map: InfluenceMap, scenario: str, names: Sequence[str], values: npt.NDArray[np.int64]) -> list[bytes]:
    """Returns the keys of sets of the parameters `names` under a map, in a scenario."""
    return ReferenceKeys(influence_map, scenario, names).keys(values)
