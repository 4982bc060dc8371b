"""SUMO and the closed loop with a planner made for these tests."""

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import libsumo
import numpy as np
import pytest
from tests.support.roads import to_cartesian
from tests.support.values import faults_of, present

from drivecal.adapters.environment import sessions
from drivecal.bundles.highway import Scenario, TrafficVehicle
from drivecal.campaigns.resolve.problem import resolve
from drivecal.cluster import machine
from drivecal.contracts.specification import CampaignSpecification
from drivecal.domain.errors import InvalidInputError
from drivecal.domain.evaluations import Failure
from drivecal.domain.parameters import Parameter
from drivecal.domain.roads import Floats, reference_line
from drivecal.highway import sumo
from drivecal.highway.comfort.reference import REFERENCE
from drivecal.highway.drive import geometry, tasks
from drivecal.highway.drive.tasks import NEIGHBOUR_COLUMNS, TaskRunner
from drivecal.highway.drive.traffic import Traffic, TrafficError
from drivecal.highway.scenarios import HIGHWAY, RANDOM_FOLDER, scenario_of
from drivecal.highway.sumo import EGO
from drivecal.highway.vehicle.plugin import SINGLE_TRACK
from drivecal.plugins.ports import Observation, VehicleModel
from drivecal.plugins.simulators import RunOutcome

S1 = HIGHWAY.scenarios["S1"]
SCENARIOS = list(HIGHWAY.scenarios.values())


class Glide:
    """Plans to slide to an offset d at constant speed; parameters: (d at the end, seconds that it takes, start time)."""

    period = 0.2

    def __init__(self, scenario: Scenario) -> None:
        self.line = reference_line(scenario.road)
        self.ego = scenario.ego
        self.parameters: Sequence[float] = ()

    def reset(self, parameters: Sequence[float]) -> None:
        self.parameters = parameters

    def place(self, time: float) -> tuple[float, float]:
        end, duration, begin = self.parameters
        w = min(1.0, max(0.0, (time - begin) / duration))
        return self.ego.s + self.ego.speed * time, self.ego.d + (end - self.ego.d) * (10 * w**3 - 15 * w**4 + 6 * w**5)

    def plan(self, observation: Observation) -> Floats:
        times = np.arange(16) * 0.1
        points = np.array([to_cartesian(self.line, *self.place(observation.time + time))[:2] for time in times])
        ahead = np.array([to_cartesian(self.line, *self.place(observation.time + time + 0.01))[:2] for time in times])
        dx, dy = (ahead - points).T
        heading = np.unwrap(np.arctan2(dy, dx))
        speed = np.hypot(dx, dy) / 0.01
        curvature = np.gradient(heading, 0.1) / speed
        return np.column_stack([times, points, heading, curvature, speed, np.zeros(16)])


class Gliding:
    """`Glide` as a driving function."""

    name, version = "gliding", "1"
    spaces: Mapping[str, tuple[Parameter, ...]] = MappingProxyType({"gliding": ()})

    def create(self, scenario: Scenario) -> Glide:
        return Glide(scenario)


def model() -> VehicleModel:
    return SINGLE_TRACK.create({parameter.name: parameter.nominal for parameter in SINGLE_TRACK.parameters})


def runner(scenario: Scenario, vehicle: VehicleModel | None = None) -> TaskRunner:
    return TaskRunner(scenario, Gliding(), vehicle or model())  # type: ignore[arg-type]  # it has no space to search


def traced(scenario: Scenario, parameters: Sequence[float]) -> tuple[RunOutcome, dict[str, Floats]]:
    result = runner(scenario).run(parameters, series=True)
    return result, {name: np.array(values) for name, values in result.series.items()}


def of_neighbour(series: Mapping[str, Floats], name: str) -> Floats:
    return np.column_stack([series[f"{name}_{column}"] for column in NEIGHBOUR_COLUMNS])


