"""Manifests of kind `highway`: the simulator section, scenarios, and what they may declare of answers."""

from functools import partial
from typing import Any

import pytest
import yaml
from tests.support.changes import with_change
from tests.support.values import faults_of
from tests.unit.bundles.test_checks import VALID as PROCESS_VALID
from tests.unit.bundles.test_checks import faults

from drivecal.bundles.archives import BundleFile
from drivecal.bundles.checks import checked
from drivecal.bundles.fingerprints import setup_document
from drivecal.bundles.highway import CLASSES, HighwaySimulator, TrafficEntry
from drivecal.bundles.installed import installed_problems
from drivecal.plugins import simulators

VALID: dict[str, Any] = {
    "problem": "acc",
    "parameters": {"T": {"lower": 0.8, "upper": 2.5, "unit": "s"}},
    "simulator": {
        "kind": "highway",
        "controller": {"kind": "python", "file": "acc.py", "function": "accelerate", "output": ["acceleration"]},
        "vehicle": "single_track",
    },
    "scenarios": {
        "merge": {
            "network": "road.net.xml",
            "route": ["e1", "e2"],
            "duration": 20,
            "ego": {"lane": 0, "s": 100, "speed": 28},
            "traffic": [],
        },
        "busy": {
            "network": "road.net.xml",
            "route": ["e1", "e2"],
            "duration": 20,
            "ego": {"s": 100, "speed": 28, "length": 5, "width": 2},
            "traffic": [
                {"id": "lead", "s": 150, "speed": 25, "actions": [{"do": "brake", "time": 5}]},
                {"s": 150, "lane": 1, "speed": 25, "model": "Krauss", "actions": [{"do": "cut_in", "gap": 20, "lane": 0}]},
                {"s": 50, "edge": "ramp", "route": ["ramp", "e2"], "speed": 20, "parameters": {"lcAssertive": 2}},
            ],
            "seed": 7,
        },
    },
    "measures": {"min_ttc_s": "s", "p95_jerk_mps3": "m/s^3", "energy_kwh": "kWh"},
    "series": {"gap_m": "m"},
    "scores": {"cost": {"formula": "energy_kwh", "direction": "minimise", "range": [0, 1]}},
}
BUNDLED = ("acc.py", "acc.fmu", "acc", "road.net.xml", "a,b.net.xml", "${HOME}.net.xml")
FILES = {name: BundleFile(b"", executable=name == "acc") for name in BUNDLED}
FMU = {
    "kind": "fmu",
    "file": "acc.fmu",
    "signals": {"gap": "u1", "speed": "u2", "acceleration": "y"},
    "output": ["acceleration"],
}
PROCESS = {"kind": "process", "command": ["./acc"], "signals": ["gap", "speed"], "output": ["curvature"]}


changed = partial(with_change, VALID)


@pytest.mark.parametrize("controller", [VALID["simulator"]["controller"], FMU, PROCESS])
def test_each_kind_of_controller_passes(controller: dict[str, Any]) -> None:
    manifest = checked(changed("simulator/controller", controller), FILES)
    assert isinstance(manifest.simulator, HighwaySimulator)
    assert manifest.simulator.controller.kind == controller["kind"]


def test_a_vehicle_may_have_other_values_than_those_of_table_8() -> None:
    manifest = checked(changed("simulator/vehicle", {"model": "single_track", "mass": 1800}))
    assert setup_document(manifest, "merge", "")["simulator"]["vehicle"] == {"model": "single_track", "mass": 1800}
    assert setup_document(checked(VALID), "merge", "")["simulator"]["vehicle"] == "single_track"


