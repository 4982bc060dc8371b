"""What `drivecal influence` says under its tables."""

from __future__ import annotations

import pytest

from drivecal.cli.commands.influence import decided_text, print_influence
from drivecal.contracts.tables import InfluenceRow


def row(
    parameter: str,
    intervals: list[float | None] | None,
    *,
    influential: bool,
    unknown: bool = False,
    reason: str | None = None,
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


def test_rows_that_seem_to_contradict_their_intervals_are_named_with_what_decided() -> None:
    plain = [
        row("P1", [0.0, 0.2], influential=True),
        row("P2", [0.0, 0.0], influential=False),
        row("P3", None, influential=True),
        row("P4", [None, 0.0], influential=True, unknown=True),
    ]
    assert decided_text(plain) == []
    overruled, added = decided_text(
        [*plain, row("P5", [None, 0.381], influential=False), row("P6", [0.0, None], influential=True)]
    )
    assert overruled.startswith("Not influential, though an interval has an s_rel above 0: S1 P5.")
    assert added.startswith("Influential, though no interval has an s_rel above 0: S1 P6.")


def test_a_map_with_reasons_gives_the_one_of_each_row_that_seems_to_contradict_its_intervals() -> None:
    rows = [
        row("P1", [0.0, 0.2], influential=True, reason="plain"),
        row("P5", [9.4], influential=False, reason="the whole range stays below it"),
    ]
    [line] = decided_text(rows)
    assert line.startswith("S1 P5 ")
    assert "the whole range stays below it" in line


def test_the_table_names_what_decided_each_row(capsys: pytest.CaptureFixture[str]) -> None:
    print_influence([row("P1", [0.2], influential=True, reason="because")], None)
    header, line = capsys.readouterr().out.splitlines()[2:4]
    assert (header.split()[-2:], line.split()[-2:]) == (["decided", "by"], ["global", "analysis"])