def driven(scenario: Scenario, *parameters: float) -> list[bytes]:
    """Everything that happens in a run, bit by bit."""
    seen: list[bytes] = []
    whole = runner(scenario)  # its folder has what SUMO reads again
    run = whole._loop.run(parameters, watch=lambda traffic, pose, _: seen.append(pose.tobytes() + traffic.neighbours.tobytes()))
    return [*seen, run.record.rows.tobytes(), run.record.dynamics.tobytes()]


def changes_lane(scenario: Scenario) -> tuple[float, float, float]:
    return scenario.task.target_lane * scenario.road.lane_width, 5.0, 1.0


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda scenario: scenario.id)
def test_all_vehicles_start_where_the_definition_says_and_stay_on_the_road(scenario: Scenario) -> None:
    width = scenario.road.lane_width
    starts = np.array([(vehicle.s, vehicle.lane * width, vehicle.speed) for vehicle in scenario.traffic])
    seen: list[Floats] = []
    runner(scenario)._loop.run((scenario.ego.d, 1.0, 0.0), watch=lambda traffic, *_: seen.append(traffic.neighbours.copy()))
    assert seen[0][:, 0] == pytest.approx(starts[:, 0], abs=0.1)
    assert seen[0][:, 1] == pytest.approx(starts[:, 1], abs=0.02)
    assert seen[0][:, 2] == pytest.approx(starts[:, 2], rel=0.02)
    drifts = np.array([max((abs(offset) for _, offset in vehicle.drift), default=0.0) for vehicle in scenario.traffic])
    for neighbours in seen:
        assert (abs(neighbours[:, 1] - starts[:, 1]) <= drifts + 0.02).all()
        assert (neighbours[:, 0] < scenario.road.length).all()
        assert (neighbours[:, 2] > 0).all()


def test_a_drifting_neighbour_is_seen_to_drift() -> None:
    scenario = HIGHWAY.scenarios["S3"]
    drifting = next(vehicle for vehicle in scenario.traffic if vehicle.drift)
    _, series = traced(scenario, (scenario.ego.d, 1.0, 0.0))
    rows = of_neighbour(series, drifting.id)
    offsets = np.interp(series["time_s"], *np.array(drifting.drift).T)
    assert rows[:, 1] - drifting.lane * scenario.road.lane_width == pytest.approx(offsets[: len(rows)], abs=1e-6)


def test_the_follower_in_the_target_lane_makes_room() -> None:
    follower = next(vehicle.id for vehicle in S1.traffic if vehicle.id == "follower")
    stays, changes = (of_neighbour(traced(S1, to)[1], follower) for to in ((0.0, 1.0, 0.0), changes_lane(S1)))
    assert (changes[:20] == stays[:20]).all(), "nobody can see a lane change before it begins"
    last = min(len(stays), len(changes)) - 1
    assert changes[last, 2] < stays[last, 2] - 0.5


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda scenario: scenario.id)
def test_other_vehicles_see_their_own_lane_only(scenario: Scenario) -> None:
    """They brake for no lane change that they only wish, as SUMO's model of lane changes makes them."""
    stays = (scenario.task.start_lane * scenario.road.lane_width, 1.0, 0.0)
    _, together = traced(scenario, stays)
    for lane in {vehicle.lane for vehicle in scenario.traffic} - {scenario.task.start_lane}:
        column = tuple(vehicle for vehicle in scenario.traffic if vehicle.lane == lane)
        _, apart = traced(replace(scenario, traffic=column), stays)
        moments = min(len(together["time_s"]), len(apart["time_s"]))
        assert moments > 20
        for vehicle in column:
            seen, alone = (of_neighbour(series, vehicle.id)[:moments] for series in (together, apart))
            assert (seen == alone).all(), vehicle.id