@pytest.mark.parametrize(
    ("path", "value", "field"),
    [
        ("simulator/controller", None, "simulator.controller"),
        ("simulator/controller/kind", "matlab", "simulator.controller.kind"),
        ("simulator/controller/output", [], "simulator.controller.output"),
        ("simulator/controller/output", ["speed"], "simulator.controller.output[0]"),
        ("simulator/controller/output", ["curvature", "steering"], "simulator.controller.output"),
        ("simulator/controller/file", "other.py", "simulator.controller.file"),
        ("simulator/controller/file", "../acc.py", "simulator.controller.file"),
        ("simulator/controller/file", "acc.fmu", "simulator.controller.file"),
        ("simulator/controller/period", 0.015, "simulator.controller.period"),
        ("simulator/controller", PROCESS | {"command": ["./missing"]}, "simulator.controller.command[0]"),
        ("simulator/controller", PROCESS | {"signals": ["gapp"]}, "simulator.controller.signals[0]"),
        ("simulator/controller", PROCESS | {"signals": ["gap", "gap"]}, "simulator.controller.signals[1]"),
        ("simulator/controller", FMU | {"signals": {"gap": "u1"}}, "simulator.controller.signals"),
        ("simulator/controller", FMU | {"signals": {"gapp": "u1", "acceleration": "y"}}, "simulator.controller.signals.gapp"),
        ("simulator/step", 0.035, "simulator.step"),
        ("simulator/vehicle", "tank", "simulator.vehicle"),
        ("simulator/vehicle", {"mass": -1}, "simulator.vehicle.mass"),
        ("scenarios/merge/network", None, "scenarios.merge.network"),
        ("scenarios/merge/network", "other.net.xml", "scenarios.merge.network"),
        ("scenarios/merge/network", "acc.py", "scenarios.merge.network"),
        ("scenarios/merge/network", "a,b.net.xml", "scenarios.merge.network"),
        ("scenarios/merge/network", "${HOME}.net.xml", "scenarios.merge.network"),
        ("scenarios/merge/route", [], "scenarios.merge.route"),
        ("scenarios/merge/route", ["e1 e2"], "scenarios.merge.route[0]"),
        ("scenarios/merge/duration", 20.05, "scenarios.merge.duration"),
        ("scenarios/merge/ego", None, "scenarios.merge.ego"),
        ("scenarios/merge/ego/s", -1, "scenarios.merge.ego.s"),
        ("scenarios/merge/surplus", 1, "scenarios.merge.surplus"),
        ("scenarios/busy/traffic/0/id", "ego", "scenarios.busy.traffic[0].id"),
        ("scenarios/busy/traffic/1/id", "lead", "scenarios.busy.traffic[1].id"),
        ("scenarios/busy/traffic/1/model", "Ghost", "scenarios.busy.traffic[1].model"),
        ("scenarios/busy/traffic/1/lane_change", "LC2013", "scenarios.busy.traffic[1].actions[0]"),
        ("scenarios/busy/traffic/0/actions/0/gap", 5, "scenarios.busy.traffic[0].actions[0]"),
        ("scenarios/busy/traffic/0/actions/0/time", None, "scenarios.busy.traffic[0].actions[0]"),
        ("scenarios/busy/traffic/0/actions/0/do", "explode", "scenarios.busy.traffic[0].actions[0].do"),
        ("scenarios/busy/traffic/2/parameters", {"lcAssertiv": 2}, "scenarios.busy.traffic[2].parameters.lcAssertiv"),
        ("scenarios/busy/traffic/2/parameters", {"accel": -5}, "scenarios.busy.traffic[2].parameters.accel"),
        ("scenarios/busy/begin", 25_200, "scenarios.busy.begin"),
        ("scenarios/busy/warm_up", 30, "scenarios.busy.warm_up"),
        ("scenarios/merge/warm_up", 30, "scenarios.merge.warm_up"),
        ("measures/min_ttc", "s", "measures.min_ttc"),
        ("measures/min_ttc_s", "min", "measures.min_ttc_s"),
        ("series/gap_m", "km", "series.gap_m"),
        ("series/gap", "m", "series.gap"),
        ("failures", ["explosion", "collision", "off_road", "unstable"], "failures[0]"),
        ("failures", ["collision"], "failures"),
    ],
)
def test_a_fault_is_named_by_its_field(path: str, value: Any, field: str) -> None:
    assert faults(changed(path, value), FILES) == {field}


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({}, ""),
        ({"time": 1, "gap": 3}, ""),
        ({"time": 1, "when": []}, ""),
        ({"when": [{}]}, ".when[0]"),
        ({"when": [{"quantity": "gap"}]}, ".when[0]"),
        ({"when": [{"quantity": "gap", "above": 1, "below": 2}]}, ".when[0]"),
        ({"when": [{"quantity": "speed", "to": "ego", "above": 1}]}, ".when[0].to"),
        ({"when": [{"quantity": "gap", "vehicle": "nobody", "above": 1}]}, ".when[0].vehicle"),
        ({"time": 1, "after": [{"done": "nothing"}]}, ".after[0].done"),
        ({"time": 1, "ends": ["nothing"]}, ".ends[0]"),
        ({"id": "own", "time": 1, "ends": ["own"]}, ".ends[0]"),
        ({"when": [{"quantity": "distance", "below": 2}]}, ".when[0]"),
        ({"when": [{"quantity": "distance", "s": 100, "above": 2}]}, ".when[0]"),
        ({"when": [{"quantity": "speed", "s": 100, "above": 2}]}, ".when[0].s"),
        ({"when": [{"quantity": "speed", "d": 1, "above": 2}]}, ".when[0].d"),
        ({"time": 1, "lane": None}, ".lane"),
        ({"time": 1, "by": 1}, ".lane"),
        ({"time": 1, "beside": "ego"}, ".beside"),
        ({"time": 1, "lane": None, "by": 0, "beside": "nobody"}, ".beside"),
        ({"time": 1, "seconds": 2, "metres": 30}, ""),
    ],
)
def test_faults_of_actions_are_named(given: dict[str, Any], field: str) -> None:
    content = {name: value for name, value in ({"do": "cut_in", "lane": 0} | given).items() if value is not None}
    manifest = changed("scenarios/busy/traffic/0/actions", [content])
    assert faults(manifest) == {f"scenarios.busy.traffic[0].actions[0]{field}"}


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"rate": 2, "seconds": 3}, ""),
        ({"speed": -3}, ".speed"),
        ({"factor": 1.5}, ".factor"),
        ({"continuous": True}, ".continuous"),
        ({"like": "nobody"}, ".like"),
    ],
)
def test_faults_of_changes_of_speed_are_named(given: dict[str, Any], field: str) -> None:
    manifest = changed("scenarios/busy/traffic/0/actions", [{"do": "brake", "time": 1} | given])
    assert faults(manifest) == {f"scenarios.busy.traffic[0].actions[0]{field}"}


