"""Tests of what the OpenAPI document promises holds for requests that schemathesis derives from it, good ones and bad ones."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
import schemathesis
from fastapi import FastAPI
from hypothesis import HealthCheck, assume, settings
from hypothesis import strategies as st
from schemathesis.checks import CheckFunction, not_a_server_error
from schemathesis.config import SchemathesisConfig
from schemathesis.core.result import Ok
from schemathesis.pytest.lazy import get_all_tests
from schemathesis.schemas import BaseSchema
from schemathesis.specs.openapi.checks import negative_data_rejection, positive_data_acceptance
from tests.support.answered_campaigns import carry_out, carry_out_evaluation
from tests.support.effort import LONG, tries
from tests.support.server import RunningApi, serving
from tests.support.values import MIDDLE
from tests.support.zips import zipped

from drivecal.api.app import create_app
from drivecal.api.responses import ROOT
from drivecal.configuration.settings import load_settings

TOKEN = "writer-0123456789abcdef"
HEADERS = {"Authorization": f"Bearer {TOKEN}"}
EXAMPLES = tries(2, 40)
LONGEST_SECONDS = tries(900, 3600)
"""For all operations together."""
SMALL: dict[str, Any] = {"sensitivity": None, "catalogue": ["S1", "S4"], "optimizer": {"population": 10, "iterations": 2}}
MANIFEST = """
problem: mine
parameters: {x: {lower: 0, upper: 1}}
simulator: {kind: python, file: model.py}
scenarios: {s: {}}
measures: {m: "1"}
scores: {c: {formula: m, direction: minimise, range: [0, 1]}}
"""
often = settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck))
NOT_IN_A_SCHEMA: list[CheckFunction] = [positive_data_acceptance]
"""Which plug-ins are installed, which values lie on a grid and which cursors were given out is in no schema."""


def application() -> FastAPI:
    """The application as it is served, for its document alone."""
    with TemporaryDirectory() as folder:
        tokens = Path(folder) / "tokens"
        tokens.write_text(f"writer author {TOKEN}\n")
        return create_app(load_settings(database_url="sqlite:///never-made.db", tokens_file=str(tokens)))


def archive(manifest: str = MANIFEST) -> bytes:
    """A problem as it is pushed."""
    return zipped(("problem.yaml", manifest), ("model.py", ""))


archives = st.one_of(st.just(archive()), st.text().map(archive), st.binary(max_size=200))
schemathesis.openapi.media_type("application/zip", archives)
schemathesis.serializer.alias("application/zip", "application/octet-stream")

REFUSALS = ["400", "401", "403", "404", "405", "409", "413", "415", "422"]
CONFIG = SchemathesisConfig.from_dict(
    {
        "checks": {"negative_data_rejection": {"expected-statuses": REFUSALS}},
        "phases": {"coverage": {"enabled": LONG}},  # thousands of requests
    }
)


@pytest.fixture(scope="module")
def schema() -> BaseSchema:
    """The document with what a request for each of its operations may hold, but for tokens: all requests have the right one."""
    document: dict[str, Any] = application().openapi()
    del document["components"]["securitySchemes"], document["security"]
    for operation in (each for methods in document["paths"].values() for each in methods.values()):
        operation.pop("security", None)
    return schemathesis.openapi.from_dict(document, config=CONFIG)


@dataclass(frozen=True)
class Known:
    """Describes what is in the database."""

    campaign: str
    evaluation: str
    row: str
    map: str
    problem: str
    tag: str


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningApi]:
    folder: Path = tmp_path_factory.mktemp("schema")
    (folder / "tokens").write_text(f"writer author {TOKEN}\n")
    with serving(f"sqlite:///{folder / 'drivecal.db'}", tokens_file=str(folder / "tokens"), queued_campaigns=100_000) as api:
        api.http.headers.update(HEADERS)
        yield api


@pytest.fixture(scope="module")
def known(api: RunningApi) -> Known:
    def post(path: str, document: dict[str, Any]) -> dict[str, Any]:
        answer: dict[str, Any] = api.http.post(f"/api/v1/{path}", json=document).raise_for_status().json()
        return answer

    posted_map = post("influence-maps", {"scenarios": {"S1": {"P1": {"lower": -10}}}})
    campaign = post("campaigns", SMALL | {"sensitivity": {"map": posted_map["id"]}})
    carry_out(api.database, campaign["id"])
    parameters = MIDDLE
    evaluation = post("evaluations", {"parameters": parameters, "scenario": "S2"})
    carry_out_evaluation(api.database, evaluation["id"])
    row = api.http.get(f"/api/v1/campaigns/{campaign['id']}/evaluations").json()["items"][0]["id"]
    post(f"campaigns/{campaign['id']}/rerun", {"weights": {"S1": 2}})  # keeps it from being deleted
    api.http.patch(f"/api/v1/campaigns/{campaign['id']}", json={"tags": ["mine"]}).raise_for_status()
    form = {"Content-Type": "application/zip"}
    problem = api.http.post("/api/v1/problems", content=archive(), headers=form).raise_for_status().json()
    return Known(campaign["id"], evaluation["id"], str(row), posted_map["id"], problem["name"], "mine")


def derive(
    schema: BaseSchema, judge: Callable[[schemathesis.Case[Any]], None], subtests: pytest.Subtests, least: int = 20
) -> None:
    """Has `judge` look at requests for each operation. They are derived here: at collection, every process of the tests would do it."""
    operations = 0
    for result in get_all_tests(schema=schema, test_func=judge, settings=often, given_kwargs={}):
        assert isinstance(result, Ok), result
        operation, test = result.ok()
        operations += 1
        with subtests.test(operation.label):
            test()
    assert operations >= least


@pytest.mark.slow
@pytest.mark.timeout(LONGEST_SECONDS)
def test_every_answer_is_as_documented(schema: BaseSchema, api: RunningApi, subtests: pytest.Subtests) -> None:
    def judge(case: schemathesis.Case[Any]) -> None:
        # Of an address beyond 64 kB the server reads a part, and closes the connection: clients see the refusal or the end of it.
        assume(sum(len(str(value)) for value in case.query.values()) < 4_000)
        # A server without a dispatcher is not ready, and 503 is how it says so.
        excluded = [*NOT_IN_A_SCHEMA, *([not_a_server_error] if case.operation.path == "/readyz" else [])]
        if not case.operation.path.startswith(ROOT) or any(value is None or value in ([], {}) for value in case.query.values()):
            excluded.append(negative_data_rejection)  # probes may send what they want, and such values are in no address
        case.call_and_validate(api.url, headers=HEADERS, excluded_checks=excluded, timeout=300)

    derive(schema, judge, subtests)


@pytest.mark.slow("evaluation")
@pytest.mark.timeout(LONGEST_SECONDS)
@pytest.mark.parametrize("of_evaluations", ["evaluation", "row"])
def test_every_answer_about_what_is_there_is_as_documented(
    schema: BaseSchema, api: RunningApi, known: Known, of_evaluations: str, subtests: pytest.Subtests
) -> None:
    """`row`: the id of a campaign's row, which is answered in another shape than that of a single evaluation."""
    ids = {
        "campaign_id": known.campaign,
        "map_id": known.map,
        "evaluation_id": getattr(known, of_evaluations),
        "scenario_id": "S1",
        "problem": known.problem,
        "tag": known.tag,
        "key": "a1",
    }

    def judge(case: schemathesis.Case[Any]) -> None:
        for name in case.path_parameters:
            case.path_parameters[name] = ids[name]
        # An id that was to be wrong is right now.
        excluded = [*NOT_IN_A_SCHEMA, negative_data_rejection]
        case.call_and_validate(api.url, headers=HEADERS, excluded_checks=excluded, timeout=300)

    if of_evaluations == "evaluation":
        derive(schema.include(path_regex="{"), judge, subtests)
    else:
        derive(schema.include(path_regex="{evaluation_id}"), judge, subtests, least=2)
