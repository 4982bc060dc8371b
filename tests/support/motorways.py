"""Bundles of kind `highway` for tests: the examples' motorway, scenarios on it, and one ACC as Python (also compiled), program and FMU."""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.support.fmus import archive, shared_library
from tests.support.simulators import compiled, opened

from drivecal.bundles.highway import HighwaySimulator
from drivecal.bundles.highway_catalogue import MEASURES, SERIES
from drivecal.plugins.simulators import Declared, SimulatorSession

NETWORK = Path(__file__).parents[2] / "deploy" / "examples" / "problems" / "acc-highway" / "road.net.xml"
ROUTE = ["e0", "e1", "e2"]
"""A straight road up to s = 600, a left curve with a radius of 1,000 m up to 1,400, and a straight road up to 3,000."""
EVERYTHING = Declared("trial", tuple(MEASURES), series=tuple(SERIES))
PARAMETERS = {"v0": 30.0, "T": 1.5, "k": 0.08, "c": 0.6}

PYTHON = '''
def control(observation, parameters):
    """The law of the others, in the same order of operations."""
    speed, gap, leader = observation["speed"], observation["gap"], observation["leader_speed"]
    cruise = 0.4 * (parameters["v0"] - speed)
    follow = parameters["k"] * (gap - (4.0 + parameters["T"] * speed)) + parameters["c"] * (leader - speed)
    if gap < 200.0 and follow < cruise:
        cruise = follow
    return cruise
'''
COMPILED = """
from numba import njit


@njit
def law(speed, gap, leader, v0, T, k, c):
    cruise = 0.4 * (v0 - speed)
    follow = k * (gap - (4.0 + T * speed)) + c * (leader - speed)
    if gap < 200.0 and follow < cruise:
        cruise = follow
    return cruise


def control(o, p):
    return law(o["speed"], o["gap"], o["leader_speed"], p["v0"], p["T"], p["k"], p["c"])
"""
LAW = """
static double law(double speed, double gap, double leader, double v0, double T, double k, double c) {
    double cruise = 0.4 * (v0 - speed);
    double follow = k * (gap - (4.0 + T * speed)) + c * (leader - speed);
    return gap < 200.0 && follow < cruise ? follow : cruise;
}
"""
PROGRAM = (
    """
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
"""
    + LAW
    + r"""
static char line[65536];
static double number(const char *name) {
    char key[64];
    snprintf(key, sizeof key, "\"%s\":", name);
    return atof(strstr(line, key) + strlen(key));
}
int main(void) {
    double p[4] = {0};
    if (!fgets(line, sizeof line, stdin)) return 1; /* the greeting */
    puts("{\"ready\": true}"); fflush(stdout);
    while (fgets(line, sizeof line, stdin)) {
        if (strstr(line, "\"run\":")) {
            p[0] = number("v0"); p[1] = number("T"); p[2] = number("k"); p[3] = number("c");
            puts("{\"ready\": true}");
        } else {
            printf("{\"acceleration\": %.17g}\n", law(number("speed"), number("gap"), number("leader_speed"), p[0], p[1], p[2], p[3]));
        }
        fflush(stdout);
    }
    return 0;
}
"""
)
FMU = (
    """
#include <stddef.h>
#include "fmi2Functions.h"
static double v[8];
"""
    + LAW
    + r"""
const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return "2.0"; }
static fmi2Status defaults(void) { for (int i = 0; i < 8; i++) v[i] = 0; return fmi2OK; }
fmi2Component fmi2Instantiate(fmi2String i, fmi2Type t, fmi2String g, fmi2String r, const fmi2CallbackFunctions *f, fmi2Boolean s,
    fmi2Boolean l) { defaults(); return v; }
void fmi2FreeInstance(fmi2Component c) { }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean d, fmi2Real t, fmi2Real s, fmi2Boolean e, fmi2Real z) { return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { return defaults(); }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real x[]) {
    for (size_t i = 0; i < n; i++) x[i] = v[r[i]]; return fmi2OK; }
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real x[]) {
    for (size_t i = 0; i < n; i++) v[r[i]] = x[i]; return fmi2OK; }
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean f) {
    v[7] = law(v[0], v[1], v[2], v[3], v[4], v[5], v[6]); return v[3] == 13 ? fmi2Error : fmi2OK; }
"""
)
VARIABLES = ("u1", "u2", "u3", "v0", "T", "k", "c", "y")
DESCRIPTION = (
    """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="acc" guid="{acc}">
  <CoSimulation modelIdentifier="acc" canHandleVariableCommunicationStepSize="true"/>
  <ModelVariables>
"""
    + "\n".join(
        f'    <ScalarVariable name="{name}" valueReference="{index}" causality="'
        f'{"input" if name[0] == "u" else "output" if name == "y" else "parameter"}"'
        f"{'' if name in ('u1', 'u2', 'u3', 'y') else ' variability=' + chr(34) + 'tunable' + chr(34)}>"
        f"<Real{'' if name == 'y' else ' start=' + chr(34) + '0' + chr(34)}/></ScalarVariable>"
        for index, name in enumerate(VARIABLES)
    )
    + """
  </ModelVariables>
  <ModelStructure/>
</fmiModelDescription>
"""
)
CONTROLLERS: dict[str, dict[str, Any]] = {
    "python": {"kind": "python", "file": "acc.py", "output": ["acceleration"]},
    "numba": {"kind": "python", "file": "compiled.py", "output": ["acceleration"]},
    "process": {
        "kind": "process",
        "command": ["./acc"],
        "signals": ["speed", "gap", "leader_speed"],
        "output": ["acceleration"],
    },
    "fmu": {
        "kind": "fmu",
        "file": "acc.fmu",
        "signals": {"speed": "u1", "gap": "u2", "leader_speed": "u3", "acceleration": "y"},
        "output": ["acceleration"],
    },
}
"""The same law in all kinds."""