def test_an_action_ends_others_of_its_own_vehicle_only() -> None:
    first, second = {"id": "a", "do": "brake", "time": 1}, {"id": "b", "do": "brake", "time": 2, "ends": ["a"]}
    assert checked(changed("scenarios/busy/traffic/0/actions", [first, second]))
    apart = changed("scenarios/busy/traffic/0/actions", [first])
    apart["scenarios"]["busy"]["traffic"][1]["actions"] = [second]
    assert faults(apart) == {"scenarios.busy.traffic[1].actions[0].ends[0]"}


def test_actions_of_one_id_are_named_and_others_may_wait_for_them() -> None:
    first, second = {"id": "a", "do": "brake", "time": 1}, {"id": "b", "do": "brake", "when": [{"done": "a", "delay": 2}]}
    assert checked(changed("scenarios/busy/traffic/0/actions", [first, second]))
    assert faults(changed("scenarios/busy/traffic/0/actions", [first, second | {"id": "a"}])) == {
        "scenarios.busy.traffic[0].actions[1].id"
    }


NAMES = [f"P{number}" for number in range(1, 12)]


def test_a_setup_holds_the_version_of_sumo(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another SUMO may give other bits: its results are kept apart."""
    said = setup_document(checked(VALID), "merge", "")
    assert said["sumo"] == simulators.sumo() != "libsumo not installed"
    monkeypatch.setattr(simulators, "version", lambda _: "0.0.1")
    assert setup_document(checked(VALID), "merge", "") == said | {"sumo": "libsumo 0.0.1"}
    assert "sumo" not in setup_document(checked(PROCESS_VALID), "city", "")


@pytest.mark.parametrize("name", CLASSES)
def test_vehicles_have_the_size_of_their_class(name: str) -> None:
    """The route files' tests compare these sizes with SUMO's."""
    size = (4.7, 1.9) if name == "passenger" else CLASSES[name][:2]
    entry = TrafficEntry.model_validate({"s": 100, "speed": 20, "vehicle_class": name})
    longer = TrafficEntry.model_validate({"s": 100, "speed": 20, "vehicle_class": name, "length": 9.0})
    assert (entry.length, entry.width) == size
    assert (longer.length, longer.width) == (9.0, size[1])


PLAN: dict[str, Any] = yaml.safe_load((installed_problems()["highway"].folder / "problem.yaml").read_text()) | {"problem": "p"}


@pytest.mark.parametrize(
    ("path", "value", "field"),
    [
        ("problem", "highway", "problem"),
        ("varied/mass/nominal", 1.0, "varied.mass.nominal"),
        ("varied/mass/lower", 5000.0, "varied.mass.lower"),
        ("varied/wings", {"nominal": 1, "lower": 0, "upper": 2}, "varied.wings"),
        ("varied/P1", {"nominal": 1, "lower": 0, "upper": 2}, "varied.P1"),
        ("simulator/controller", {"kind": "python", "file": "a.py", "output": ["acceleration"]}, "scenarios.S1.task"),
        ("scenarios/S1/task", None, "scenarios.S1.task"),
        ("scenarios/S1/task/target_lane", -1, "scenarios.S1.task.target_lane"),
        ("scenarios/S1/task/speeds", [[500, 20], [0, 30]], "scenarios.S1.task.speeds"),
        ("scenarios/S1/traffic/0/drift", [[5, 0.5], [1, 0]], "scenarios.S1.traffic[0].drift"),
        (
            "scenarios/S1/traffic",
            [{"id": "ego", "lane": 0, "s": 1, "speed": 1, "desired_speed": 1}],
            "scenarios.S1.traffic[0].id",
        ),
        ("measures/min_ttc_s", "s", "measures.min_ttc_s"),
        ("failures", ["collision"], "failures"),
        ("scores/comfort/formula", "offset_rms_m", "scores.comfort"),
        ("scores/comfort/evaluator", None, "scores.comfort"),
    ],
)
def test_faults_of_planned_scenarios_are_named_by_field(path: str, value: object, field: str) -> None:
    assert field in {problem.field for problem in faults_of(checked, with_change(PLAN, path, value))}


def test_the_planner_has_its_parameters_once_and_drives_tasks_only() -> None:
    values = dict.fromkeys(NAMES[1:], 1)

    def given(values: dict[str, int], **other: Any) -> dict[str, Any]:
        simulator = PLAN["simulator"] | {"controller": {"kind": "planner", "values": values}}
        searched: dict[str, Any] = {"parameters": {"P1": PLAN["parameters"]["P1"]}, "baseline": None, "constraints": []}
        return PLAN | searched | {"simulator": simulator} | other

    def found(values: dict[str, int], **other: Any) -> set[str]:
        return faults(given(values, **other))

    assert checked(given(values))
    assert found({name: 1 for name in values if name != "P7"}) == {"simulator.controller.values.P7"}
    assert found(values | {"P1": 1}) == {"simulator.controller.values.P1"}
    assert found(values | {"P12": 1}) == {"simulator.controller.values.P12"}
    assert "scenarios.merge.task" in found(values, scenarios={"merge": VALID["scenarios"]["merge"]})
