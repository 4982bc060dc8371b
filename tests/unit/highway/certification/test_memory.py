"""Memory limit of a worker's certificates."""

from __future__ import annotations

import pytest

from drivecal.highway.certification import memory
from drivecal.highway.certification.memory import Memory


@pytest.mark.parametrize(
    ("gigabytes", "cpus", "megabytes"),
    [(24, 2, 1024), (16, 16, 256), (1, 64, 4), (1, 1000, 1)],
    ids=["laptop", "node", "small", "tiny"],
)
def test_the_default_limit_follows_the_memory_of_the_machine(
    gigabytes: int, cpus: int, megabytes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "memory_bytes", lambda: gigabytes * 2**30)
    monkeypatch.setattr(memory, "cpus", lambda: cpus)
    assert Memory().limit == megabytes * 2**20
    assert Memory(7).limit == 7 * 2**20