def test_the_same_cell_gives_the_same_bits_after_any_other_cells() -> None:
    first = {scenario.id: driven(scenario, *changes_lane(scenario)) for scenario in SCENARIOS}
    for scenario in [*SCENARIOS, *reversed(SCENARIOS)]:
        driven(scenario, scenario.ego.d - 0.5, 3.0, 2.0)
        assert driven(scenario, *changes_lane(scenario)) == first[scenario.id]


@pytest.mark.slow
def test_random_traffic_follows_its_seed_and_nothing_else() -> None:
    bench = resolve(CampaignSpecification.model_validate({"problem": "highway-random"})).bench
    scenarios = {name: scenario_of(name, request.data, RANDOM_FOLDER) for name, request in bench.requests.items()}
    assert list(scenarios) == [f"S{number}r" for number in range(1, 7)]
    for scenario in scenarios.values():
        first = driven(scenario, *changes_lane(scenario))
        assert driven(replace(scenario, seed=2), *changes_lane(scenario)) != first
        assert driven(scenario, *changes_lane(scenario)) == first
    drifting = next(vehicle for vehicle in scenarios["S3r"].traffic if vehicle.drift)
    assert np.ptp(traced(scenarios["S3r"], (S1.ego.d, 1.0, 0.0))[1][f"{drifting.id}_d_m"]) > 0.5


def test_an_equal_scenario_that_is_another_object_gives_the_same_bits() -> None:
    assert driven(replace(S1), *changes_lane(S1)) == driven(S1, *changes_lane(S1))


def test_running_into_the_slower_vehicle_is_a_collision_and_ends_the_run() -> None:
    result = runner(S1).run((0.0, 1.0, 0.0))
    assert result.failure == Failure.COLLISION
    assert result.measures["driven_s"] < S1.duration


def test_leaving_the_road_ends_the_run_before_sumo_sees_it() -> None:
    result, series = traced(S1, (-4.0, 2.0, 0.0))
    assert result.failure == Failure.OFF_ROAD
    assert series["d_m"].min() >= S1.road.right_edge
    assert len(series["time_s"]) < result.measures["driven_s"] / S1.step + 0.5


def test_a_lane_change_in_the_wrong_direction_misses_the_task() -> None:
    scenario = replace(S1, traffic=S1.traffic[1:])
    result = runner(scenario).run((0.0, 1.0, 0.0))
    assert result.failure == Failure.TASK_MISSED
    assert result.measures["driven_s"] == pytest.approx(S1.duration)


def test_a_calm_lane_change_on_a_free_road_is_rated_better_than_a_hasty_one() -> None:
    free = runner(replace(S1, traffic=S1.traffic[:1]))
    calm, hasty = free.run((S1.road.lane_width, 7.0, 0.0)), free.run((S1.road.lane_width, 3.5, 0.0))
    assert calm.failure is None
    assert hasty.failure is None
    better, worse = (REFERENCE.rate(S1.rated_as, run.measures) for run in (calm, hasty))
    assert better.score == 7
    assert worse.rating < better.rating - 2


def test_an_unstable_vehicle_says_so() -> None:
    values = {parameter.name: parameter.nominal for parameter in SINGLE_TRACK.parameters}

    class Spinning:
        def __init__(self) -> None:
            self.model = SINGLE_TRACK.create(values)
            self.steps = 0

        def start(self, x: float, y: float, heading: float, speed: float) -> None:
            self.steps = 0
            self.model.start(x, y, heading, speed)

        @property
        def pose(self) -> Floats:
            return self.model.pose

        def follow(self, trajectory: Floats, since: float, duration: float, dynamics: Floats) -> bool:
            self.steps += 1
            return self.model.follow(trajectory, since, duration, dynamics) and self.steps < 30

    result = runner(S1, Spinning()).run(changes_lane(S1))
    assert result.failure == Failure.UNSTABLE
    assert result.measures["driven_s"] == pytest.approx(3.0)


def test_tracing_changes_nothing() -> None:
    subject = runner(S1)
    plain = subject.run(changes_lane(S1))
    assert replace(subject.run(changes_lane(S1), series=True), series={}) == plain
    assert subject.run(changes_lane(S1)) == plain