def motorway(folder: Path, code: str = PYTHON, network: Path = NETWORK) -> Path:
    """Writes a bundle with a controller in Python, and the ACC compiled by numba."""
    folder.mkdir(exist_ok=True)
    shutil.copy(network, folder / "road.net.xml")
    (folder / "acc.py").write_text(code)
    (folder / "compiled.py").write_text(COMPILED)
    return folder


def compile_program(folder: Path) -> None:
    """Adds the ACC as a program."""
    (folder / "acc.c").write_text(PROGRAM)
    compiled("cc", folder / "acc.c", folder / "acc", "-ffp-contract=off", "-lm")


def compile_fmu(folder: Path, source: str = FMU) -> None:
    """Adds the ACC as an FMU."""
    library = shared_library(folder, "fmu", source)
    archive(folder / "acc.fmu", DESCRIPTION, {"binaries/linux64/acc.so": library})


def drive(
    traffic: Sequence[Mapping[str, Any]] = (), duration: float = 20.0, *, ego: Mapping[str, Any] | None = None, **other: Any
) -> dict[str, Any]:
    """The data of a scenario; the ego vehicle starts on the right lane at s = 100 with 30 m/s."""
    return {
        "network": "road.net.xml",
        "route": ROUTE,
        "duration": duration,
        "ego": {"lane": 0, "s": 100, "speed": 30} | dict(ego or {}),
        "traffic": [dict(vehicle) for vehicle in traffic],
    } | other


@contextmanager
def driven(
    folder: Path,
    data: Mapping[str, Any],
    controller: Mapping[str, Any] | None = None,
    declared: Declared = EVERYTHING,
    **section: Any,
) -> Iterator[SimulatorSession]:
    """Opens a session of a scenario, with the section as the coordinator sends it: all settings, those without a value included."""
    given = {"kind": "highway", "controller": dict(controller or CONTROLLERS["python"]), "timeout": 60.0} | section
    sent = HighwaySimulator.model_validate(given).model_dump(mode="json", exclude={"kind"})
    with opened("highway", folder, declared, data, **sent) as session:
        yield session
