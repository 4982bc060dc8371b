import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivecal.execution.measures import BOUNDS, DURATIONS, KINDS, Measures


@given(st.lists(st.floats(0.0, 1000.0)))
def test_every_duration_is_in_the_one_bucket_that_it_belongs_to(seconds: list[float]) -> None:
    measures = Measures()
    for second in seconds:
        measures.observe("batch", second)
    result = measures.snapshot()["seconds"]["batch"]
    assert sum(result["buckets"]) == len(seconds)
    assert result["sum"] == pytest.approx(sum(seconds))
    for index, bound in enumerate(BOUNDS):
        assert sum(result["buckets"][: index + 1]) == sum(item <= bound for item in seconds)


def test_what_never_happened_is_shown_as_zero() -> None:
    result = Measures().snapshot()
    assert set(result["seconds"]) == set(DURATIONS)
    assert result["counts"] == {name: dict.fromkeys(kinds, 0) for name, kinds in KINDS.items()}


def test_a_block_that_raises_is_measured_too() -> None:
    measures = Measures()
    with pytest.raises(KeyError), measures.timed("lease"):
        raise KeyError
    assert sum(measures.snapshot()["seconds"]["lease"]["buckets"]) == 1


def test_a_snapshot_is_a_document_that_later_events_leave_alone() -> None:
    measures = Measures()
    measures.count("breakdowns", "crash")
    measures.count("breakdowns", "crash", times=2)
    before = measures.snapshot()
    measures.count("breakdowns", "crash")
    measures.observe("batch", 1.0)
    assert json.loads(json.dumps(before)) == before
    assert before["counts"]["breakdowns"]["crash"] == 3
    assert sum(before["seconds"]["batch"]["buckets"]) == 0
