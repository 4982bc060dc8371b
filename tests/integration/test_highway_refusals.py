"""What SUMO, or the check before it, refuses of a scenario of kind `highway`, and how the cause is told."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tests.support.motorways import NETWORK, drive, driven, motorway

from drivecal.domain.errors import UnavailableError

LEADER = {"id": "leader", "s": 102, "speed": 30}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return motorway(tmp_path_factory.mktemp("motorways") / "bundle")


@pytest.mark.slow("change0-e9", "change1-e2", "change2-lane 5", "change4-e9")
@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"route": ["e0", "e9"]}, "e9"),
        ({"route": ["e0", "e2"]}, "e2"),
        ({"ego": {"lane": 5, "s": 100, "speed": 30}}, "lane 5"),
        ({"ego": {"lane": 0, "s": 4000, "speed": 30}}, "s = 4000 m"),
        ({"traffic": [{"s": 150, "edge": "e9", "speed": 30}]}, "e9"),
        ({"traffic": [{"s": 150, "speed": 30}, {"s": 151, "speed": 30}]}, "vehicle1"),
    ],
)
def test_a_scenario_that_does_not_fit_its_network_names_the_cause(folder: Path, change: dict[str, Any], cause: str) -> None:
    with pytest.raises(UnavailableError, match=cause), driven(folder, drive() | change):
        pass


def test_the_ego_vehicle_does_not_start_inside_of_another(folder: Path) -> None:
    with pytest.raises(UnavailableError, match="leader"), driven(folder, drive([LEADER])):
        pass


@pytest.mark.slow
def test_a_network_that_sumo_refuses_is_named(tmp_path: Path) -> None:
    bundle = motorway(tmp_path / "bundle")
    text = NETWORK.read_text()
    for damaged in (text[: len(text) // 2], "", "<net/>", text.replace('"e1', '"e0')):
        (bundle / "road.net.xml").write_text(damaged)
        with pytest.raises(UnavailableError, match=r"road\.net\.xml"), driven(bundle, drive()):
            pass


def test_the_cause_for_which_sumo_refuses_a_network_is_named(tmp_path: Path) -> None:
    bundle = motorway(tmp_path / "bundle")
    (bundle / "road.net.xml").write_text(NETWORK.read_text().replace(' state="M"', ' state="wrong"'))
    with pytest.raises(UnavailableError, match=r"road\.net\.xml.*link state 'wrong'"), driven(bundle, drive()):
        pass
