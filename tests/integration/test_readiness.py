"""Tests of what the API says of itself while something that it needs is missing."""

from __future__ import annotations

from typing import Any

import pytest
from tests.support.server import problem_of, serving

from drivecal.storage import processes
from drivecal.storage.engine.types import now


def test_readiness_says_what_is_missing(tmp_path_factory: pytest.TempPathFactory) -> None:
    with serving(f"sqlite:///{tmp_path_factory.mktemp('ready') / 'drivecal.db'}") as api:
        assert api.http.get("/healthz").json() == {"status": "alive"}
        response = api.http.get("/readyz")
        assert (response.status_code, response.json()["problems"]) == (
            503,
            ["no dispatcher has started yet; `drivecal serve` starts one, and in a cluster its log says what keeps it"],
        )
        detail: dict[str, Any] = {"workers": [{"id": "worker 1", "node": "here", "pid": 5, "state": "idle", "cells": 3}]}
        with api.database.transaction() as connection:
            processes.heartbeat(connection, "dispatcher", 1, now(), detail)
        assert api.http.get("/readyz").json() == {"ready": True, "problems": []}
        doing = {"scenario": "S1", "since": "2026-01-01T00:00:00Z", "cells_per_second": 30.5}
        detail["workers"].append({"id": "worker 2", "node": "there", "state": "busy", "cells": 7, **doing})
        with api.database.transaction() as connection:
            processes.heartbeat(connection, "dispatcher", 1, now(), detail)
        page = api.http.get("/api/v1/workers").json()
        assert page["items"] == [
            {"id": "worker 1", "node": "here", "state": "idle", "cells": 3} | dict.fromkeys(doing),
            {"id": "worker 2", "node": "there", "state": "busy", "cells": 7, **doing},
        ]
        assert (page["fresh"], page["degraded"]) == (True, None)
        del detail["workers"][1]
        with api.database.transaction() as connection:
            processes.heartbeat(connection, "dispatcher", 1, now(), detail | {"degraded": "Ray does not answer"})
        response = api.http.get("/readyz")
        assert (response.status_code, response.json()) == (200, {"ready": True, "problems": ["Ray does not answer"]})
        detail["workers"][0]["state"] = "starting"
        with api.database.transaction() as connection:
            processes.heartbeat(connection, "dispatcher", 1, now(), detail | {"degraded": "1 of 1 workers do not start"})
        response = api.http.get("/readyz")
        assert (response.status_code, response.json()["problems"]) == (503, ["1 of 1 workers do not start"])


def test_a_database_that_is_gone_is_said_to_be_unavailable(tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("gone")
    with serving(f"sqlite:///{folder / 'drivecal.db'}") as api:
        api.database.dispose()
        for file in folder.iterdir():
            file.unlink()
        folder.rmdir()
        response = api.http.get("/api/v1/campaigns")
        assert problem_of(response, 503)
        assert int(response.headers["retry-after"]) > 0
        assert api.http.get("/readyz").status_code == 503
        assert api.http.get("/healthz").status_code == 200
        folder.mkdir()
