"""A corpus of hostile requests against the API as a process of its own: each is refused in words, and the process stays small."""

import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
from pydantic import BaseModel
from tests.support.api_process import ApiProcess, api_process
from tests.support.effort import sample
from tests.support.server import refused

from drivecal.contracts.specification import CampaignSpecification, EvaluationSpecification, InfluenceMapSpecification

MOST_MEGABYTES = 20.0
JSON = {"Content-Type": "application/json"}
NOBODY = "0" * 32
POSTS: dict[str, type[BaseModel]] = {
    "/api/v1/campaigns": CampaignSpecification,
    "/api/v1/campaigns?validate_only=true": CampaignSpecification,
    "/api/v1/influence-maps": InfluenceMapSpecification,
    "/api/v1/evaluations": EvaluationSpecification,
}
LONG = "x" * 1_000_000
SET = {f"P{number}": 0.333 for number in range(1, 12)}


def compact(document: object) -> bytes:
    return json.dumps(document, separators=(",", ":")).encode()


BODIES: dict[str, bytes] = {
    "NaN": b'{"weights": {"S1": NaN}}',
    "Infinity": b'{"weights": {"S1": Infinity}}',
    "1e999": b'{"weights": {"S1": 1e999}}',
    "-0.0": b'{"optimizer": {"population": -0.0}, "scenarios": -0.0, "parameters": -0.0}',
    "huge integer": b'{"optimizer": {"population": ' + b"9" * 900_000 + b"}}",
    "huge exponent": b'{"optimizer": {"population": 1e-' + b"9" * 900_000 + b"}}",
    "long fraction": b'{"weights": {"S99": 0.' + b"1" * 900_000 + b"}}",
    "lone surrogate": rb'{"name": "\ud800"}',
    "lone surrogate as key": rb'{"\udfff": 1}',
    "surrogate in UTF-8": b'{"name": "\xed\xa0\x80"}',
    "null byte": b'{"name": "a\\u0000b", "driving_function": "\\u0000"}',
    "raw null bytes": b"\x00" * 1_000_000,
    "deep lists": b"[" * 100_000,
    "deep objects": b'{"a":' * 100_000,
    "deep and closed": b'{"name": ' + b"[" * 100_000 + b"]" * 100_000 + b"}",
    "duplicate keys": b'{"name": "a", "name": "b"}',
    "many duplicate keys": b'{"fixed": {' + b'"P1": 1,' * 100_000 + b'"P1": 1}}',
    "blanks": b" " * 1_000_000,
    "many keys": compact({str(key): 1 for key in range(80_000)}),
    "many weights": compact({"weights": {str(key): "x" for key in range(80_000)}}),
    "many settings": compact({"optimizer": {f"a{key}": 1 for key in range(80_000)}}),
    "many fixed": compact({"fixed": {f"P{key}": 1e308 for key in range(60_000)}}),
    "many numbers": compact({"optimizer": {"start_sets": [1] * 400_000}}),
    "many lists": compact({"optimizer": {"x": [[]] * 300_000}}),
    "many objects": compact({"catalogue": [{}] * 300_000}),
    "many wrong sets": compact({"optimizer": {"start_sets": [{"P1": "x"}] * 80_000}}),
    "many sets off the grid": compact({"sensitivity": None, "optimizer": {"population": 9_000, "start_sets": [SET] * 8_000}}),
    "many regions": compact({"scenarios": {f"S{i}": {f"P{k}": 1 for k in range(100)} for i in range(900)}}),
    "many whole regions": compact({"scenarios": {f"S{i}": {f"P{k}": {} for k in range(80)} for i in range(900)}}),
    "many parameters": compact({"parameters": [{"name": f"P{i}", "lower": 0, "upper": 1e6, "step": 1e-9} for i in range(200)]}),
    "not JSON": b"\x89PNG\r\n\x1a\n" * 100_000,
    "zip": b"PK\x03\x04" + b"\x00" * 900_000,
}


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ApiProcess]:
    folder = tmp_path_factory.mktemp("corpus")
    with api_process(f"sqlite:///{folder / 'drivecal.db'}", folder) as running:
        yield running


