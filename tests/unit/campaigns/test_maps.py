"""Influence maps of analyses hold where their runs and ratings do."""

from datetime import UTC, datetime
from typing import Any

import pytest
import yaml
from tests.support.values import faults_of
from tests.unit.campaigns.test_bundle_bench import EXAMPLE, bundle, resolved

from drivecal.api.results.document import is_same_for_a_map
from drivecal.bundles.installed import Bundle
from drivecal.campaigns.resolve.maps import basis_of, check_basis, is_outdated
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.resolve.spaces import space_to_document
from drivecal.storage.references.influence_maps import StoredInfluenceMap


def stored(problem: CalibrationProblem, **changes: Any) -> StoredInfluenceMap:
    basis = basis_of(problem) | changes
    space = space_to_document(problem.space.searched)
    return StoredInfluenceMap(
        sequence=1, id="m", name="m", source="c", driving_function=problem.bench.function, parameters=space, scenarios={}, basis=basis,
        created_at=datetime.now(UTC),
    )  # fmt: skip


def does_hold(made: StoredInfluenceMap, problem: CalibrationProblem) -> bool:
    if is_outdated(made, problem):
        assert {fault.field for fault in faults_of(check_basis, made, problem)} == {"sensitivity.map"}
        return False
    check_basis(made, problem)
    return True


def with_score(files: str = "f1", **changes: Any) -> Bundle:
    scores = yaml.safe_load(EXAMPLE.read_text())["scores"]
    scores["discomfort"] |= {"failed": 1000} | changes
    return bundle("d2", files, scores=scores)


@pytest.mark.parametrize(
    ("changed", "holds"),
    [
        (with_score(), True),
        (with_score(unit="EUR"), True),
        (with_score(tolerance=7), False),
        (with_score(range=[0, 50]), False),
        (with_score(formula="braking_s"), False),
        (with_score(files="f2"), False),
    ],
)
def test_a_map_of_other_runs_ratings_or_measures_does_not_hold(changed: Bundle, *, holds: bool) -> None:
    assert does_hold(stored(resolved(with_score())), resolved(changed)) == holds


FIRST, SECOND = "jerk >= 2*deceleration", "trigger_ttc >= 0.1*confirmations"


@pytest.mark.parametrize(
    ("made_under", "searched_under", "holds"),
    [
        ([FIRST], [FIRST, SECOND], True),
        ([FIRST, SECOND], [SECOND, FIRST], True),
        ([FIRST, SECOND], [FIRST], False),
        ([FIRST], [], False),
    ],
)
def test_a_map_does_not_hold_for_forbidden_sets(made_under: list[str], searched_under: list[str], *, holds: bool) -> None:
    made, problem = stored(resolved(bundle(constraints=made_under))), resolved(bundle(constraints=searched_under))
    assert does_hold(made, problem) == holds


def test_a_validation_is_about_maps_of_its_own_scale() -> None:
    first, other = resolved(with_score()).resolution(), resolved(with_score(tolerance=7)).resolution()
    assert is_same_for_a_map(first, dict(first))
    assert not is_same_for_a_map(first, other)
