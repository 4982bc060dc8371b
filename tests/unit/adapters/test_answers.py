"""Answers of simulators: replays, and what a failed run has."""

from math import inf, nan
from typing import Any

import pytest
from tests.support.problems import REPLAY

from drivecal.adapters.answers import document, outcome
from drivecal.domain.evaluations import Breakdown
from drivecal.plugins.simulators import Declared, NoMeasuresError

DECLARED = Declared("roads", ("a",))
ANSWER: dict[str, Any] = {"measures": {"a": 1.0}, "series": {}, "replay": REPLAY}


def test_a_replay_is_read_beside_the_series_of_simulators_that_have_one() -> None:
    replay = outcome(ANSWER, DECLARED, series=True, replay=True).replay
    assert replay is not None
    assert replay.model_dump() == REPLAY
    assert outcome(ANSWER, DECLARED, series=True).replay is None
    assert outcome(ANSWER, DECLARED, series=False, replay=True).replay is None
    assert outcome(ANSWER | {"replay": None}, DECLARED, series=True, replay=True).replay is None


@pytest.mark.parametrize("wrong", [3, [], {}, REPLAY | {"time_s": ["<script>"]}, REPLAY | {"others": [{"id": "a"}]}])
def test_a_replay_of_another_form_costs_its_cell(wrong: object) -> None:
    with pytest.raises(NoMeasuresError) as caught:
        outcome(ANSWER | {"replay": wrong}, DECLARED, series=True, replay=True)
    assert caught.value.breakdown is Breakdown.ERROR


@pytest.mark.parametrize(
    ("measures", "series", "kept"),
    [
        ({}, {}, ({}, {})),
        (None, {"t": [0.0, nan]}, ({}, {})),
        ({"a": None, "b": inf}, {"t": [0.0, inf]}, ({}, {})),
        ({"a": 1.5, "b": None}, {"t": [0, 1], "u": [None]}, ({"a": 1.5}, {"t": [0.0, 1.0]})),
        ({"a": 1.5, "b": 10**400}, {"t": [0, 10**400]}, ({"a": 1.5}, {})),
    ],
)
def test_a_failed_run_keeps_the_numbers_that_it_has(measures: object, series: object, kept: object) -> None:
    declared, answer = Declared("trial", ("a", "b"), series=("t", "u")), {"measures": measures, "series": series}
    failed = outcome(answer | {"failure": "collision", "error": None}, declared, series=True)
    assert (failed.failure, (failed.measures, failed.series)) == ("collision", kept)


@pytest.mark.parametrize("nothing", [None, False, ""])
def test_an_answer_may_say_that_it_has_no_error_and_is_not_busy(nothing: object) -> None:
    assert outcome(ANSWER | {"error": nothing, "busy": nothing}, DECLARED, series=False).measures == {"a": 1.0}


def test_a_measure_that_is_given_twice_is_refused() -> None:
    with pytest.raises(NoMeasuresError, match="twice"):
        document(b'{"measures": {"a": 1, "a": 7}}', "the answer")


def test_a_failure_that_is_not_declared_is_refused_if_any_is() -> None:
    with pytest.raises(NoMeasuresError, match="declared: off_road"):
        outcome({"failure": "collision"}, Declared("trial", ("a",), failures=("off_road",)), series=False)
