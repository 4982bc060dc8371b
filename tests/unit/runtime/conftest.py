"""A problem's archive and a request of its runs."""

from pathlib import Path

import pytest

from drivecal.bundles import archives
from drivecal.contracts.work import SetupRequest


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
        units={"x": "m/s"},
    )
