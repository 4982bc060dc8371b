from types import SimpleNamespace
from typing import Any

import pytest

from drivecal.campaigns.stages.robustness import _is_as_good


@pytest.mark.parametrize(("is_close", "violation", "expected"), [(True, 0.0, True), (True, 0.1, False), (False, 0.0, False)])
def test_a_close_set_is_examined_unless_it_may_break_more(is_close: bool, violation: float, expected: bool) -> None:
    best: Any = SimpleNamespace(choice=SimpleNamespace(violation=0.0), equals=lambda other: other is best)
    other: Any = SimpleNamespace(is_close=is_close, choice=SimpleNamespace(violation=violation))
    assert (_is_as_good(best, best), _is_as_good(other, best)) == (True, expected)
