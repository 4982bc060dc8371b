"""Scenarios of OpenSCENARIO and SUMO route files as workers drive them: what the files say happens, and gives the same bits anywhere."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support.motorways import CONTROLLERS, PARAMETERS, PYTHON, driven, motorway
from tests.support.scenario_files import write_files
from tests.support.simulators import series

from drivecal.plugins.simulators import RunOutcome

BLIND = "def control(observation, parameters):\n    return 0.0\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("described") / "bundle"
    motorway(path, BLIND)
    write_files(path)
    (path / "peak.rou.xml").write_bytes(DAY)
    (path / "follow.py").write_text(PYTHON)
    return path


MERGE = {
    "network": "merge.net.xml",
    "route": ["before", "beside", "after"],
    "duration": 12.0,
    "ego": {"lane": 0, "s": 60, "speed": 28},
    "routes": "merge.rou.xml",
}
PEAK = {
    "network": "road.net.xml",
    "route": ["e0", "e1", "e2"],
    "duration": 12.0,
    "ego": {"lane": 0, "s": 2000, "speed": 28},
    "routes": "peak.rou.xml",
    "begin": 25_200,
    "warm_up": 120,
    "seed": 4,
}
"""A drive in the traffic of an hour of the day, which enters 2 km behind."""
DAY = b"""<routes>
<vTypeDistribution id="all">
  <vType id="car" probability="0.8" speedFactor="normc(1,0.1,0.2,2)"/><vType id="lorry" vClass="truck" probability="0.2"/>
</vTypeDistribution>
<route id="r" edges="e0 e1 e2"/>
<vehicle id="night" route="r" depart="3:00:00"/>
<flow id="right" type="all" route="r" begin="7:00:00" end="8:00:00" period="2.5" departLane="free" departSpeed="desired"/>
<flow id="early" type="all" route="r" begin="6:00:00" end="7:00:00" period="2.5" departLane="free" departSpeed="desired"/>
<flow id="others" type="all" route="r" begin="0" end="86400" period="exp(0.1)" departLane="free" departSpeed="desired"/>
</routes>"""


def result(folder: Path, data: Mapping[str, Any], file: str = "acc.py", values: Mapping[str, Any] = PARAMETERS) -> RunOutcome:
    with driven(folder, data, CONTROLLERS["python"] | {"file": file}) as session:
        return session.evaluate(values, series=True)


@pytest.mark.slow
def test_a_car_that_overtakes_cuts_in_ahead_and_brakes_afterwards(folder: Path) -> None:
    outcome = result(folder, {"openscenario": "scenarios/cut_in.xosc"})
    gap, speed, time = (series(outcome, name) for name in ("gap_m", "leader_speed_mps", "time_s"))
    enters = int(np.argmax(gap < 1000))
    # 30 m behind and 6 m/s faster, it is 0.8 s (24 m) ahead after 9 s; its side reaches the lane in the 3 s of the change.
    assert 9.0 < time[enters] < 12.0
    assert gap[enters] == pytest.approx(6 * (time[enters] - 5.0) - 4.4, abs=0.8)
    assert speed[enters] == pytest.approx(36.0, abs=0.01)
    braking = time[np.argmax(series(outcome, "leader_speed_mps") * (time > time[enters]) + 99 * (time <= time[enters]) < 35.9)]
    assert braking == pytest.approx(13.1, abs=0.3)  # a second after the change is done


def test_a_pedestrian_who_crosses_is_hit_by_who_does_not_brake_in_the_same_bits(folder: Path) -> None:
    data = {"openscenario": "scenarios/walks_across.xosc"}
    with driven(folder, data, CONTROLLERS["python"] | {"file": "acc.py"}) as session:
        first, second = session.evaluate(PARAMETERS), session.evaluate(PARAMETERS)
    assert first.failure == second.failure == "collision"
    assert first.measures == second.measures
    # The pedestrian is in the middle of the lane when the front is there, 146 m behind the start; the step has 2 m.
    assert first.measures["distance_m"] == pytest.approx(146.0, abs=3.0)


def test_a_route_file_brings_its_vehicles_and_flows(folder: Path) -> None:
    outcome = result(folder, MERGE, "follow.py")
    assert outcome.failure is None
    assert series(outcome, "gap_m").min() < 1000 or series(outcome, "rear_gap_m").min() < 1000


@pytest.mark.slow
@pytest.mark.parametrize("data", [{"openscenario": "scenarios/cut_in.xosc"}, MERGE, PEAK], ids=["xosc", "routes", "warm-up"])
def test_runs_repeat_to_the_bit_in_other_orders_and_processes(folder: Path, data: dict[str, Any]) -> None:
    sets = [PARAMETERS | {"v0": speed} for speed in (26.0, 30.0, 33.0)]
    with driven(folder, data, CONTROLLERS["python"] | {"file": "follow.py"}) as session:
        forwards = [session.evaluate(parameters).measures for parameters in sets]
    with driven(folder, data, CONTROLLERS["python"] | {"file": "follow.py"}) as session:
        backwards = [session.evaluate(parameters).measures for parameters in reversed(sets)]
    assert forwards == backwards[::-1]
