"""A problem's archive, a request of its runs, and workers that have its files."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivecal.bundles import archives
from drivecal.contracts.work import SetupRequest
from drivecal.runtime.bundles import BundleSessions
from drivecal.runtime.cache import BundleCache
from drivecal.runtime.worker import Worker


@pytest.fixture
def archive(tmp_path: Path) -> bytes:
    folder = tmp_path / "problem"
    folder.mkdir()
    (folder / "problem.yaml").write_text("problem: p\n")
    return archives.pack(folder)


@pytest.fixture
def request_(archive: bytes) -> SetupRequest:
    return SetupRequest(
        bundle=archives.content_digest(archive),
        problem="p",
        scenario="city",
        data={},
        simulator={"kind": "process", "timeout": 10.0},
        parameters=("x",),
        integers=(),
        measures=("a",),
        failures=("collision",),
        series=("v",),
        run_fingerprint="fingerprint",
    )


@pytest.fixture
def sessions(tmp_path: Path, archive: bytes, request_: SetupRequest) -> Callable[..., BundleSessions]:
    """Gives the sessions of a worker that has the problem's files: of this simulator, or of real ones."""

    def opened(simulator: Any = None, **options: Any) -> BundleSessions:
        if simulator is not None:
            options["simulators"] = lambda _: simulator
        result = BundleSessions(BundleCache(tmp_path / "cache"), **options)
        result.store(request_.bundle, archive)
        return result

    return opened


@pytest.fixture
def worker(sessions: Callable[..., BundleSessions]) -> Callable[..., Worker]:
    """Gives a worker with such sessions."""
    return lambda *arguments, **options: Worker("w", bundles=sessions(*arguments, **options))
