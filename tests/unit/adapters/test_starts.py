"""Starts that a simulator refuses: on this machine, or on every machine."""

from pathlib import Path

import pytest
from tests.support.simulators import DECLARED, lost, opened, served, write_server

from drivecal.adapters.environment import Scratch
from drivecal.adapters.process import ProcessSession
from drivecal.domain.errors import UnavailableError
from drivecal.domain.evaluations import Breakdown
from drivecal.plugins.simulators import UnsuitableError


@pytest.mark.parametrize(
    ("fields", "kind"),
    [("", UnavailableError), (", unsuitable=False", UnavailableError), (", unsuitable=True", UnsuitableError)],
)
def test_a_driver_of_drivecal_may_blame_its_files(tmp_path: Path, fields: str, kind: type[Exception]) -> None:
    section = {"timeout": 60.0, "memory_mb": 1000}
    command = write_server(tmp_path, start=f"answer(error='no road'{fields})\nreturn")
    with pytest.raises(UnavailableError) as error:
        ProcessSession(command, section, Scratch(tmp_path), DECLARED, scenario="S", data={}, settings={})
    assert type(error.value) is kind


def test_a_program_of_a_user_cannot_blame_its_files(tmp_path: Path) -> None:
    start = "answer(error='no road', unsuitable=True)\nreturn"
    with pytest.raises(UnavailableError, match="no road") as error, served(tmp_path, start=start):
        pass
    assert type(error.value) is UnavailableError


def test_files_that_have_run_are_not_blamed_by_a_new_child(tmp_path: Path) -> None:
    model = tmp_path / "model.py"
    model.write_text("import os\ndef evaluate(p, s):\n    if p['x'] == 1.0: os.abort()\n    return {'y': p['x']}\n")
    with opened("python", tmp_path, file="model.py") as session:
        assert session.evaluate({"x": 2.0}).measures == {"y": 2.0}
        lost(session, {"x": 1.0}, Breakdown.CRASH)
        model.write_text("def broken(")
        with pytest.raises(UnavailableError, match="SyntaxError") as error:
            session.evaluate({"x": 2.0})
    assert type(error.value) is UnavailableError


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
