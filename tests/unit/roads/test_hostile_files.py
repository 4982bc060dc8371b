"""Damaged files, made for tests and of public projects: whatever is in them, reading ends soon, with a corridor or an InvalidInputError.

`DRIVECAL_LONG` in the environment makes it thorough.
"""

import resource
import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest
from tests.support import effort
from tests.support.effort import tries
from tests.support.mutations import mutated, nudged, outcome
from tests.support.networks import REAL, crossing, entrance, generated, real
from tests.support.opendrive_files import FILES

from drivecal.domain.errors import InvalidInputError
from drivecal.roads.conversion import converted
from drivecal.roads.corridor import corridor
from drivecal.roads.network import read_network

MUTATIONS = tries(100, 10_000)
SUBJECTS: dict[str, tuple[Callable[[], bytes], tuple[str, ...]]] = {
    "entrance": (entrance, ("before", "beside", "after")),
    "ramp": (lambda: entrance("--no-internal-links"), ("ramp", "beside", "after")),
    "crossing": (crossing, ("west", "east")),
    "grid": (
        lambda: generated("--grid", "--grid.x-number", "4", "--grid.y-number", "1", "--grid.length", "300"),
        ("A0B0", "B0C0", "C0D0"),
    ),
    **{f"real {name}": (real(name).read_bytes, REAL[name][1]) for name in ("highway", "merge")},
}


@pytest.mark.parametrize("subject", SUBJECTS)
def test_damaged_networks_give_corridors_or_refusals(subject: str) -> None:
    make, route = SUBJECTS[subject]
    content, chance = make(), effort.chance(subject)
    results = []
    for _ in range(MUTATIONS // len(SUBJECTS)):
        damaged = mutated(content, chance)

        def attempt(damaged: bytes = damaged) -> None:
            road = corridor(read_network(damaged, "road.net.xml"), route, "road.net.xml")
            assert np.all(np.isfinite(road.line))
            assert not np.any(np.isinf(road.centres) | np.isinf(road.widths) | np.isinf(road.limits))
            for number in range(len(road.tracks)):
                assert np.array_equal(np.isnan(road.centres[:, number]), np.isnan(road.widths[:, number]))

        results.append(outcome(attempt))
    assert not all(results)
    if subject != "crossing":
        assert any(results)  # many faults are harmless


def used() -> tuple[float, float]:
    """Processor time (s) so far, and the largest memory (MB) of a finished child."""
    own, children = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime, children.ru_maxrss / 1024


@pytest.mark.slow
def test_mutated_roads_are_converted_or_refused_within_a_minute_and_two_gigabytes() -> None:
    files, chance, count = [make() for make in FILES.values()], effort.chance("roads"), tries(100, 1000)
    converted_files = 0
    for number in range(count):
        damage = nudged if number % 3 else mutated
        damaged, (begin, _) = damage(files[number % len(files)], chance), used()
        try:
            converted(damaged, "road.xodr")
            converted_files += 1
        except InvalidInputError as error:
            assert all(problem.message and problem.remedy for problem in error.problems)  # noqa: PT017  # both outcomes are right
        seconds, megabytes = used()
        assert seconds - begin < 62.0
        assert megabytes < 2048
    assert 0 < converted_files < count


def unconnected(edges: int, lanes: int, length: float = 20.0) -> bytes:
    """A straight road, of whose edges only the right lanes are connected."""
    parts = ['<net version="1.20">']
    for number in range(edges):
        places = np.linspace(number * length, (number + 1) * length, 41)
        shapes = [" ".join(f"{x},{3.2 * lane}" for x in places) for lane in range(lanes)]
        parts.append(f'<edge id="e{number}" from="n{number}" to="n{number + 1}">')
        parts += [
            f'<lane id="e{number}_{lane}" index="{lane}" speed="30" length="{length}" shape="{shape}"/>'
            for lane, shape in enumerate(shapes)
        ]
        parts.append("</edge>")
    parts += [f'<junction id="n{number}" type="priority" incLanes=""/>' for number in range(edges + 1)]
    parts += [
        f'<connection from="e{number}" to="e{number + 1}" fromLane="0" toLane="0" dir="s" state="M"/>'
        for number in range(edges - 1)
    ]
    return "".join([*parts, "</net>"]).encode()


@pytest.mark.parametrize(("edges", "lanes", "length"), [(40, 32, 20.0), (10, 4, 9_000.0)], ids=["many lanes", "long ways"])
def test_routes_with_too_many_tracks_are_refused_before_measuring(edges: int, lanes: int, length: float) -> None:
    network = read_network(unconnected(edges, lanes, length), "road.net.xml")
    tracemalloc.start()
    try:
        with pytest.raises(InvalidInputError) as error:
            corridor(network, [f"e{number}" for number in range(edges)], "road.net.xml")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert [problem.field for problem in error.value.problems] == ["route"]
    assert all(problem.remedy for problem in error.value.problems)
    assert peak < 100e6
