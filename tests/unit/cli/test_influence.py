"""What `drivecal influence` says under its tables."""

from __future__ import annotations

from drivecal.cli.commands.influence import decided_text
from drivecal.contracts.tables import InfluenceRow


def row(parameter: str, intervals: list[float | None] | None, *, influential: bool, unknown: bool = False) -> InfluenceRow:
    return InfluenceRow(
        scenario="S1",
        parameter=parameter,
        influential=influential,
        lower=None,
        upper=None,
        s_rel_intervals=intervals,
        unknown=unknown,
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
