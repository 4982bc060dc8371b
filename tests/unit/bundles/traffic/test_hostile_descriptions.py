"""Damaged route and OpenSCENARIO files: whatever is in them, reading ends soon, with a scenario or a refusal that names file and cause."""

import resource
import time
from collections.abc import Callable
from functools import partial

import pytest
from tests.support import effort
from tests.support.effort import tries
from tests.support.mutations import mutated, nudged, outcome
from tests.support.scenario_files import FILES, ROUTES, STEP, maps, of_file, refused, with_routes

from drivecal.bundles.highway_checks import scenario_problems
from drivecal.bundles.traffic.description import Description

MUTATIONS = tries(50, 2000)
SUBJECTS: dict[str, tuple[bytes, Callable[[bytes], Description]]] = {
    "routes": (ROUTES, with_routes),
    **{name: (make(), of_file) for name, make in FILES.items()},
}


@pytest.mark.parametrize("subject", SUBJECTS)
def test_damaged_files_give_a_scenario_or_a_named_refusal(subject: str) -> None:
    content, described = SUBJECTS[subject]
    chance = effort.chance(subject)
    maps()
    results = []
    for _ in range(MUTATIONS):
        damaged = mutated(content, chance)

        def attempt(damaged: bytes = damaged) -> None:
            description = described(damaged)
            for problem in scenario_problems("scenarios.x", description.scenario, STEP, is_whole=True):
                assert problem.field
                assert problem.message

        results.append(outcome(attempt))
    assert any(results)
    assert not all(results)


@pytest.mark.parametrize("count", [50, pytest.param(1000, marks=pytest.mark.slow)])
def test_mutated_scenarios_are_read_or_refused_within_a_minute_and_two_gigabytes(count: int) -> None:
    subjects, chance = list(SUBJECTS.values()), effort.chance(f"scenarios {count}")
    maps()
    results = []
    for number in range(count):
        content, described = subjects[number % len(subjects)]
        damaged, begin = (nudged if number % 3 else mutated)(content, chance), time.process_time()
        results.append(outcome(partial(described, damaged)))
        assert time.process_time() - begin < 60.0
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < 2 << 20, "kilobytes"
    assert 0 < sum(results) < count


@pytest.mark.slow
def test_a_file_with_too_many_elements_or_parameters_of_parameters_is_refused() -> None:
    content = FILES["cut_in"]()
    assert "elements" in refused(content.replace(b"<Entities>", b"<a/>" * 200_001 + b"<Entities>"))
    chain = "".join(f'<ParameterDeclaration name="p{n}" parameterType="double" value="${{$p{n + 1}}}"/>' for n in range(5))
    assert "no parameter p1" in refused(
        content.replace(b"</ParameterDeclarations>", chain.encode() + b"</ParameterDeclarations>")
    )


def test_document_types_are_refused() -> None:
    content = FILES["cut_in"]().replace(b"<OpenSCENARIO>", b'<!DOCTYPE x [<!ENTITY a "b">]><OpenSCENARIO>')
    assert "document type" in refused(content)
