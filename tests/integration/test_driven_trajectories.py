"""Controllers that give trajectories: a user's in Python and as a program."""

from pathlib import Path

import pytest
from tests.support.motorways import PARAMETERS, drive, driven, motorway
from tests.support.simulators import compiled, lost

from drivecal.domain.evaluations import Breakdown

pytestmark = pytest.mark.slow
CODE = """
def control(o, p):
    speed, a = o["speed"], 0.4 * (p["v0"] - o["speed"])
    if o["gap"] < 200.0:
        a = min(a, p["k"] * (o["gap"] - (4.0 + p["T"] * speed)) + p["c"] * (o["leader_speed"] - speed))
    a = max(-6.0, min(2.0, a))
    points = []
    for i in range(11):
        t = 0.25 * i
        moving = min(t, speed / -a) if a < 0.0 else t
        points.append([t, o["position"] + speed * moving + 0.5 * a * moving * moving, o["lane_offset"] * max(0.0, 1.0 - 0.5 * t)])
    return points
"""
PROGRAM = r"""
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
static char line[65536];
static double number(const char *name) {
    char key[64];
    snprintf(key, sizeof key, "\"%s\":", name);
    return atof(strstr(line, key) + strlen(key));
}
int main(void) {
    fgets(line, sizeof line, stdin); puts("{\"ready\": true}"); fflush(stdout);
    while (fgets(line, sizeof line, stdin)) {
        if (strstr(line, "\"run\":")) {
            puts("{\"ready\": true}");
        } else {
            printf("{\"trajectory\": [");
            for (int i = 0; i < 11; i++) {
                double t = 0.25 * i, rest = 1.0 - 0.5 * t;
                printf("%s[%.17g, %.17g, %.17g]", i ? ", " : "", t, number("position") + number("speed") * t,
                       number("lane_offset") * (rest > 0.0 ? rest : 0.0));
            }
            puts("]}");
        }
        fflush(stdout);
    }
    return 0;
}
"""
STEADY = """
def control(o, p):
    return [[0.25 * i, o["position"] + o["speed"] * 0.25 * i, o["lane_offset"] * max(0.0, 1.0 - 0.5 * 0.25 * i)] for i in range(11)]
"""
CONTROLLER = {"kind": "python", "file": "acc.py", "output": ["trajectory"], "period": 0.2}
BRAKING = {"id": "leader", "s": 160, "speed": 30, "actions": [{"do": "brake", "time": 4, "speed": 12, "rate": 3}]}


def test_a_trajectory_follows_a_braking_leader(tmp_path: Path) -> None:
    with driven(motorway(tmp_path / "b", CODE), drive([BRAKING], 30.0), CONTROLLER) as session:
        outcome = session.evaluate(PARAMETERS, series=True)
    assert outcome.failure is None
    assert outcome.series["speed_mps"][-1] == pytest.approx(12, abs=0.4)
    assert outcome.series["gap_m"][-1] == pytest.approx(4 + 1.5 * 12, abs=2)
    assert outcome.measures["max_lane_offset_m"] < 0.1


def test_a_trajectory_holds_its_lane_on_a_curve_as_a_program_does(tmp_path: Path) -> None:
    folder = motorway(tmp_path / "b", STEADY)
    (folder / "steady.c").write_text(PROGRAM)
    compiled("cc", folder / "steady.c", folder / "steady", "-ffp-contract=off", "-lm")
    program = {
        "kind": "process", "command": ["./steady"], "output": ["trajectory"], "period": 0.2,
        "signals": ["speed", "position", "lane_offset"],
    }  # fmt: skip
    measures = []
    for controller in (CONTROLLER, program):
        with driven(folder, drive(duration=30.0, ego={"s": 400}), controller) as session:
            measures += [session.evaluate(PARAMETERS).measures for _ in range(2)]
    assert measures[0] == measures[1] == measures[2] == measures[3]
    assert measures[0]["max_lane_offset_m"] < 0.15
    assert measures[0]["distance_m"] == pytest.approx(900, abs=3)


@pytest.mark.parametrize(
    "code", ["return []", "return [[0, 1, 0], [0.1, 2, 0]]", "return 3.0", "return {'trajectory': [[0, 1]]}"]
)
def test_a_faulty_trajectory_costs_its_cell(tmp_path: Path, code: str) -> None:
    folder = motorway(tmp_path / "b", f"def control(o, p):\n    {code}\n")
    with driven(folder, drive(), CONTROLLER) as session:
        assert "trajectory" in lost(session, PARAMETERS, Breakdown.ERROR)
