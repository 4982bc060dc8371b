"""Tables of `drivecal influence`."""

import pytest

from drivecal.cli.commands.influence import print_influence
from drivecal.contracts.tables import InfluenceRow


def test_the_table_names_what_decided_each_row(capsys: pytest.CaptureFixture[str]) -> None:
    row = InfluenceRow(
        scenario="S1", parameter="P1", influential=True, lower=None, upper=None, s_rel_intervals=[0.2], decided_by="global"
    )
    print_influence([row], None)
    header, line = capsys.readouterr().out.splitlines()[2:4]
    assert (header.split()[-2:], line.split()[-2:]) == (["decided", "by"], ["0.200", "global"])
