"""Pushing, refusing, listing and showing problems: the whole application, without a server."""

import io
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient
from httpx import Response
from tests.support.databases import migrated
from tests.support.values import present
from tests.support.zips import zipped

from drivecal.api.app import create_app
from drivecal.api.dependencies import OPEN_ARCHIVES, Limits
from drivecal.configuration.pushing import HEADER, Pushing, read_secret, sign
from drivecal.configuration.settings import load_settings

PROBLEMS = "/api/v1/problems"
TOKENS = {"author": "author-0123456789abcdef", "writer": "writer-0123456789abcdef", "reader": "reader-0123456789abcdef"}
ROLES = {"author": "author", "writer": "write", "reader": "read"}
ZIP = {"Content-Type": "application/zip"}
MANIFEST = """
problem: {name}
description: as small as can be
parameters:
  x: {{lower: 0, upper: 1, step: 0.1, unit: m}}
  mode: {{choices: [eco, sport]}}
simulator: {{kind: python, file: model.py}}
scenarios: {{city: {{gap: 30}}}}
measures: {{energy: kWh}}
scores: {{cost: {{formula: "2*energy", direction: minimise, range: [0, 10]}}}}
"""
Serve = Callable[..., TestClient]


def packed(name: str = "acc", model: str = "def evaluate(p, s): return {'energy': 1.0}", **files: str) -> bytes:
    """The archive of a problem."""
    held = {"problem.yaml": MANIFEST.format(name=name), "model.py": model, **files}
    return zipped(*((file, content) for file, content in held.items() if content), compression=zipfile.ZIP_STORED)


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Serve]:
    """Starts the application as it would listen on an address, with tokens or without, and other settings; `user` shows one."""
    with ExitStack() as stack:

        def start(address: str = "127.0.0.1", *, tokens: bool = False, user: str = "", **settings: Any) -> TestClient:
            url, home = f"sqlite:///{tmp_path / 'drivecal.db'}", tmp_path / "home"
            file = tmp_path / "tokens"
            file.write_text("".join(f"{name} {ROLES[name]} {token}\n" for name, token in TOKENS.items()))
            database = migrated(url)
            database.dispose()
            loaded = load_settings(database_url=url, home=home, tokens_file=file if tokens or user else None, **settings)
            app = create_app(loaded, Pushing.of(loaded, address))
            client = TestClient(app, base_url="http://localhost:8000", raise_server_exceptions=False)
            client.headers.update(bearer(user) if user else {})
            return stack.enter_context(client)

        yield start


def push(client: TestClient, archive: bytes | None = None, headers: Mapping[str, str] | None = None) -> Response:
    content = packed() if archive is None else archive
    response: Response = client.post(PROBLEMS, content=content, headers=ZIP | dict(headers or {}))
    return response


def listed(client: TestClient, headers: Mapping[str, str] | None = None) -> list[str]:
    """The names of the stored problems."""
    return [item["name"] for item in client.get(PROBLEMS, headers=headers).json()["items"]]


