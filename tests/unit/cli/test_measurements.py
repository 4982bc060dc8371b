"""Time series as MF4: written by asammdf, read by its data frames and by mdfreader."""

import io
import sys
import warnings
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import mdfreader
import numpy as np
import pytest
from asammdf import MDF
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.command import command
from tests.unit.calibration_data.test_chosen import BEST, Data

from drivecal.cli.commands import evaluate, results
from drivecal.cli.views.time_series import RecordedScenario, measurement
from drivecal.contracts.campaign import Campaign, Page
from drivecal.contracts.evaluation import Evaluation, SeriesAnswer, TraceAnswer
from drivecal.contracts.tables import Solution

BEGUN = datetime(2026, 11, 22, 1, 2, 3, tzinfo=UTC)
DRIVEN = TraceAnswer(
    scenario="S1", score=5, rating=5.1, failure=None, metrics={}, time_s=[0.1, 0.2, 0.3], ego={"speed_mps": [30.0, 29.5, 29.0]},
    neighbours={"slow": {"s_m": [3.0, 5.5, 8.0]}}, plans=[],
)  # fmt: skip
REPORTED = SeriesAnswer(
    measures={}, failure="collision", series={"t": [0.0, 0.5], "gap": [3.0, 2.5], "events": [1.0, 2.0, 4.0], "nothing": []}
)


def channels(content: bytes) -> dict[tuple[str, str], tuple[list[float], list[float], str]]:
    """Times, values and unit by group and channel, read back by asammdf group by group."""
    found = {}
    with MDF(io.BytesIO(content)) as file:
        groups: list[Any] = file.groups
        for number, group in enumerate(groups):
            for channel in group.channels[1:]:
                signal = file.get(channel.name, group=number)
                found[group.channel_group.acq_name, channel.name] = (
                    signal.timestamps.tolist(),
                    signal.samples.tolist(),
                    signal.unit,
                )
    return found


def test_a_file_has_a_group_for_each_scenario_with_units() -> None:
    content = measurement(
        [RecordedScenario("S1", DRIVEN, {}, {}), RecordedScenario("follow", REPORTED, {}, {"gap": "m", "events": "1"})],
        {},
        BEGUN,
    )
    assert channels(content) == {
        ("S1", "speed_mps"): ([0.1, 0.2, 0.3], [30.0, 29.5, 29.0], "m/s"),
        ("S1", "slow_s_m"): ([0.1, 0.2, 0.3], [3.0, 5.5, 8.0], "m"),
        ("follow", "gap"): ([0.0, 0.5], [3.0, 2.5], "m"),
        ("follow, series 2", "events"): ([0.0, 1.0, 2.0], [1.0, 2.0, 4.0], ""),
    }


def test_a_second_reader_gives_the_same(tmp_path: Path) -> None:
    file = tmp_path / "run.mf4"
    file.write_bytes(measurement([RecordedScenario("S1", DRIVEN, {}, {})], {"campaign": "c" * 32}, BEGUN))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it does not know the names of groups
        read = mdfreader.Mdf(str(file))
    assert read.get_channel_data("slow_s_m").tolist() == [3.0, 5.5, 8.0]
    assert read.get_channel_data("time").tolist() == [0.1, 0.2, 0.3]
    assert (read.get_channel_unit("speed_mps"), read.get_channel_unit("time")) == ("m/s", "s")


def test_the_file_names_campaign_set_and_scenario() -> None:
    facts = {"campaign": "c" * 32, "set": "2 of solutions", "parameter mode": "<eco> & \x01"}
    with MDF(io.BytesIO(measurement([RecordedScenario("S1", DRIVEN, {"score": "5"}, {})], facts, BEGUN))) as file:
        groups: list[Any] = file.groups
        header, group = file.header.comment, groups[0].channel_group.comment
        assert file.header.start_time == BEGUN
    for name, value in (("campaign", "c" * 32), ("set", "2 of solutions"), ("parameter mode", "&lt;eco&gt; &amp; \ufffd")):
        assert f'<e name="{name}">{value}</e>' in header
    assert "<TX>S1</TX>" in group
    assert '<e name="score">5</e>' in group


