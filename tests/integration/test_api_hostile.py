"""Tests of what does not belong into a request never gives a server error, never stores half of something, and is refused in words."""

import json
import re
from typing import Any
from urllib.parse import quote

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sqlalchemy import select
from tests.integration.test_api_tokens import routes
from tests.support.effort import examples
from tests.support.server import RunningApi, refused

from drivecal.contracts.specification import CampaignSpecification
from drivecal.storage.engine.tables import campaigns

POSTS = [
    "/api/v1/campaigns",
    "/api/v1/campaigns?validate_only=true",
    "/api/v1/influence-maps",
    "/api/v1/evaluations",
    "/api/v1/campaigns/00000000000000000000000000000000/rerun",
]
many = settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


pytestmark = pytest.mark.parametrize("api", ["sqlite", "postgresql"], indirect=True, scope="module")


def post(api: RunningApi, path: str, content: bytes, content_type: str = "application/json") -> httpx.Response:
    return api.http.post(path, content=content, headers={"Content-Type": content_type})


@pytest.mark.slow("postgresql")
@pytest.mark.parametrize("path", POSTS)
@pytest.mark.parametrize(
    "content_type", ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data", "", "é;;=", "json"]
)
def test_a_body_that_is_not_declared_as_json_is_refused(api: RunningApi, path: str, content_type: str) -> None:
    response = api.http.post(path, content=b"{}", headers={b"Content-Type": content_type.encode("latin-1")})
    assert refused(response)["status"] == 415


@pytest.mark.parametrize(
    "query",
    [
        "limit=0",
        "limit=1001",
        "limit=-1",
        "limit=1e3",
        "limit=" + "9" * 5000,
        "limit=",
        "state=unknown",
        "state=%00",
        "state=%FF",
        "cursor=x",
        "cursor=%00",
        "cursor=WzEuNV0",
        "cursor=Wzk5OTk5OTk5OTk5OTk5OTk5OTk5OV0",
        "cursor=" + "a" * 501,
        "cursor=%F0%9F%9A%97",
        "unknown=1",
        "%00=1",
    ],
)
def test_a_query_that_does_not_fit_is_refused_by_name(api: RunningApi, query: str) -> None:
    assert refused(api.http.get(f"/api/v1/campaigns?{query}"))["errors"]


@pytest.mark.parametrize(
    "address", ["scenarios?limit=5", "parameters?=null", "problems?cursor=&cursor=x", "campaigns?limit=1&limit=2"]
)
def test_a_query_that_an_operation_does_not_have_or_twice_is_refused_by_name(api: RunningApi, address: str) -> None:
    assert [error["field"] for error in refused(api.http.get(f"/api/v1/{address}"))["errors"]] == [
        address.partition("?")[2].partition("=")[0] or "''"
    ]


def test_lists_are_given_by_repeating_a_parameter(api: RunningApi) -> None:
    assert api.http.get("/api/v1/campaigns?tag=a&tag=b").status_code == 200


@pytest.mark.parametrize("key", ["", "a b", "é", "a" * 201])
def test_an_idempotency_key_that_cannot_be_kept_is_refused(api: RunningApi, key: str) -> None:
    headers = {b"Idempotency-Key": key.encode("latin-1")}
    assert refused(api.http.post("/api/v1/campaigns", json={}, headers=headers))["errors"][0]["field"] == "Idempotency-Key"


anything: st.SearchStrategy[Any] = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**70), 2**70)
    | st.floats()
    | st.text(max_size=8)
    | st.sampled_from(["S1", "S6", "P1", "P11", "highway", "frenet", "genetic", "random", "influence", "lhs"]),
    lambda children: (
        st.lists(children, max_size=4) | st.dictionaries(st.text(max_size=6) | st.sampled_from(["S1", "P1"]), children)
    ),
    max_leaves=12,
)
FIELDS = [*CampaignSpecification.model_fields, "scenarios", "scenario", "map"]


@pytest.mark.slow("postgresql")
@given(document=st.dictionaries(st.sampled_from(FIELDS), anything, max_size=4) | anything, path=st.sampled_from(POSTS[1:]))
@many
def test_no_document_gives_a_server_error(api: RunningApi, document: object, path: str) -> None:
    response = post(api, path, json.dumps(document).encode())
    assert response.status_code < 500, response.text


@given(content=st.binary(max_size=300), path=st.sampled_from(POSTS[1:]))
@many
def test_no_bytes_give_a_server_error(api: RunningApi, content: bytes, path: str) -> None:
    response = post(api, path, content)
    assert response.status_code < 500, response.text
    try:
        json.loads(content)
    except ValueError:  # also what is no UTF-8
        assert refused(response)


gets = st.deferred(
    lambda: st.sampled_from([path for method, path in routes() if method == "GET" and "/v1/" in path and "{" in path])
)


@given(path=gets, identifier=st.text(max_size=40), query=st.text(max_size=40))
@many
def test_no_path_and_query_give_a_server_error(api: RunningApi, path: str, identifier: str, query: str) -> None:
    quoted = quote(identifier.encode("utf-8", "replace"), safe="")
    url = f"{re.sub(r'{.*?}', quoted, path)}?{quote(query.encode('utf-8', 'replace'), safe='=&')}"
    response = api.http.get(url)
    assert response.status_code < 500, response.text


@given(accept=st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=60), weights=st.text(max_size=30))
@many
def test_no_accept_header_and_weights_give_a_server_error(api: RunningApi, accept: str, weights: str) -> None:
    with api.database.read() as connection:
        identifier = connection.scalar(select(campaigns.c.id).limit(1))
    if identifier is None:
        identifier = api.http.post("/api/v1/campaigns", json={}).json()["id"]
    url = f"/api/v1/campaigns/{identifier}/solutions"
    response = api.http.get(url, params={"weights": weights.encode("utf-8", "replace")}, headers={"Accept": accept.strip()})
    assert response.status_code < 500, response.text