def bearer(name: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {TOKENS[name]}"}


@pytest.mark.slow("::1", "192.168.1.5")
@pytest.mark.parametrize("address", ["127.0.0.1", "::1", "0.0.0.0", "192.168.1.5"])
@pytest.mark.parametrize("allow", [None, True, False])
def test_a_token_pushes_if_it_is_an_authors_and_pushing_is_on(serve: Serve, address: str, allow: bool | None) -> None:
    client = serve(address, tokens=True, allow_push=allow)
    on = allow if allow is not None else address in {"127.0.0.1", "::1"}
    for name in sorted(TOKENS, reverse=True):  # the author last: what is stored already is answered otherwise
        response = push(client, headers=bearer(name))
        assert response.status_code == (201 if on and name == "author" else 403), response.text


def test_without_a_token_or_with_a_session_nothing_is_pushed(serve: Serve) -> None:
    client = serve(tokens=True)
    assert push(client).status_code == 401
    assert client.post("/api/v1/session", headers=bearer("author")).status_code == 200
    origin = {"Origin": "http://localhost:8000"}
    assert push(client, headers=origin).status_code == 403
    assert client.get("/api/v1/session").json()["may_push"]
    for other in ("http://localhost:9000", "https://evil.example", "null"):
        assert push(client, headers=bearer("author") | {"Origin": other}).status_code == 403, "no page of another origin"
    assert push(client, headers=bearer("author") | origin).status_code == 201, "the page with the token itself"
    client.cookies.clear()
    assert push(client, headers=bearer("author")).status_code == 200


@pytest.mark.parametrize("allow", [None, True])
def test_without_tokens_the_secret_of_the_home_folder_is_needed(serve: Serve, tmp_path: Path, allow: bool | None) -> None:
    client, archive = serve(allow_push=allow), packed()
    assert (tmp_path / "home" / "push.secret").stat().st_mode & 0o777 == 0o600
    right = sign(present(read_secret(tmp_path / "home")), archive)
    assert push(client, archive).status_code == 403
    for wrong in ("", "x", right[:-1] + ("0" if right[-1] != "0" else "1"), sign(b"s" * 43, archive), sign(b"", archive)):
        assert push(client, archive, {HEADER: wrong}).status_code == 403
    assert push(client, packed("other"), {HEADER: right}).status_code == 403, "a signature is of one content"
    assert push(client, archive, {"Origin": "http://localhost:8000"}).status_code == 403
    for other in ("http://localhost:9000", "https://evil.example", "null"):
        assert push(client, archive, {HEADER: right, "Origin": other}).status_code == 403, "no page of another origin"
    assert push(client, archive, {HEADER: right, "Host": "evil.example"}).status_code == 421
    assert listed(client) == ["highway-random", "highway"], "only what is installed"
    session = client.get("/api/v1/session").json()
    assert (session["may_push"], session["signed_by"]) == (True, str(tmp_path / "home" / "push.secret"))
    assert push(client, archive, {HEADER: right, "Origin": "http://localhost:8000"}).status_code == 201, "its own page"
    assert push(client, archive, {HEADER: right}).status_code == 200


def test_without_tokens_pushing_can_be_switched_off(serve: Serve, tmp_path: Path) -> None:
    client = serve(allow_push=False)
    assert not (tmp_path / "home" / "push.secret").exists()
    assert push(client, headers={HEADER: sign(b"s" * 43, packed())}).status_code == 403
    assert not client.get("/api/v1/session").json()["may_push"]


def test_a_pushed_problem_is_stored_once_listed_and_shown(serve: Serve) -> None:
    client = serve(user="author")
    archive = packed()
    first = push(client, archive)
    body = first.json()
    assert (first.status_code, first.headers["location"]) == (201, f"{PROBLEMS}/{body['digest']}")
    assert (body["name"], body["size"], body["latest"]) == ("acc", len(archive), True)
    assert body["parameters"]["x"]["step"] == 0.1
    assert (body["parameters"]["mode"]["choices"], body["parameters"]["mode"]["step"]) == (["eco", "sport"], None)
    assert body["scenarios"] == {"city": {"gap": 30}}
    assert list(client.get(f"{PROBLEMS}/highway").json()["scenarios"]) == ["S1", "S2", "S3", "S4", "S5", "S6"]
    assert (body["measures"], body["scores"]["cost"]["direction"]) == ({"energy": "kWh"}, "minimise")
    again = push(client, archive)
    assert (again.status_code, again.json()) == (200, body)
    changed = push(client, packed(model="def evaluate(p, s): return {'energy': 2.0}")).json()
    assert changed.pop("notes") == ["model.py changed: runs of the push before answer nothing"]
    assert client.get(f"{PROBLEMS}/acc").json() == changed | {"notes": []}
    assert client.get(f"{PROBLEMS}/{body['digest']}").json() == body | {"latest": False}
    assert sorted(listed(client)) == ["acc", "highway", "highway-random"]
    assert [item["digest"] for item in client.get(PROBLEMS).json()["items"] if item["name"] == "acc"] == [changed["digest"]]
    page = client.get(PROBLEMS, params={"name": "acc", "limit": 1}).json()
    assert [item["digest"] for item in page["items"]] == [changed["digest"]]
    following = client.get(PROBLEMS, params={"name": "acc", "cursor": page["next_cursor"]}).json()
    assert [item["digest"] for item in following["items"]] == [body["digest"]]


def test_the_archive_comes_back_as_it_was_pushed(serve: Serve) -> None:
    client = serve(user="author")
    archive = packed()
    push(client, archive)
    response = client.get(f"{PROBLEMS}/acc/archive")
    assert (response.content, response.headers["content-type"]) == (archive, "application/zip")
    tag = {"If-None-Match": response.headers["etag"]}
    assert client.get(f"{PROBLEMS}/acc/archive", headers=tag).status_code == 304


@pytest.mark.parametrize("unknown", ["nothing", "0" * 64, "%00", "acc/nothing"])
def test_what_was_not_pushed_is_not_found(serve: Serve, unknown: str) -> None:
    client = serve()
    assert client.get(f"{PROBLEMS}/{unknown}").status_code == 404
    assert client.get(f"{PROBLEMS}/{unknown}/archive").status_code == 404


@pytest.mark.parametrize(
    ("archive", "field"),
    [(packed(**{"../evil.py": "x"}), "../evil.py"), (packed("acc\nunknown: 1"), "problem.yaml: line 3: unknown")],
    ids=["archive", "manifest"],
)
def test_a_faulty_problem_is_refused_with_the_place_and_a_remedy(serve: Serve, archive: bytes, field: str) -> None:
    client = serve(tokens=True)
    response = push(client, archive, bearer("author"))
    assert response.status_code == 422, response.text
    assert response.headers["content-type"] == "application/problem+json"
    assert field in {error["field"] for error in response.json()["errors"]}
    assert all(error["remedy"] for error in response.json()["errors"])
    assert listed(client, bearer("author")) == ["highway-random", "highway"], "only what is installed"


def test_a_bomb_is_refused(serve: Serve) -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("problem.yaml", MANIFEST.format(name="acc"))
        archive.writestr("zeros", bytes(3 * 2**20))
    client = serve(tokens=True, problem_mb=2)
    assert len(buffer.getvalue()) < 10_000
    assert push(client, buffer.getvalue(), bearer("author")).status_code == 422


def test_only_a_problem_may_be_larger_than_other_bodies(serve: Serve) -> None:
    client = serve(user="author", problem_mb=2)
    assert push(client, packed(data="x" * 1_900_000)).status_code == 201
    assert push(client, packed(data="x" * 2_200_000)).status_code == 413
    assert client.post("/api/v1/influence-maps", json={"name": "x" * 1_900_000}).status_code == 413


@pytest.mark.slow
def test_no_more_than_the_limit_are_kept(serve: Serve) -> None:
    client = serve(user="author", pushed_problems=1)
    assert [push(client).status_code, push(client).status_code, push(client, packed("b")).status_code] == [201, 200, 413]


def test_only_a_few_archives_are_in_memory_at_a_time(serve: Serve) -> None:
    client = serve(user="author")
    push(client)
    assert isinstance(client.app, FastAPI)
    limits: Limits = client.app.state.limits
    with ExitStack() as stack:
        for _ in range(OPEN_ARCHIVES):
            stack.enter_context(limits.archives.take())
        assert [client.get(f"{PROBLEMS}/acc/archive").status_code, push(client).status_code] == [429, 429]
    assert [client.get(f"{PROBLEMS}/acc/archive").status_code for _ in range(OPEN_ARCHIVES + 1)] == [200] * (OPEN_ARCHIVES + 1)
