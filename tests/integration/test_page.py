"""The page's server side: its files and its session over real HTTP."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from tests.support.computed import ComputedBackend
from tests.support.runs import run, submit
from tests.support.server import RunningApi, serving

from drivecal.api.live import streams
from drivecal.api.routes import page

WRITE, READ = "writer-0123456789abcdef", "reader-0123456789abcdef"
SMALL: dict[str, Any] = {"optimizer": {"kind": "genetic", "population": 6, "iterations": 2, "seed": 3}}


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningApi]:
    folder = tmp_path_factory.mktemp("guarded")
    (folder / "tokens").write_text(f"writer write {WRITE}\nreader read {READ}\n")
    with serving(f"sqlite:///{folder / 'drivecal.db'}", tokens_file=str(folder / "tokens")) as running:
        yield running


@pytest.fixture
def built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A page of two files."""
    (tmp_path / "assets").mkdir()
    (tmp_path / "index.html").write_text("<!doctype html><title>it</title>")
    (tmp_path / "assets" / "it-1.js").write_text("// " + "much " * 200)
    (tmp_path / "sources.sha256").write_text("of no use to anybody")
    monkeypatch.setattr(page, "FILES", tmp_path)
    return tmp_path


def test_the_page_is_served_under_a_policy_without_inline_scripts(api: RunningApi, built: Path) -> None:
    del built
    answer = api.http.get("/")
    assert answer.text.endswith("<title>it</title>")
    policy = dict(part.split(" ", 1) for part in answer.headers["content-security-policy"].split("; "))
    assert policy["default-src"] == "'none'"
    assert policy["script-src"] == policy["style-src"] == policy["connect-src"] == "'self'"
    assert policy["frame-ancestors"] == policy["base-uri"] == "'none'"
    assert answer.headers["x-content-type-options"] == "nosniff"
    again = api.http.get("/", headers={"If-None-Match": answer.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")


def test_files_of_the_page_are_kept_by_browsers_and_sent_compressed(api: RunningApi, built: Path) -> None:
    answer = api.http.get("/page/assets/it-1.js")
    assert answer.headers["content-encoding"] == "gzip"
    assert answer.text == (built / "assets" / "it-1.js").read_text()
    assert "immutable" in answer.headers["cache-control"]
    assert answer.headers["content-type"].startswith("text/javascript")
    plain = api.http.get("/page/assets/it-1.js", headers={"Accept-Encoding": "identity"})
    assert "content-encoding" not in plain.headers
    assert plain.content == answer.content


def test_the_documentation_is_served_to_everybody(guarded: RunningApi, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "MANUAL", tmp_path)
    (tmp_path / "missing.txt").write_text("there is no generator <here>\n")
    assert "no generator &lt;here&gt;" in guarded.http.get("/help/").text
    (tmp_path / "index.html").write_text("<title>Start</title>")
    (tmp_path / "how-to").mkdir()
    (tmp_path / "how-to" / "fmu.html").write_text("<title>FMUs</title>")
    (tmp_path / "search.json").write_text("{}")
    moved = guarded.http.get("/help")
    assert (moved.status_code, moved.headers["location"]) == (308, "/help/")
    for path, text in (
        ("/help/", "<title>Start</title>"),
        ("/help/how-to/fmu.html", "<title>FMUs</title>"),
        ("/help/search.json", "{}"),
    ):
        answer = guarded.http.get(path)
        assert (answer.status_code, answer.text) == (200, text)
        assert "script-src 'self'" in answer.headers["content-security-policy"]
    for path in ("/help/missing.txt.bak", "/help/../api/app.py", "/help/how-to", "/help/%2e%2e/app.py", "/helpless"):
        assert guarded.http.get(path).status_code in {401, 404}


@pytest.mark.parametrize(
    "name",
    [
        *("sources.sha256", "nothing.js", "../app.py", "%2e%2e/app.py", "assets/../../app.py", "assets"),
        *("assets/%2e%2e/index.html", "nothing/%2e%2e/index.html"),
    ],
)
def test_nothing_but_the_page_is_served_as_the_page(api: RunningApi, built: Path, name: str) -> None:
    del built
    answer = api.http.get("/page/" + name)
    assert answer.status_code == 404
    assert answer.headers["content-type"] == "application/problem+json"


def test_a_token_is_shown_once_and_a_cookie_stands_for_it(guarded: RunningApi) -> None:
    own = {"Origin": guarded.url}
    with httpx.Client(base_url=guarded.url, timeout=60) as browser:
        assert browser.get("/api/v1/session").status_code == 401
        begun = browser.post("/api/v1/session", headers=own | {"Authorization": f"Bearer {READ}"})
        assert begun.json() == {"name": "reader", "may_write": False, "may_push": False, "signed_by": None}
        cookie = begun.headers["set-cookie"]
        assert READ not in cookie
        assert {"HttpOnly", "SameSite=strict", "Path=/"} <= set(cookie.split("; "))
        assert browser.get("/api/v1/session").json() == begun.json()
        assert browser.get("/api/v1/campaigns").status_code == 200
        assert browser.post("/api/v1/campaigns", json={}, headers=own).status_code == 403
        assert browser.delete("/api/v1/session", headers=own).status_code == 204
        assert browser.get("/api/v1/session").status_code == 401


def test_what_numbers_mean_is_said_with_them(api: RunningApi) -> None:
    campaign = run(api.database, submit(api.database, **SMALL), ComputedBackend())
    setup = api.http.get(f"/api/v1/campaigns/{campaign.id}/setup").json()
    assert all(parameter["description"] for parameter in setup["parameters"])
    assert all(scenario["title"] for scenario in setup["scenarios"])
    row = api.http.get(f"/api/v1/campaigns/{campaign.id}/evaluations?limit=1").json()["items"][0]
    detail = api.http.get(f"/api/v1/evaluations/{row['id']}").json()
    assert detail["parameters"] == {f"P{number}": row[f"P{number}"] for number in range(1, 12)}
    assert (detail["campaign"]["id"], detail["campaign"]["problem"]) == (campaign.id, "highway")
    assert detail["campaign"]["scale"]["direction"] == "maximise"


def test_an_event_stream_ends_when_its_token_is_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streams, "KEEPALIVE_SECONDS", 0.05)
    tokens = tmp_path / "tokens"
    tokens.write_text(f"writer write {WRITE}\nreader read {READ}\n")
    reads = {"Authorization": f"Bearer {READ}"}
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}", tokens_file=str(tokens)) as api:
        campaign = submit(api.database, **SMALL).id
        events = f"{api.url}/api/v1/campaigns/{campaign}/events"
        with httpx.stream("GET", events, headers=reads, timeout=300) as response:
            chunks = response.iter_bytes()
            assert next(chunks)
            tokens.write_text(f"writer write {WRITE}\n")
            for _ in chunks:
                pass
