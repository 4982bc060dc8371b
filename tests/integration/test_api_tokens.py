"""Every route refuses who shows no token, over real HTTP: the list is the application's own."""

import json
from collections.abc import Iterator
from contextlib import AbstractContextManager
from functools import cache
from pathlib import Path
from typing import Any

import httpx
import pytest
from tests.support.command import command
from tests.support.server import RunningApi, problem_of, serving

from drivecal.api.app import create_app
from drivecal.configuration.settings import load_settings

WRITE, READ = "writer-0123456789abcdef", "reader-0123456789abcdef"
TOKENS = f"writer write {WRITE}\nreader read {READ}\n"
OPEN = {"/healthz", "/readyz"}
PAGE = "/page/"
OWN = "/api/v1/session"
"""A session belongs to its holder and changes nothing on the server: every role that may read can begin and end one."""
SMALL = {"sensitivity": None, "optimizer": {"population": 10, "iterations": 2}}


@cache
def routes() -> list[tuple[str, str]]:
    """Method and path of everything that the application answers, and of some that it does not."""
    app = create_app(load_settings(database_url="sqlite:///never-made.db", tokens_file=None))
    known = [(method.upper(), path) for path, methods in app.openapi()["paths"].items() for method in methods]
    known += [("GET", str(path)) for path in (getattr(route, "path", None) for route in app.routes) if path is not None]
    unknown = [("GET", "/nothing"), ("POST", "/api/v1/nothing"), ("DELETE", "/api/v1/campaigns"), ("OPTIONS", "/api/v1")]
    assert len(known) > 25
    return [(method, url) for method, url in [*known, *unknown] if url not in OPEN and url != "/" and not url.startswith(PAGE)]


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningApi]:
    folder = tmp_path_factory.mktemp("tokens")
    (folder / "tokens").write_text(TOKENS)
    with serving(f"sqlite:///{folder / 'drivecal.db'}", tokens_file=str(folder / "tokens")) as running:
        yield running


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


@pytest.mark.parametrize("wrong", [None, b"Bearer " + WRITE[:-1].encode()], ids=["missing", "wrong"])
def test_every_route_refuses_who_shows_no_token(api: RunningApi, wrong: bytes | None) -> None:
    headers = {} if wrong is None else {b"Authorization": wrong}
    for method, path in routes():
        content = b"{}" if method == "POST" else None
        response = api.http.request(method, path, headers=headers, content=content)
        assert response.status_code == 401, (method, path)
        assert response.headers["www-authenticate"].startswith("Bearer")
        assert response.headers["content-type"] == "application/problem+json"
        assert response.json()["status"] == 401
        assert WRITE not in response.text


def test_a_token_that_may_only_read_changes_nothing_anywhere(api: RunningApi) -> None:
    for method, path in routes():
        with api.http.stream(method, path, headers=bearer(READ)) as response:
            reads = method in {"GET", "OPTIONS"} or path in {OWN, "/api/v1/results/lookup"}
            assert (response.status_code == 403) == (not reads), (method, path, response.status_code)
            assert response.status_code != 401
            assert not [name for name in response.headers if name.startswith("access-control-")]


def test_the_page_itself_is_open_to_be_read_and_nothing_else(api: RunningApi) -> None:
    """It holds nothing but the program, which asks for a token."""
    assert api.http.get("/").status_code == 200
    assert api.http.get("/page/nothing.js").status_code == 404
    assert api.http.post("/").status_code == 401
    assert api.http.post("/page/nothing.js").status_code == 401


def test_the_command_says_which_token_is_wrong(api: RunningApi, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DRIVECAL_URL", api.url)
    monkeypatch.delenv("DRIVECAL_TOKEN", raising=False)
    told = command("list")
    assert (told.exit_code, "DRIVECAL_TOKEN" in told.stderr) == (4, True)
    monkeypatch.setenv("DRIVECAL_TOKEN", "wrong-0123456789abcdef")
    told = command("list")
    assert told.exit_code == 4
    assert "wrong-0123456789abcdef" not in told.output
    monkeypatch.setenv("DRIVECAL_TOKEN", READ)
    assert command("list").exit_code == 0
    (tmp_path / "campaign.json").write_text(json.dumps(SMALL))
    assert command("submit", "campaign.json", "--dry-run").exit_code == 0
    told = command("submit", "campaign.json")
    assert (told.exit_code, "reader" in told.stderr) == (4, True)
    monkeypatch.setenv("DRIVECAL_TOKEN", WRITE)
    assert command("submit", "campaign.json").exit_code == 0


def test_a_token_is_revoked_without_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "tokens"
    path.write_text(TOKENS)
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}", tokens_file=str(path)) as api:
        assert api.http.get("/api/v1/scenarios", headers=bearer(WRITE)).status_code == 200
        path.write_text(TOKENS.replace(WRITE, "another-0123456789abcdef"))
        assert api.http.get("/api/v1/scenarios", headers=bearer(WRITE)).status_code == 401
        assert api.http.get("/api/v1/scenarios", headers=bearer("another-0123456789abcdef")).status_code == 200
        path.write_text(TOKENS.replace(WRITE, "short"))
        assert api.http.get("/api/v1/scenarios", headers=bearer("another-0123456789abcdef")).status_code == 401
        assert api.http.get("/api/v1/scenarios", headers=bearer(READ)).status_code == 200
        assert str(path) in " ".join(api.http.get("/readyz", headers=bearer(READ)).json()["problems"])
        assert api.http.get("/readyz").json()["problems"] == []


