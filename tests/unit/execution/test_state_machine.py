import pytest
from tests.support.effort import tries
from tests.support.turmoil import run_turmoil

STEPS = tries(1_500, 200_000)


@pytest.mark.timeout(3600)
def test_every_cell_is_answered_once_or_withdrawn_whatever_happens() -> None:
    assert run_turmoil(STEPS) >= STEPS
