"""Files with results from elsewhere."""

import json
import math
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
from pyarrow import parquet

from drivecal.client.documents import in_pieces
from drivecal.client.imported import read_results
from drivecal.contracts.inventory import ProblemAnswer
from drivecal.contracts.strict_json import MOST_VALUES
from drivecal.domain.errors import InvalidInputError

SECTIONS: dict[str, Any] = {
    "name": "heater",
    "parameters": {"gain": {}, "mode": {"choices": ["eco", "1"]}},
    "shapes": {"torque": {}},
    "scores": {"cost": {}},
    "measures": {"energy": "kWh", "gain": "dB"},
}
PROBLEM = ProblemAnswer.model_construct(**SECTIONS)
ROWS = [{"parameters": {"gain": 0.5, "mode": "1"}, "scores": {"cost": 3.0}, "measures": {}, "scenario": "winter"}]
LINES = [{"scenario": "winter", "gain": 0.5, "mode": "1", "cost": 3}]


def written(folder: Path, name: str, content: str) -> Path:
    path = folder / name
    path.write_text(content, encoding="utf-8-sig")
    return path


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_csv_is_read_with_units_in_its_header(tmp_path: Path, separator: str) -> None:
    lines = [["scenario", "gain [W/K]", "mode", "cost", "energy [kWh]"], ["winter", "0.5", "1", "3", ""]]
    path = written(tmp_path, "rig.csv", "\n".join(separator.join(line) for line in lines))
    assert read_results(path, PROBLEM) == (ROWS, {"gain": "W/K", "energy": "kWh"})


def test_json_and_parquet_are_read_alike(tmp_path: Path) -> None:
    parquet.write_table(pa.Table.from_pylist([LINES[0] | {"energy": math.nan}]), tmp_path / "rig.parquet")
    for path in (written(tmp_path, "rig.json", json.dumps(LINES).lstrip("\ufeff")), tmp_path / "rig.parquet"):
        assert read_results(path, PROBLEM) == (ROWS, {})


def test_a_curve_is_a_list_in_each_kind_of_file(tmp_path: Path) -> None:
    lines: list[dict[str, Any]] = [{"scenario": "winter", "torque": [1.0, 2.5], "cost": 3}]
    parquet.write_table(pa.Table.from_pylist(lines), tmp_path / "rig.parquet")
    json_file = written(tmp_path, "rig.json", json.dumps(lines).lstrip("\ufeff"))
    for path in (
        json_file,
        tmp_path / "rig.parquet",
        written(tmp_path, "rig.csv", 'scenario,torque,cost\nwinter,"[1, 2.5]",3'),
    ):
        assert read_results(path, PROBLEM)[0][0]["parameters"] == {"torque": [1.0, 2.5]}


def test_a_measure_with_the_name_of_a_parameter_has_a_prefix(tmp_path: Path) -> None:
    path = written(tmp_path, "rig.csv", "scenario,gain,mode,measure_gain\nwinter,0.5,eco,7")
    assert read_results(path, PROBLEM)[0][0]["measures"] == {"gain": 7.0}


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("rig.csv", "scenario,gain,mode,comfort\nwinter,0.5,eco,3"),
        ("rig.csv", "scenario,gain,mode,cost\nwinter,half,eco,3"),
        ("rig.csv", "scenario,gain,mode,cost\nwinter,0.5,eco,nan"),
        ("rig.csv", "gain,mode,cost\n0.5,eco,3"),
        ("rig.csv", "scenario,gain,mode,cost\n"),
        ("rig.csv", "scenario,gain,mode,cost\nwinter,0.5,eco,3,4"),
        ("rig.json", '{"scenario": "winter"}'),
        ("rig.csv", "scenario,gain,mode,cost\nwinter,1_0,eco,3"),
        ("rig.csv", "scenario,gain,mode,cost,cost\nwinter,0.5,eco,3,4"),
        ("rig.csv", "scenario,gain,parameter_gain,mode,cost\nwinter,0.5,0.7,eco,3"),
        ("rig.csv", 'scenario,gain,mode,cost\nwinter,0.5,eco,"' + 200_000 * "3"),
        ("rig.json", "[{"),
        ("rig.json", '[{"scenario": "winter", "gain": 1, "gain": 2, "mode": "eco", "cost": 3}]'),
        ("rig.json", '[{"scenario": "winter", "gain": true, "mode": "eco", "cost": 3}]'),
        ("rig.json", '[{"scenario": "s", "gain [A]": 1, "cost": 3}, {"scenario": "t", "gain [mA]": 1000, "cost": 3}]'),
        ("rig.json", 100_000 * "["),
        ("rig.parquet", "scenario"),
    ],
)
def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path, name: str, content: str) -> None:
    with pytest.raises(InvalidInputError):
        read_results(written(tmp_path, name, content), PROBLEM)


def test_rows_are_sent_in_pieces_that_hold_each_row_once() -> None:
    rows = [{"parameters": {"torque": [1.0] * 200}, "scores": {"cost": place}} for place in range(900)]
    pieces = list(in_pieces(rows))
    assert [row for piece in pieces for row in piece] == rows
    assert all(json.dumps(piece).count(",") < MOST_VALUES for piece in pieces)
