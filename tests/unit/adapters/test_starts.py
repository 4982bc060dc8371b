"""Starts that a simulator refuses: on this machine, or on every machine."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.support.simulators import lost, served

from drivecal.domain.errors import UnavailableError
from drivecal.domain.evaluations import Breakdown
from drivecal.plugins.simulators import UnsuitableError


def test_a_simulator_that_says_it_is_not_ready_cannot_be_opened(tmp_path: Path) -> None:
    with pytest.raises(UnavailableError, match="no licence"), served(tmp_path, start="answer(error='no licence')\nreturn"):
        pass


@pytest.mark.parametrize(
    ("fields", "kind"),
    [("", UnavailableError), (", unsuitable=False", UnavailableError), (", unsuitable=True", UnsuitableError)],
)
def test_a_start_says_whether_another_machine_may_run_it(tmp_path: Path, fields: str, kind: type[Exception]) -> None:
    with pytest.raises(UnavailableError) as error, served(tmp_path, start=f"answer(error='no road'{fields})\nreturn"):
        pass
    assert type(error.value) is kind


def test_a_new_child_that_says_it_is_not_ready_costs_no_run(tmp_path: Path) -> None:
    start = "if os.path.exists('gone'):\n    answer(error='no licence')\n    return"
    with served(tmp_path, "if x == 1.0: os.abort()", start=start) as session:
        (tmp_path / "gone").touch()
        lost(session, {"x": 1.0}, Breakdown.CRASH)
        for _ in range(2):
            with pytest.raises(UnavailableError, match="no licence"):
                session.evaluate({"x": 2.0})
        (tmp_path / "gone").unlink()
        assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}