@settings(max_examples=20)
@given(st.lists(st.floats(allow_nan=False), min_size=1, max_size=5))
def test_values_keep_their_bits(values: list[float]) -> None:
    series = SeriesAnswer(measures={}, failure=None, series={"gap": values})
    [(_, read, _)] = channels(measurement([RecordedScenario("follow", series, {}, {})], {}, BEGUN)).values()
    assert np.array(read).tobytes() == np.array(values).tobytes()


class Traced:
    """A client of one campaign with the time series of its best set's runs."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def full_id(self, identifier: str) -> str:
        return identifier

    def campaign(self, identifier: str) -> Campaign:
        return Data().campaign().model_copy(update={"id": identifier})

    def solutions(self, _: str, weights: None, limit: int, score: None) -> Page[Solution]:
        return Page[Solution](items=Data().ranked(weights, score)[:limit])

    def cell(self, _: str, iteration: int, individual: int, scenario: str) -> int:
        return {(0, 1, "follow"): 7, (0, 1, "brake"): 8}[iteration, individual, scenario]

    def trace(self, evaluation: str) -> SeriesAnswer:
        return SeriesAnswer(measures={}, failure=None, series={"t": [0.0, 0.5], "gap": [float(evaluation), 2.0]})

    def problem(self, _: str) -> SimpleNamespace:
        return SimpleNamespace(series={"gap": "m"})

    def evaluate(self, _: object) -> Evaluation:
        return Evaluation(
            id="e" * 32, state="succeeded", parameters=BEST, scenario="follow", objective=2.0, items=[], score=2.0
        )


def test_a_set_of_a_campaign_is_exported_with_all_its_scenarios(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(results, "connect", lambda _: Traced())
    file = tmp_path / "set.mf4"
    exported = command("export", "c" * 32, "--table", "solutions", "--row", "1", "--format", "mf4", "-o", str(file))
    assert exported.exit_code == 0, exported.output
    assert channels(file.read_bytes()) == {
        ("follow", "gap"): ([0.0, 0.5], [7.0, 2.0], "m"),
        ("brake", "gap"): ([0.0, 0.5], [8.0, 2.0], "m"),
    }
    with MDF(file) as read:
        assert "c" * 32 in read.header.comment
        assert '<e name="parameter mode">sport</e>' in read.header.comment


def test_an_evaluation_saves_its_time_series(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(evaluate, "connect", lambda _: TracedOnce())
    file = tmp_path / "run.mf4"
    ran = command("evaluate", "P1=2", "mode=sport", "--problem", "acc", "--scenario", "follow", "--trace", str(file))
    assert ran.exit_code == 0, ran.output
    assert channels(file.read_bytes()) == {("follow", "gap"): ([0.0, 0.5], [3.0, 2.0], "m")}


class TracedOnce(Traced):
    """The same for a single evaluation."""

    def trace(self, evaluation: str) -> SeriesAnswer:
        assert evaluation == "e" * 32
        return super().trace("3")


def test_a_missing_library_is_named_with_its_extra_before_anything_is_simulated(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def traced(*_: Any) -> SeriesAnswer:
        pytest.fail("time series were simulated")

    monkeypatch.setitem(sys.modules, "asammdf", None)
    monkeypatch.setattr(results, "connect", lambda _: Traced())
    monkeypatch.setattr(evaluate, "connect", lambda _: TracedOnce())
    monkeypatch.setattr(Traced, "trace", traced)
    monkeypatch.setattr(TracedOnce, "trace", traced)
    file = tmp_path / "run.mf4"
    for arguments in (
        ["export", "c" * 32, "--table", "solutions", "--format", "mf4", "-o", str(file)],
        ["evaluate", "P1=2", "mode=sport", "--problem", "acc", "--scenario", "follow", "--trace", str(file)],
    ):
        refused = command(*arguments)
        assert refused.exit_code == 2
        assert "drivecal[mf4]" in refused.stderr
    assert not file.exists()
