from tests.support.turmoil import run_turmoil

STEPS = 4_000


def test_every_cell_is_answered_once_or_withdrawn_whatever_happens() -> None:
    assert run_turmoil(STEPS) >= STEPS
