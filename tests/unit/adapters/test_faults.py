"""Many faults and many runs of one session, with a simulator in C++."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.support.simulators import compiled, opened

from drivecal.bundles import archives
from drivecal.contracts.work import Batch, Cell, SetupRequest
from drivecal.domain.evaluations import Breakdown
from drivecal.plugins.simulators import SimulatorSession
from drivecal.runtime.bundles import BundleSessions
from drivecal.runtime.cache import BundleCache
from drivecal.runtime.worker import Worker

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
    with opened("process", program, command=["./sim"]) as session:
        yield session


FAULTS = {1: Breakdown.CRASH, 2: Breakdown.HANG, 3: Breakdown.ERROR, 4: Breakdown.ERROR, 5: Breakdown.ERROR}


@pytest.mark.faults
def test_two_hundred_crashes_hangs_and_floods_cost_one_cell_each(program: Path, tmp_path: Path) -> None:
    (program / "problem.yaml").write_text("problem: p\n")
    archive = archives.pack(program)
    request = SetupRequest(
        bundle=archives.content_digest(archive),
        problem="p",
        scenario="S",
        data={},
        simulator={"kind": "process", "command": ["./sim"], "timeout": 5.0, "memory_mb": 1000},
        parameters=("x",),
        integers=(),
        measures=("y",),
        failures=(),
        series=(),
        run_fingerprint="fingerprint",
    )
    works = Worker("w", bundles=BundleSessions(BundleCache(tmp_path / "cache")))
    works.store(request.bundle, archive)
    works.run(Batch(request, (Cell(-1, {"x": 10.0}),)))
    before = descriptors()
    faults = [2 if number % 80 == 0 else (1, 3, 4, 5)[number % 4] for number in range(200)]
    inputs = [x for fault in faults for x in (fault, 10)]
    cells = tuple(Cell(number, {"x": float(x)}) for number, x in enumerate(inputs))
    results = works.run(Batch(request, cells)).results
    assert [result.breakdown for result in results] == [FAULTS.get(x) for x in inputs]
    assert all(result.metrics == {"y": 20.0} for result, x in zip(results, inputs, strict=True) if x == 10)
    assert descriptors() <= before


def test_many_runs_leave_nothing_open(session: SimulatorSession) -> None:
    session.evaluate({"x": 0.0})
    before = descriptors()
    for number in range(1000):
        assert session.evaluate({"x": 10.0 + number}).measures == {"y": 20.0 + 2 * number}
    assert descriptors() <= before


def descriptors() -> int:
    """Number of this process's open descriptors."""
    return len(list(Path(f"/proc/{os.getpid()}/fd").iterdir()))
