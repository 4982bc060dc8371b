"""A database that fails now and then: campaigns end as if it had not, and workers go on."""

import random
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from tests.support.computed import ComputedBackend
from tests.support.databases import migrated
from tests.support.deaths import mortal
from tests.support.effort import tries
from tests.support.runs import everything, get, post_map, submit

from drivecal.domain.errors import UnavailableError

MAP = {
    scenario: {f"P{i}": {"influential": False} for i in range(1, 12) if i not in left}
    for scenario, left in {"S1": (1, 2), "S2": (3, 4)}.items()
}


@pytest.mark.parametrize("seed", range(tries(1, 5)))
def test_hiccups_change_no_result_and_simulate_nothing_twice(tmp_path: Path, seed: int) -> None:
    ended, sent = [], []
    for share in (0.0, 0.1):
        database = migrated(f"sqlite:///{tmp_path / f'{share}.db'}")
        campaign = submit(
            database,
            stored_map=post_map(database, MAP),
            catalogue=["S1", "S2"],
            optimizer={"kind": "genetic", "population": 8, "iterations": 2, "seed": 3},
            reduction={"audit": 0.2, "confirm": 20},
        )
        draw, failures, backend = random.Random(seed), list[bool](), ComputedBackend(seed)

        def fails(draw: random.Random = draw, share: float = share, failures: list[bool] = failures) -> bool:
            failures.append(draw.random() < share)
            return failures[-1]

        working = mortal(database, fails, backend, UnavailableError)
        until_the_end: Any = SimpleNamespace(
            is_set=lambda database=database, campaign=campaign: get(database, campaign).state.ended, wait=lambda _: None
        )
        working.run(until_the_end)
        assert any(failures) == (share > 0)
        ended.append(everything(database, campaign))
        sent.append(Counter(backend.sent))
    assert ended[0] == ended[1]
    assert sent[0] == sent[1]
