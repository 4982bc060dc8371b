"""One vehicle of a user's, a kinematic bicycle with lags, as a class and an FMU; and a lane keeper in C++."""

from pathlib import Path
from typing import Any

from fmpy.fmi2 import FMU2Slave
from tests.support.fmus import HEADERS, archive
from tests.support.motorways import FMU as CONTROLLER_FMU
from tests.support.motorways import LAW as CONTROLLER_LAW
from tests.support.simulators import compiled

CLASS = '''
import math

class Vehicle:
    """The law of the other two, in the same order of operations."""

    def __init__(self, parameters, scenario, speed):
        self.x = self.y = self.heading = self.angle = self.a = 0.0
        self.speed = speed

    def step(self, steering, acceleration, dt):
        self.angle = self.angle + 0.1 * (steering - self.angle)
        self.a = self.a + 0.05 * (acceleration - self.a)
        self.speed = max(self.speed + 0.01 * self.a, 0.0)
        self.heading = self.heading + 0.01 * (self.speed * (self.angle / 2.8))
        self.x = self.x + 0.01 * (self.speed * math.cos(self.heading))
        self.y = self.y + 0.01 * (self.speed * math.sin(self.heading))
        return self.x, self.y, self.heading, self.speed
'''
LAW = """
static void law(double *v, double steering, double acceleration) { /* x, y, heading, speed, angle, a */
    v[4] = v[4] + 0.1 * (steering - v[4]);
    v[5] = v[5] + 0.05 * (acceleration - v[5]);
    v[3] = v[3] + 0.01 * v[5];
    if (v[3] < 0.0) v[3] = 0.0;
    v[2] = v[2] + 0.01 * (v[3] * (v[4] / 2.8));
    v[0] = v[0] + 0.01 * (v[3] * cos(v[2]));
    v[1] = v[1] + 0.01 * (v[3] * sin(v[2]));
}
"""
KEEPER = r"""
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
static char line[65536];
static double number(const char *name, double otherwise) {
    const std::string key = std::string("\"") + name + "\":";
    const char *given = std::strstr(line, key.c_str());
    return given ? std::atof(given + key.size()) : otherwise;
}
int main() {
    double gain = 0.5;
    std::fgets(line, sizeof line, stdin);
    std::puts("{\"ready\": true}"); std::fflush(stdout);
    while (std::fgets(line, sizeof line, stdin)) {
        if (std::strstr(line, "\"run\":")) { // the line of a run: the parameter `gain`, if there is one
            gain = number("gain", 0.5);
            std::puts("{\"ready\": true}");
        } else {
            const double speed = std::fmax(number("speed", 0.0), 5.0);
            const double curvature = 0.5 * (number("road_curvature", 0.0) + number("curvature_1s", 0.0))
                - gain * number("lane_offset", 0.0) / (speed * speed) - 1.2 * number("heading_error", 0.0) / speed;
            std::printf("{\"curvature\": %.17g}\n", curvature);
        }
        std::fflush(stdout);
    }
}
"""
VARIABLES = ("x", "y", "heading", "speed", "angle", "a", "u1", "u2", "v0")
DESCRIPTION = (
    '<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription fmiVersion="2.0" modelName="car" guid="{car}">\n'
    '  <CoSimulation modelIdentifier="car" canHandleVariableCommunicationStepSize="true"/>\n  <ModelVariables>\n'
    + "\n".join(
        f'    <ScalarVariable name="{name}" valueReference="{index}" causality="'
        + ("input" if name[0] == "u" else "parameter" if name == "v0" else "output")
        + f'"{" variability=" + chr(34) + "tunable" + chr(34) if name == "v0" else ""}>'
        + f"<Real{' start=' + chr(34) + '0' + chr(34) if name in ('u1', 'u2', 'v0') else ''}/></ScalarVariable>"
        for index, name in enumerate(VARIABLES)
    )
    + "\n  </ModelVariables>\n  <ModelStructure/>\n</fmiModelDescription>\n"
)
VEHICLES: dict[str, dict[str, Any]] = {
    "python": {"kind": "python", "file": "car.py"},
    "fmu": {
        "kind": "fmu",
        "file": "car.fmu",
        "signals": {
            "steering": "u1", "acceleration": "u2", "start_speed": "v0", "x": "x", "y": "y", "heading": "heading", "speed": "speed",
        },
    },
}  # fmt: skip
"""The same vehicle in all kinds."""
LANE_KEEPER: dict[str, Any] = {
    "kind": "process",
    "command": ["./keeper"],
    "signals": ["speed", "lane_offset", "heading_error", "road_curvature", "curvature_1s"],
    "output": ["curvature"],
}


def write_vehicles(folder: Path) -> None:
    """Adds the vehicle in all kinds to a bundle, and the lane keeper."""
    (folder / "car.py").write_text(CLASS)
    (folder / "keeper.cpp").write_text(KEEPER)
    compiled("c++", folder / "keeper.cpp", folder / "keeper", "-ffp-contract=off")
    text = "#include <math.h>\n" + CONTROLLER_FMU.replace(CONTROLLER_LAW, LAW).replace("v[8]", "v[16]").replace(
        "i < 8", "i < 16"
    )
    text = text[: text.index("fmi2Status fmi2DoStep")] + (
        "fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean f) {\n"
        "    if (t == 0) v[3] = v[8];\n    law(v, v[6], v[7]); return fmi2OK; }\n"
    )
    (folder / "car_fmu.c").write_text(text)
    names = [name for name in dir(FMU2Slave) if name.startswith("fmi2") and f" {name}(" not in text and f"*{name}(" not in text]
    (folder / "car_rest.c").write_text("".join(f"int {name}(void) {{ return 3; }}\n" for name in names))
    options = (str(folder / "car_rest.c"), "-shared", "-fPIC", "-ffp-contract=off", f"-I{HEADERS}", "-Wl,--no-as-needed", "-lm")
    library = compiled("cc", folder / "car_fmu.c", folder / "car.so", *options)
    archive(folder / "car.fmu", DESCRIPTION, {"binaries/linux64/car.so": library})
