"""A lane keeper in C++."""

from pathlib import Path
from typing import Any

from tests.support.simulators import compiled

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
LANE_KEEPER: dict[str, Any] = {
    "kind": "process",
    "command": ["./keeper"],
    "signals": ["speed", "lane_offset", "heading_error", "road_curvature", "curvature_1s"],
    "output": ["curvature"],
}


def write_lane_keeper(folder: Path) -> None:
    """Adds the lane keeper to a bundle."""
    (folder / "keeper.cpp").write_text(KEEPER)
    compiled("c++", folder / "keeper.cpp", folder / "keeper", "-ffp-contract=off")