def usual_work(api: ApiProcess) -> None:
    """Returns what every server does in its first minutes: everything is loaded after it."""

    def ask(_: int) -> None:
        api.http.post("/api/v1/campaigns", json={"sensitivity": None, "optimizer": {"population": 10, "iterations": 2}})
        api.http.post("/api/v1/campaigns?validate_only=true", json={}).raise_for_status()
        refused(api.http.post("/api/v1/campaigns", json={"name": 5, "unknown": 1}))
        for path in ("/openapi.json", "/api/v1/campaigns", "/api/v1/scenarios", "/api/v1/parameters", "/metrics"):
            api.http.get(path).raise_for_status()
        refused(api.http.get(f"/api/v1/campaigns/{NOBODY}"))

    with ThreadPoolExecutor(16) as pool:
        list(pool.map(ask, range(40)))


def chunks(megabytes: int | None) -> Iterator[bytes]:
    """So much of a body, or a body without end."""
    sent = 0
    while megabytes is None or sent < megabytes:
        yield b" " * 2**20
        sent += 1


@pytest.mark.slow
def test_nothing_hostile_is_accepted_and_nothing_of_it_is_kept(api: ApiProcess) -> None:
    usual_work(api)
    before = api.megabytes
    first = next(iter(POSTS))
    for path, model in POSTS.items():
        for name, content in BODIES.items() if path == first else sample(list(BODIES.items()), 4):
            document = refused(api.http.post(path, content=content, headers=JSON))
            assert document["status"] in {413, 422}, name
            assert document["errors"], name
        for field in model.model_fields:
            errors = refused(api.http.post(path, content=compact({field: LONG}), headers=JSON))["errors"]
            assert field in {error["field"].partition(".")[0] for error in errors}
    for method in ("POST", "GET"):
        for megabytes in (500, None):
            with api.http.stream(method, "/api/v1/campaigns", content=chunks(megabytes), headers=JSON) as response:
                assert response.status_code == (413 if method == "POST" else 200)
    declared = {**JSON, "Content-Length": str(500 * 2**20)}
    with api.http.stream("POST", "/api/v1/campaigns", content=chunks(500), headers=declared) as response:
        assert response.status_code == 413
    with ThreadPoolExecutor(16) as pool:
        list(pool.map(lambda body: refused(api.http.post("/api/v1/campaigns", content=body, headers=JSON)), BODIES.values()))
    grown = api.megabytes - before
    print(f"the process grew by {grown:.1f} MB, from {before:.1f} MB")
    assert grown < MOST_MEGABYTES, f"the process grew by {grown:.1f} MB"
    assert api.process.is_running()
    assert api.http.get("/healthz").status_code == 200


@pytest.mark.parametrize("path", [*POSTS, f"/api/v1/campaigns/{NOBODY}/rerun"])
def test_a_compressed_body_is_not_unpacked(api: ApiProcess, path: str) -> None:
    for encoding in ("gzip", "br", "identity, gzip", "x", "GZIP"):
        response = api.http.post(path, content=b"{}", headers=JSON | {"Content-Encoding": encoding})
        assert refused(response)["status"] == 415, encoding
        assert response.headers["accept-encoding"] == "identity"


TRAVERSALS = [
    "..",
    "../..",
    "../../etc/passwd",
    "..\\..\\etc\\passwd",
    "/etc/passwd",
    "C:\\x",
    "%2e%2e%2f",
    "\0",
    "a/../b",
    "file:///etc/passwd",
]


@pytest.mark.parametrize("path", ["campaigns/{}", "campaigns/{}/evaluations", "evaluations/{}", "influence-maps/{}"])
def test_an_id_that_is_a_path_leads_nowhere(api: ApiProcess, path: str) -> None:
    for identifier in TRAVERSALS:
        quoted = "".join(f"%{byte:02x}" for byte in identifier.encode())
        response = api.http.get(f"/api/v1/{path.format(quoted)}")
        assert refused(response)["status"] == 404, identifier
        assert "root:" not in response.text
