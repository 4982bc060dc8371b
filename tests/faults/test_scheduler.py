"""The scheduler's state machine for longer: `tests/unit/execution/test_state_machine.py` takes 4,000 steps."""

import pytest
from tests.support.turmoil import run_turmoil

STEPS = 200_000


@pytest.mark.faults
@pytest.mark.timeout(3600)
def test_every_cell_is_answered_once_or_withdrawn_over_many_steps() -> None:
    assert run_turmoil(STEPS) >= STEPS
