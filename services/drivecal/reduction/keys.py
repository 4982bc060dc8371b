"""Reference keys: Figure 6 of the paper as an equality, so that it needs no scan of the table.

A stored set is a valid reference for a new set in a scenario when for every parameter P_sens = 0, or the values are equal, or both lie
below PB_sens lower, or both above PB_sens upper. That is an equivalence relation; its classes are named by a key that holds the
value if it is influential, `below` or `above` if it is not, and `any` if the parameter has no influence.
"""

import hashlib
from collections.abc import Sequence
from decimal import Decimal

import numpy as np
import numpy.typing as npt

from drivecal.domain.influence import InfluenceMap
from drivecal.domain.parameters import ParameterSet
from drivecal.domain.values import billionths, code

BELOW, ANY, ABOVE = SHARED = np.iinfo(np.int64).min, np.iinfo(np.int64).min + 1, np.iinfo(np.int64).max
"""Codes that neither a value in billionths nor a text can take."""


class MapColumns:
    """Limits of the parameters `names` in a scenario of a map: arrays of shape (n_p,), coded as by `billionths_matrix`."""

    def __init__(self, influence_map: InfluenceMap, scenario: str, names: Sequence[str]) -> None:
        self.influences = [influence_map.influence(scenario, name) for name in names]
        self.matters = np.array([influence.influential for influence in self.influences])
        self.lower = _limits([influence.lower for influence in self.influences], BELOW)
        self.upper = _limits([influence.upper for influence in self.influences], ABOVE)
        ranges = [influence_map.ranges.get(name, (None, None)) for name in names]
        self._lowest = _limits([lowest for lowest, _ in ranges], BELOW)
        self._highest = _limits([highest for _, highest in ranges], ABOVE)
        self._choices = {
            column: np.array([code(choice) for choice in influence_map.choices[name]], dtype=np.int64)
            for column, name in enumerate(names)
            if name in influence_map.choices
        }

    def covers(self, values: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        """Returns whether values, shape (..., n_p), lie inside the map's space: of others it says nothing."""
        covered: npt.NDArray[np.bool_] = (values >= self._lowest) & (values <= self._highest)
        for column, analysed in self._choices.items():
            covered[..., column] = np.isin(values[..., column], analysed)
        return covered

    def codes(self, values: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """Returns the class of each value, shape (..., n_p): the map treats values of a parameter with equal codes as the same."""
        codes = np.where(values < self.lower, BELOW, np.where(values > self.upper, ABOVE, values))
        return np.where(self.covers(values), np.where(self.matters, codes, ANY), values)

    @property
    def changes(self) -> set[int]:
        """Values in billionths from which on values may have other codes than below, of any parameter."""
        return {
            *self.lower.tolist(),
            *self._lowest.tolist(),
            *(last + 1 for last in (*self.upper.tolist(), *self._highest.tolist())),
        }


def _limits(values: Sequence[Decimal | None], unlimited: int) -> npt.NDArray[np.int64]:
    return np.array([unlimited if value is None else billionths(value) for value in values], dtype=np.int64)


class ReferenceKeys:
    """Computes the keys of an influence map and scenario, for sets of the parameters `names`."""

    def __init__(self, influence_map: InfluenceMap, scenario: str, names: Sequence[str]) -> None:
        self._order = np.argsort(np.array(names))
        ordered = [names[position] for position in self._order]
        self._map = MapColumns(influence_map, scenario, ordered)
        self._header = "\0".join([scenario, *ordered]).encode()

    def keys(self, values: npt.NDArray[np.int64]) -> list[bytes]:
        """Returns a key of 16 bytes per row of `values`, shape (n, n_p), as `billionths_matrix` codes them, in the order of `names`."""
        start = hashlib.blake2b(self._header, digest_size=16)
        rows = np.ascontiguousarray(self._map.codes(values[:, self._order]), dtype="<i8")
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
