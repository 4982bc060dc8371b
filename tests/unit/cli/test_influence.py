"""Notes of `drivecal influence` below its tables."""

import pytest

from drivecal.cli.commands.influence import decided_text, print_influence
from drivecal.contracts.tables import InfluenceRow


def row(
    parameter: str, intervals: list[float | None] | None, *, influential: bool, unknown: bool = False, reason: str | None = None
) -> InfluenceRow:
    return InfluenceRow(
        scenario="S1",
        parameter=parameter,
        influential=influential,
        lower=None,
        upper=None,
        s_rel_intervals=intervals,
        unknown=unknown,
        decided_by=None if reason is None else "global",
        reason=reason,
    )


def test_a_row_that_contradicts_its_intervals_has_its_reason() -> None:
    rows = [
        row("P1", [0.0, 0.2], influential=True, reason="plain"),
        row("P2", [0.0, 0.0], influential=False, reason="plain"),
        row("P3", None, influential=True),
        row("P4", [None, 0.0], influential=True, unknown=True),
        row("P5", [9.4], influential=False, reason="the whole range stays below it"),
    ]
    [line] = decided_text(rows)
    assert line.startswith("S1 P5 ")
    assert "the whole range stays below it" in line


def test_the_table_names_what_decided_each_row(capsys: pytest.CaptureFixture[str]) -> None:
    print_influence([row("P1", [0.2], influential=True, reason="because")], None)
    header, line = capsys.readouterr().out.splitlines()[2:4]
    assert (header.split()[-2:], line.split()[-2:]) == (["decided", "by"], ["global", "analysis"])
