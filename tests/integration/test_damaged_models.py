"""A damaged file of a learned model fails only requests that use the model. The message names file and cause."""

from pathlib import Path
from typing import Any

import pytest
from tests.support.runs import SMALL
from tests.support.server import serving
from tests.support.values import MIDDLE

from drivecal.highway.comfort import learned, regressions
from drivecal.highway.comfort.learned import LEARNED
from drivecal.highway.vehicle import hybrid, residual
from drivecal.highway.vehicle.hybrid import HYBRID

CHOICES: dict[str, dict[str, Any]] = {"hybrid.npz": {"vehicle": {"model": "hybrid"}}, "learned.npz": {"evaluator": "learned"}}


def damage(folder: Path, patch: pytest.MonkeyPatch) -> None:
    """Truncates both files, before the process has read them."""
    copies = [folder / residual.FILE.name, folder / regressions.FILE.name]
    for file, copy in zip((residual.FILE, regressions.FILE), copies, strict=True):
        copy.write_bytes(file.read_bytes()[:-40])
    patch.setattr(hybrid, "shipped", lambda: residual.read(copies[0]))
    patch.setattr(learned, "shipped", lambda: regressions.read(copies[1]))
    for plugin in (HYBRID, LEARNED):
        patch.delitem(vars(plugin), "version", raising=False)


def test_what_needs_a_damaged_file_is_refused_by_its_name_and_nothing_is_stored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    damage(tmp_path, monkeypatch)
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}") as api:
        for name, choice in CHOICES.items():
            small = SMALL | choice
            for path, body in (
                ("campaigns", small),
                ("campaigns?validate_only=true", small),
                ("evaluations", {"parameters": MIDDLE} | choice),
            ):
                answer = api.http.post(f"/api/v1/{path}", json=body)
                assert answer.status_code == 503, answer.text
                assert name in answer.json()["detail"]
        assert api.http.get("/api/v1/campaigns").json()["items"] == []
        assert api.http.post("/api/v1/campaigns?validate_only=true", json=SMALL).status_code == 200
