"""P1..P11: their spaces, limits and weights."""

from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from tests.support.values import numbers
from tests.unit.highway.planner.situations import MIDDLE

from drivecal.domain import roads
from drivecal.domain.parameters import ParameterSpace
from drivecal.domain.setups import digest
from drivecal.highway.planner import plugin
from drivecal.highway.planner.cost import TERMS, weights
from drivecal.highway.planner.plugin import FRENET

TABLE_6 = {
    "P1": ("-15", "14", 59),
    "P2": ("0", "2", 201),
    "P3": ("0", "200", 201),
    "P4": ("0", "2000", 2001),
    "P5": ("0", "1500", 1501),
    "P6": ("0", "1", 101),
    "P7": ("0", "200", 201),
    "P8": ("0", "2000", 2001),
    "P9": ("0", "10", 101),
    "P10": ("0", "20", 201),
    "P11": ("0", "200", 201),
}
"""Lower, upper, number of values."""
BITS = [6, 5, 8, 11, 4, 4, 8, 11, 5, 5, 8]


def test_the_highway_space_is_table_6() -> None:
    space = FRENET.spaces["highway"]
    assert [(p.name, p.lower, p.upper, p.n_values) for p in space] == [
        (name, Decimal(lower), Decimal(upper), n_values) for name, (lower, upper, n_values) in TABLE_6.items()
    ]
    assert space[0].value(1) == Decimal("-14.5")
    assert space[9].value(1) == Decimal("0.1")


def test_the_lattice_of_table_9_has_the_paper_s_bits() -> None:
    space = FRENET.spaces["highway_table9"]
    assert [parameter.n_values for parameter in space] == [2**bits for bits in BITS]
    assert [(p.lower, p.upper) for p in space] == [(p.lower, p.upper) for p in FRENET.spaces["highway"]]


def test_limits_hold_the_spaces_and_forbid_negative_weights() -> None:
    assert list(FRENET.limits) == list(TABLE_6)
    for space in FRENET.spaces.values():
        for parameter in space:
            lowest, highest = FRENET.limits[parameter.name]
            assert lowest is not None
            assert Decimal(str(lowest)) <= parameter.lower
            assert highest is None or parameter.upper <= Decimal(str(highest))
    assert {name for name, (lowest, _) in FRENET.limits.items() if lowest != 0.0} == {"P1"}


def test_every_value_of_the_spaces_gives_a_weight() -> None:
    for parameters in FRENET.spaces.values():
        space = ParameterSpace(parameters)
        for indices in (np.zeros(11, dtype=np.int64), space.n_values - 1):
            values = weights(list(numbers(space.parameter_set(indices)).values()))
            assert np.isfinite(values).all()
            assert (values >= 0.0).all()


def test_weights_are_one_in_the_middle_of_the_ranges_and_linear_but_for_the_decibels() -> None:
    assert [term.name for term in TERMS] == list(TABLE_6)
    np.testing.assert_allclose(weights(MIDDLE), np.ones(12))
    doubled = weights([10.0, *(2 * value for value in MIDDLE[1:])])
    np.testing.assert_allclose(doubled, [1.0, 10.0, *[2.0] * 10])
    assert (weights([-10.0] + 10 * [0.0]) == [1.0, 0.1, *[0.0] * 10]).all()
    for term, parameter in zip(TERMS[1:], FRENET.spaces["highway"][1:], strict=True):
        assert Decimal(str(term.middle)) == (parameter.lower + parameter.upper) / 2


def test_a_parameter_set_of_the_wrong_length_is_refused() -> None:
    with pytest.raises(ValueError, match="zip"):
        weights(MIDDLE[:-1])


def test_the_version_changes_with_every_file_that_decides_what_is_driven() -> None:
    package = Path(plugin.__file__).parent
    harmless = {"__init__.py", "plugin.py"}
    assert {path.name for path in package.glob("*.py")} - harmless == {
        path.name for path in plugin.ARITHMETIC if path.parent == package
    }
    content = b"".join(path.read_bytes() for path in [*plugin.ARITHMETIC, Path(roads.__file__)])
    assert FRENET.version == plugin.version_of(content)
    edited = content.replace(b"3000.0", b"3001.0")
    assert plugin.version_of(edited) == f"1.{digest(edited)[:8]}" != FRENET.version
