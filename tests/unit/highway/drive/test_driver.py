"""Answers of the child with time series: a replay that cannot be sent leaves the rest."""

import json
from unittest.mock import Mock

import pytest
from tests.support.problems import REPLAY

from drivecal.contracts.evaluation import ReplayAnswer
from drivecal.highway.drive import driver
from drivecal.highway.drive.driver import replay_beside

ANSWER = {"measures": {"a": 1.0}, "series": {"v": [1.0, 2.0]}}
MADE = ReplayAnswer.model_validate(REPLAY)


def test_a_replay_is_sent_as_far_as_the_line_has_room(monkeypatch: pytest.MonkeyPatch) -> None:
    assert replay_beside(ANSWER, lambda: MADE) == {"replay": REPLAY}
    assert replay_beside(ANSWER, lambda: None) == {"replay": None}
    line = len(json.dumps({**ANSWER, "replay": REPLAY, "id": 123_456_789}))
    for limit in (line, line + driver.LONGEST_ID):
        monkeypatch.setattr(driver, "LONGEST_LINE", limit)
        assert replay_beside(ANSWER, lambda: MADE) == {"replay": REPLAY if limit > line else None}


@pytest.mark.parametrize("error", [ValueError, IndexError, ZeroDivisionError])
def test_a_replay_that_cannot_be_made_is_left_out(error: type[Exception], capfd: pytest.CaptureFixture[str]) -> None:
    assert replay_beside(ANSWER, Mock(side_effect=error("a lane without points"))) == {"replay": None}
    assert "a lane without points" in capfd.readouterr().err


@pytest.mark.parametrize("error", [TypeError, MemoryError])
def test_faults_of_the_program_and_of_the_process_are_no_replay_s(error: type[Exception]) -> None:
    with pytest.raises(error):
        replay_beside(ANSWER, Mock(side_effect=error))
