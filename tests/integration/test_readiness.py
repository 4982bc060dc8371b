"""Tests of what the API says of itself while something that it needs is missing."""

import pytest
from tests.support.server import problem_of, serving


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
