"""Many faults and many runs of one session, with a simulator in C++."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.support.effort import tries
from tests.support.simulators import compiled, opened

from drivecal.domain.evaluations import Breakdown
from drivecal.plugins.simulators import NoMeasuresError, SimulatorSession

SOURCE = r"""
#include <cstdlib>
#include <iostream>
#include <string>
#include <unistd.h>

static double number(const std::string& line, const std::string& name) {
    return std::stod(line.substr(line.find("\"" + name + "\": ") + name.size() + 4));
}

int main() {
    std::string line;
    while (std::getline(std::cin, line) && line.find("\"quit\"") == std::string::npos) {
        if (line.find("\"drivecal\"") != std::string::npos) {
            std::cout << "{\"ready\": true}" << std::endl;
            continue;
        }
        const double x = number(line, "x");
        if (x == 1) std::abort();
        if (x == 2) for (;;) pause();
        if (x == 3) for (;;) std::cout << "flood" << '\n';
        if (x == 4) for (;;) std::cout << "flood";
        if (x == 5) std::cout << "{\"id\": 0}" << std::endl;
        std::cout << "{\"id\": " << static_cast<long>(number(line, "id")) << ", \"measures\": {\"y\": " << 2 * x << "}}" << std::endl;
    }
}
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("program")
    (folder / "sim.cpp").write_text(SOURCE)
    compiled("g++", folder / "sim.cpp", folder / "sim")
    return folder


@pytest.fixture
def session(program: Path) -> Iterator[SimulatorSession]:
    with opened("process", program, command=["./sim"], timeout=1.0) as session:
        yield session


def test_many_faults_cost_one_run_each(session: SimulatorSession) -> None:
    faults = {1: Breakdown.CRASH, 2: Breakdown.HANG, 3: Breakdown.ERROR, 4: Breakdown.ERROR, 5: Breakdown.ERROR}
    before = descriptors()
    for number in range(tries(60, 200)):
        fault = 2 if number % 25 == 0 else (1, 3, 4, 5)[number % 4]
        with pytest.raises(NoMeasuresError) as error:
            session.evaluate({"x": float(fault)})
        assert error.value.breakdown is faults[fault], error.value.detail
        assert session.evaluate({"x": 10.0}).measures == {"y": 20.0}
    assert descriptors() == before


def test_many_runs_leave_nothing_open(session: SimulatorSession) -> None:
    session.evaluate({"x": 0.0})
    before = descriptors()
    for number in range(1000):
        assert session.evaluate({"x": 10.0 + number}).measures == {"y": 20.0 + 2 * number}
    assert descriptors() == before


def descriptors() -> int:
    """Number of this process's open descriptors."""
    return len(list(Path(f"/proc/{os.getpid()}/fd").iterdir()))
