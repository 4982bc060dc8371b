"""Output of notebooks, with a fake kernel; tests/integration/test_notebooks.py has a real one."""

import sys
from types import SimpleNamespace
from typing import Any

import pytest

from drivecal.client.following import displayed
from drivecal.client.frames import Rows
from drivecal.contracts.campaign import Campaign, Progress
from drivecal.contracts.inventory import InfluenceMapAnswer
from drivecal.contracts.tables import InfluenceRow, JudgedSet, Solution

STATES = [
    Campaign(id="0" * 32, name="mine", state="running", progress=Progress(done=done, total=9, eta_seconds=9.4 - done))
    for done in (1, 5)
]


class Output:
    """The output of a cell."""

    def __init__(self) -> None:
        self.shown: list[Any] = []

    def display(self, value: Any, *, display_id: bool) -> "Output":
        assert display_id
        self.shown.append(value)
        return self

    def update(self, value: Any) -> None:
        self.shown[-1] = value


def pretend(monkeypatch: pytest.MonkeyPatch, shell: object) -> Output:
    output = Output()
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=output.display))
    return output


def test_a_notebook_displays_a_campaign_in_one_place(monkeypatch: pytest.MonkeyPatch) -> None:
    output = pretend(monkeypatch, SimpleNamespace(kernel=object()))
    states = displayed(STATES)
    assert next(states) is STATES[0]
    assert output.shown == [STATES[0]]
    assert list(states) == STATES[1:]
    assert output.shown == [STATES[1]]


@pytest.mark.parametrize("shell", [None, SimpleNamespace()])
def test_elsewhere_nothing_is_displayed(monkeypatch: pytest.MonkeyPatch, shell: object) -> None:
    output = pretend(monkeypatch, shell)
    assert list(displayed(STATES)) == STATES
    assert output.shown == []


def test_a_running_campaign_has_a_bar_and_an_ended_one_has_none() -> None:
    shown = STATES[1]._repr_html_()
    assert '<progress value="5" max="9">' in shown
    assert "<td>seconds left</td><td>4</td>" in shown
    ended = STATES[1].model_validate(STATES[1].model_dump() | {"state": "succeeded", "ended_at": "2026-01-01T00:00:00Z"})
    assert "<progress" not in ended._repr_html_()
    assert "seconds left" not in ended._repr_html_()


def test_rows_are_a_list_and_a_table() -> None:
    solutions = [
        Solution(
            rank=rank,
            objective=0.5,
            rating=0.4,
            reused=[],
            parameters={"P1": 2.0},
            scores={"S1": 7},
            iteration=0,
            individual=rank,
        )
        for rank in range(1, 31)
    ]
    rows = Rows(Solution, solutions)
    assert rows == solutions
    pytest.importorskip("pandas")
    frame = rows.to_pandas()
    assert frame[["rank", "score_S1"]].dtypes.map(str).tolist() == ["Int64", "Int64"]
    assert list(frame["P1"]) == [2.0] * 30
    shown = rows._repr_html_()
    assert "<th>parameters.P1</th>" in shown
    assert shown.count("<tr>") == 21
    assert "10 more rows" in shown


def test_rows_without_parameters_in_common_have_missing_values() -> None:
    sets = [JudgedSet(objectives={name: 1.0}, violation=0.0, on_front=True, iteration=0, individual=0) for name in "ab"]
    table = Rows(JudgedSet, sets).to_arrow()
    assert table.column("objective_a").to_pylist() == [1.0, None]
    assert str(table.schema.field("iteration").type) == "int64"
    assert Rows(JudgedSet, []).to_arrow().num_rows == 0


def test_a_map_is_shown_with_its_rows() -> None:
    row = InfluenceRow(scenario="S1", parameter="P<1>", influential=True, lower=0.0, upper=1.0)
    shown = InfluenceMapAnswer(id="a" * 32, name="mine", source="expert", driving_function="frenet", rows=[row])._repr_html_()
    assert "P&lt;1&gt;" in shown
    assert "expert" in shown
    listed = InfluenceMapAnswer(id="a" * 32, name="mine", source="expert", driving_function="frenet")
    assert "expert" in listed._repr_html_()