def of_three(folder: Path, bobs: str) -> AbstractContextManager[RunningApi]:
    """A server for alice, who may write, bob with this permission, and root."""
    permissions = {"alice": "write", "bob": bobs, "root": "admin"}
    (folder / "tokens").write_text("\n".join(f"{name} {may} {name}-0123456789abcdef" for name, may in permissions.items()))
    return serving(f"sqlite:///{folder / 'drivecal.db'}", tokens_file=str(folder / "tokens"))


def test_campaigns_are_steered_and_deleted_by_their_owner_and_by_an_admin(tmp_path: Path) -> None:
    with of_three(tmp_path, "author") as api:

        def ask(name: str, path: str, method: str = "POST", body: Any = None) -> httpx.Response:
            headers = {**bearer(f"{name}-0123456789abcdef"), **({"Idempotency-Key": "k1"} if body else {})}
            return api.http.request(method, f"/api/v1/campaigns{path}", headers=headers, json=body)

        campaign = ask("bob", "", body=SMALL).json()
        assert (campaign["owner"], ask("alice", "", body=SMALL).json()["owner"]) == ("bob", "alice")
        assert ask("bob", "", body=SMALL).json()["id"] == campaign["id"]
        own = f"/{campaign['id']}"
        for action in ("pause", "resume", "cancel"):
            assert "bob" in problem_of(ask("alice", f"{own}/{action}"), 403)["detail"]
        assert ask("alice", own, "PATCH", {"name": "mine"}).status_code == 403
        assert ask("bob", f"{own}/pause").status_code == 202
        assert ask("root", f"{own}/cancel").status_code == 202
        assert ask("alice", own, "DELETE").status_code == 403
        assert ask("bob", own, "DELETE").status_code == 204


def test_sets_of_an_outside_optimizer_are_taken_from_the_owner_and_an_admin(tmp_path: Path) -> None:
    with of_three(tmp_path, "write") as api:

        def ask(name: str, path: str, method: str = "POST", body: Any = None) -> int:
            headers = bearer(f"{name}-0123456789abcdef")
            return api.http.request(method, f"/api/v1/campaigns/{own}{path}", headers=headers, json=body).status_code

        document = SMALL | {"optimizer": {"kind": "external"}}
        own = api.http.post("/api/v1/campaigns", headers=bearer("bob-0123456789abcdef"), json=document).json()["id"]
        proposed = {"sets": [{"key": "a", "parameters": {f"P{number}": 0.5 for number in range(1, 12)}}]}
        asked = [("/sets", "POST", proposed), ("/sets/a", "DELETE", None), ("/finish", "POST", None)]
        assert [ask("alice", *each) for each in asked] == [403, 403, 403]
        assert [ask("bob", *each) for each in asked[:2]] == [202, 200]
        assert ask("alice", "/answers", "GET") == 200
        assert ask("root", "/finish") == 202


def test_results_from_elsewhere_are_deleted_by_who_imported_them_and_by_an_admin(tmp_path: Path) -> None:
    row = {"parameters": {f"P{number}": 0.5 for number in range(1, 12)}, "scenario": "S1", "scores": {"comfort": 5.0}}
    given = {"problem": "highway", "source": "car 7", "rows": [row]}
    with of_three(tmp_path, "write") as api:
        for owner, date in (("bob", "2026-11-20"), ("root", "2026-11-21")):
            headers = bearer(f"{owner}-0123456789abcdef")
            api.http.post("/api/v1/results", headers=headers, json=given | {"date": date}).raise_for_status()
        for name, status, deleted in (("alice", 403, None), ("bob", 200, 1), ("root", 200, 1)):
            headers = bearer(f"{name}-0123456789abcdef")
            answer = api.http.delete("/api/v1/results?problem=highway&source=car 7", headers=headers)
            assert (answer.status_code, answer.json().get("deleted")) == (status, deleted)