def test_a_trace_holds_what_the_run_was_rated_by() -> None:
    result, series = traced(S1, changes_lane(S1))
    metrics = result.measures
    for axis in ("lateral", "longitudinal"):
        assert np.abs(series[f"{axis}_jerk_mps3"]).max() == pytest.approx(metrics[f"peak_{axis}_jerk_mps3"], rel=0.15, abs=0.05)
        assert np.abs(series[f"{axis}_acceleration_mps2"]).max() >= 0.9 * metrics[f"peak_{axis}_acceleration_mps2"]
    line = reference_line(S1.road)
    for x, y, s, d in zip(*(series[name] for name in ("x_m", "y_m", "s_m", "d_m")), strict=True):
        assert to_cartesian(line, s, d)[:2] == pytest.approx((x, y), abs=1e-6)
    for rows in (of_neighbour(series, vehicle.id) for vehicle in S1.traffic):
        steps = np.hypot(*np.diff(rows[:, 4:6], axis=0).T)
        assert steps == pytest.approx(rows[1:, 2] * S1.step, abs=0.3)


@pytest.mark.parametrize("step", [0.1, 0.05])
def test_an_overshoot_is_the_same_at_any_step(step: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The offset is planted: it is centred for 0.7 s."""
    swings = np.repeat([0.3, 0.0, -0.3], [round(seconds / step) for seconds in (1.0, 0.7, 90.0)])
    monkeypatch.setattr(tasks, "target_offsets", lambda motion, _: swings[: len(motion)])
    assert runner(replace(S1, step=step)).run(changes_lane(S1)).measures["offset_overshoot_m"] == 0.3


def test_a_trace_has_its_road_the_others_and_the_plans() -> None:
    answer = runner(S1).run(changes_lane(S1), series=True)
    series, replay = answer.series, present(answer.replay).model_dump(mode="json")
    steps = round(S1.duration / S1.step)
    assert len(series["time_s"]) == len(series["speed_mps"]) == steps
    assert {other["id"] for other in replay["others"]} == {vehicle.id for vehicle in S1.traffic}
    assert len(replay["plans"]) == steps / 2
    assert len(replay["route"]["lanes"]) == S1.road.lanes
    assert series["d_m"][-1] == pytest.approx(S1.road.lane_width, abs=0.1)
    assert replay["ego"]["x_m"][1:] == pytest.approx(series["x_m"], abs=0.01)


@pytest.mark.parametrize("content", [b"", b"no xml", b"<net/>", S1.network[: len(S1.network) // 2]])
def test_a_damaged_network_is_refused_and_the_next_scenario_still_runs(content: bytes) -> None:
    with pytest.raises(InvalidInputError, match="S1"):
        runner(replace(S1, network=content))
    assert runner(S1).run(changes_lane(S1)).measures["driven_s"] > 0


def test_a_vehicle_that_the_network_has_no_room_for_is_named() -> None:
    outside = TrafficVehicle(id="outside", lane=7, s=5000.0, speed=20.0, desired_speed=20.0, drift=[])
    assert [problem.field for problem in faults_of(runner, replace(S1, traffic=(outside,)))] == ["scenarios.S1.traffic[0].s"]


@pytest.mark.parametrize("other", ["load", "close"])
def test_a_scenario_is_loaded_again_if_another_user_of_the_process_loaded_or_ended_sumo(other: str, tmp_path: Path) -> None:
    subject = runner(S1)
    before = subject.run(changes_lane(S1))
    if other == "load":
        network, vehicles = tmp_path / "a.net.xml", tmp_path / "a.rou.xml"
        network.write_bytes(SCENARIOS[1].network)
        vehicles.write_text("<routes/>")
        sumo.load(sumo.options(str(network), str(vehicles), S1.step, S1.seed))
    else:
        libsumo.close()
    assert subject.run(changes_lane(S1)) == before


def test_a_scenario_is_loaded_anew_after_sumo_failed_in_it() -> None:
    subject = runner(S1)
    before = subject.run(changes_lane(S1))
    length = libsumo.vehicletype.getLength("follower")

    def spoil(traffic: Traffic, pose: Floats, plan: Floats | None) -> None:
        del traffic, pose, plan
        if libsumo.simulation.getTime() >= 2.0:
            libsumo.vehicletype.setLength("follower", 77.0)  # what a reset does not mend
            libsumo.vehicle.remove("ego")

    with pytest.raises(TrafficError, match="ego"):
        subject._loop.run(changes_lane(S1), watch=spoil)
    assert subject.run(changes_lane(S1)) == before
    assert libsumo.vehicletype.getLength("follower") == length


def test_a_step_that_does_not_fit_the_vehicle_s_sample_time_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="multiple"):
        runner(replace(S1, step=0.125))


def test_without_libsumo_nothing_runs() -> None:
    code = "import sys; sys.modules['libsumo'] = None\nimport drivecal.highway.drive.tasks"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "install libsumo" in done.stderr


def test_the_limit_of_each_edge_slows_the_traffic() -> None:
    scenario = HIGHWAY.scenarios["S5"]
    speeds = traced(scenario, (0.0, 1.0, 0.0))[1]["second_s_dot_mps"]
    assert speeds[0] < 23.0
    assert speeds[-1] > 28.0
    network = scenario.network.replace(b'speed="33.3333"', b'speed="23.0000"')
    held = replace(scenario, network=network)
    assert held.digest != scenario.digest
    assert traced(held, (0.0, 1.0, 0.0))[1]["second_s_dot_mps"][-1] == pytest.approx(23.0, abs=0.1)


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda scenario: scenario.id)
def test_all_vehicles_are_where_sumo_has_them(scenario: Scenario) -> None:
    subject, steps = runner(scenario), 0
    road = subject._loop._road

    def compare(traffic: Traffic, pose: Floats, plan: Floats | None) -> None:
        del plan
        nonlocal steps
        steps += 1
        if steps == 1:
            return
        rows = [traffic.motion[[geometry.TRACK, geometry.ALONG]].tolist()]
        rows += traffic.outlines[:, [geometry.SAID + 3, geometry.SAID]].tolist()
        for name, (track, along) in zip([EGO, *traffic.names], rows, strict=True):
            edge, index, position = road.sumo.place(int(track), along)
            assert libsumo.vehicle.getLaneID(name) == f"{edge}_{index}"
            assert libsumo.vehicle.getLanePosition(name) == pytest.approx(position, abs=1e-9)
        assert libsumo.vehicle.getSpeed(EGO) == pytest.approx(pose[3], abs=0.6)
        for name, outline, row in zip(traffic.names, traffic.outlines.tolist(), traffic.neighbours, strict=True):
            x, y, heading, half_length = outline[:4]
            front = x + half_length * np.cos(heading), y + half_length * np.sin(heading)
            aside = row[1] - scenario.road.lane_width * round(row[1] / scenario.road.lane_width)
            assert np.hypot(*np.subtract(libsumo.vehicle.getPosition(name), front)) == pytest.approx(abs(aside), abs=0.25)

    subject._loop.run(changes_lane(scenario), watch=compare)
    assert steps > 20, "the drive ended too early to compare"


def test_the_folder_of_a_drive_is_locked_and_goes_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(machine, "A_MOMENT", -1.0)
    drive = runner(S1)
    (folder,) = sessions().iterdir()
    killed, lock = machine.locked_folder(sessions(), "drivecal-drive-l-", shutil.rmtree)
    os.close(lock)
    other = runner(S1)
    assert (folder.exists(), killed.exists()) == (True, False)
    assert drive.run(changes_lane(S1)) == other.run(changes_lane(S1))
    del drive
    assert not folder.exists()
