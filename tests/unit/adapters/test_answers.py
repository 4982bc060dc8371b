"""Replays in answers: read of simulators that drive on roads, ignored of others, and refused if a page could not draw them."""

from typing import Any

import pytest
from tests.support.problems import REPLAY

from drivecal.adapters.answers import outcome
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
