"""The client. One method per call of the API; answers are the contracts, errors are drivecal's own."""

import json
import time
import uuid
from collections.abc import Iterator, Mapping
from http import HTTPStatus
from types import TracebackType
from typing import Any, Literal, Self, TypeVar
from urllib.parse import quote

import httpx
from pydantic import BaseModel, ValidationError

from drivecal.client.answers import raise_for, unreachable
from drivecal.client.documents import Document, plain
from drivecal.client.event_stream import EventParser, ServerSentEvent
from drivecal.client.following import READ_SECONDS, Following, Sent, Told
from drivecal.client.frames import DownloadedTable
from drivecal.configuration.settings import load_settings
from drivecal.contracts.accounting import Accounting
from drivecal.contracts.campaign import Campaign, CampaignPage, ExpectedRuns
from drivecal.contracts.comparison import ComparedGroup, ComparedPair, ComparedRun, ExpectedComparison, ReductionEffect
from drivecal.contracts.evaluation import Evaluation, TraceAnswer
from drivecal.contracts.events import PROGRESS, CampaignEvent, CampaignProgress
from drivecal.contracts.explanation import Explanation
from drivecal.contracts.inventory import InfluenceMapAnswer, InfluenceMapPage, ScenarioPage, WorkerPage
from drivecal.contracts.setup import CampaignSetup
from drivecal.contracts.studies import StudyPage
from drivecal.contracts.tables import (
    InfluenceRow,
    OptimumRow,
    RobustnessRow,
    SolutionPage,
    TableName,
    ValidationRow,
)
from drivecal.domain.errors import OverloadError, UnavailableError

Action = Literal["pause", "resume", "cancel"]
Answer = TypeVar("Answer", bound=BaseModel)

ATTEMPTS_TO_CONNECT = 3
BROKEN_ANSWERS = 2
"""Broken connections in a call before the server counts as unreachable; a restart breaks some."""
SECONDS_TO_RESTART = 1.0
BROKEN_OFF = (httpx.ReadError, httpx.WriteError, httpx.CloseError, httpx.RemoteProtocolError)
PATIENCE_SECONDS = 30.0
"""Total wait for a server that asks to try again, in calls that are safe to repeat."""


class Client:
    """Speaks to the server at `url`. Every method raises UnavailableError where nothing answers, InvalidInputError where the server
    refuses what it was given, NotAuthorisedError where it does not know the `token` or wants one, and NotFoundError or ConflictError
    where the thing asked for is not there or not in a fitting state.

    A server that is too busy, or whose database is away, is asked again after the time that it names, for up to PATIENCE_SECONDS; but
    never where the first attempt may have done something that a second one would do again.
    """

    def __init__(self, url: str | None = None, token: str | None = None, *, timeout: float = 30.0) -> None:
        """Connects to the `url` with the `token`. Omitted, each comes from `DRIVECAL_URL`, `DRIVECAL_TOKEN` or the config file, as on
        the command line; an empty token sends none."""
        if url is None or token is None:
            settings = load_settings(url=url)
            url, token = settings.url, settings.token if token is None else token
        self.url = url.rstrip("/")
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        # Only a connection that was never made is tried again, so that nothing is ever done twice.
        transport = httpx.HTTPTransport(retries=ATTEMPTS_TO_CONNECT - 1)
        self._http = httpx.Client(base_url=self.url, timeout=timeout, transport=transport, headers=headers)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._http.close()

    def submit(self, specification: Document, key: str | None = None) -> Campaign:
        """Queues a campaign. Submitting again with the same `key` gives the same campaign."""
        return self._post("/api/v1/campaigns", Campaign, specification, key=key or uuid.uuid4().hex)

    def expected_runs(self, specification: Document) -> ExpectedRuns:
        """Checks a campaign without queueing it and says what it would cost."""
        return self._post("/api/v1/campaigns", ExpectedRuns, specification, query={"validate_only": "true"})

    def compare(self, specification: Document, key: str | None = None) -> Campaign:
        """Queues a comparison of optimizers or reductions: a campaign whose runs are campaigns of their own."""
        return self._post("/api/v1/comparisons", Campaign, specification, key=key or uuid.uuid4().hex)

    def expected_comparison(self, specification: Document) -> ExpectedComparison:
        """Checks a comparison without queueing it and says what it would cost."""
        return self._post("/api/v1/comparisons", ExpectedComparison, specification, query={"validate_only": "true"})

    def campaigns(self, state: str | None = None, limit: int | None = None, cursor: str | None = None) -> CampaignPage:
        """A page of campaigns, newest first."""
        query = {"state": state, "limit": limit, "cursor": cursor}
        return self._get("/api/v1/campaigns", CampaignPage, query=query)

    def campaign(self, identifier: str) -> Campaign:
        """Returns a campaign."""
        return self._get(_path("campaigns", identifier), Campaign, kind="campaign", identifier=identifier)

    def watch(
        self, identifier: str, deadline: float | None = None, told: Told | None = None, *, from_beginning: bool = True
    ) -> Iterator[Campaign]:
        """Yields the campaign now and whenever it changed, until it ended; `told` is called with each event, or, where `from_beginning`
        is False, with those from now on. Bears a server that restarts meanwhile.

        Raises TimeoutError when the monotonic clock passes `deadline`.
        """
        return iter(Following(self, identifier, deadline, told, from_beginning=from_beginning))

    def wait(self, identifier: str, timeout: float | None = None) -> Campaign:
        """Returns the campaign once it has ended. Raises TimeoutError after `timeout` seconds; the campaign goes on."""
        deadline = None if timeout is None else time.monotonic() + timeout
        *_, campaign = self.watch(identifier, deadline, from_beginning=False)
        return campaign

    def campaign_unless(self, identifier: str, etag: str) -> tuple[Campaign | None, str, float | None]:
        """The campaign, None if it is still the one of `etag`; its ETag; how many seconds the server asks to wait before the next
        question."""
        headers = {"If-None-Match": etag} if etag else {}
        response = self._once("GET", _path("campaigns", identifier), headers=headers)  # who follows has a patience of its own
        raise_for(response, "campaign", identifier)
        wait = float(response.headers["retry-after"]) if "retry-after" in response.headers else None
        if response.status_code == HTTPStatus.NOT_MODIFIED:
            return None, etag, wait
        return self._answer(response, Campaign), response.headers.get("etag", ""), wait

    def events(self, identifier: str, last_id: int | None = None) -> Iterator[Sent]:
        """What happened to a campaign, all of it or after the event `last_id`, and what happens until the stream ends; None is a sign of
        life. The stream ends when the campaign has ended, and also when the server stops. Raises OverloadError if it has no place for
        another stream."""
        headers = {"Accept": "text/event-stream"} | ({} if last_id is None else {"Last-Event-ID": str(last_id)})
        timeout = httpx.Timeout(self._http.timeout.connect, read=READ_SECONDS)
        path = _path("campaigns", identifier, "events")
        try:
            with self._http.stream("GET", path, headers=headers, timeout=timeout) as response:
                if not response.is_success:
                    response.read()
                if response.status_code == HTTPStatus.TOO_MANY_REQUESTS:
                    raise OverloadError("the server has no place for another event stream", retry_seconds=10)
                raise_for(response, "campaign", identifier)
                parser = EventParser()
                for chunk in response.iter_bytes():
                    events = [self._sent(follower) for follower in parser.feed(chunk)]
                    yield from events or [None]
        except httpx.TransportError as error:
            raise unreachable(self.url, error) from error

    def _sent(self, event: ServerSentEvent) -> Sent:
        try:
            if event.event == PROGRESS:
                return CampaignProgress.model_validate_json(event.data)
            document = json.loads(event.data)
            return CampaignEvent.model_validate({**document, "id": event.id})
        except (TypeError, ValueError) as error:
            raise self._strange() from error

    def act(self, identifier: str, action: Action) -> Campaign:
        """Asks for a campaign to be paused, resumed or cancelled. Asking twice is no error."""
        path = _path("campaigns", identifier, action)
        return self._post(path, Campaign, kind="campaign", identifier=identifier)

    def rerun(self, identifier: str, changes: Document, key: str | None = None) -> Campaign:
        """Queues a new campaign on the references and the influence map of an ended one."""
        path = _path("campaigns", identifier, "rerun")
        return self._post(path, Campaign, changes, key=key or uuid.uuid4().hex, kind="campaign", identifier=identifier)

    def solutions(self, identifier: str, weights: str | None = None, limit: int | None = None) -> SolutionPage:
        """The best parameter sets, under the campaign's weights or others (`S1=2,S2=1`)."""
        query = {"weights": weights, "limit": limit}
        path = _path("campaigns", identifier, "solutions")
        return self._get(path, SolutionPage, query=query, kind="campaign", identifier=identifier)

    def evaluations(self, identifier: str, **query: Any) -> DownloadedTable:
        """Every requested cell of a campaign; `query` filters as in the REST API, e.g. `scenario="S1"`."""
        return self.frame(identifier, "evaluations", **query)

    def frame(self, identifier: str, table: TableName, **query: Any) -> DownloadedTable:
        """A whole table of a campaign, for pandas, polars or Arrow."""
        return DownloadedTable(b"".join(self.table(identifier, table, "parquet", **query)))

    def table(self, identifier: str, table: TableName, form: Literal["csv", "parquet"], **query: Any) -> Iterator[bytes]:
        """A whole table, in pieces as they come."""
        path = _path("campaigns", identifier, table)
        try:
            with self._http.stream("GET", path, params={**query, "format": form}) as response:
                if not response.is_success:
                    response.read()
                raise_for(response, "campaign", identifier)
                yield from response.iter_bytes()
        except httpx.TransportError as error:
            raise unreachable(self.url, error) from error

    def rows(self, identifier: str, table: TableName) -> Iterator[dict[str, Any]]:
        """Every row of a table."""
        cursor: str | None = None
        while True:
            query = {"limit": 1000, "cursor": cursor}
            response = self._request("GET", _path("campaigns", identifier, table), query=query)
            raise_for(response, "campaign", identifier)
            page = response.json()
            yield from page["items"]
            cursor = page["next_cursor"]
            if cursor is None:
                return

    def influence(self, identifier: str) -> list[InfluenceRow]:
        """The rows of the influence map that a campaign uses; none if it has no map (yet)."""
        return self._rows_of(identifier, "influence", InfluenceRow)

    def optima(self, identifier: str) -> list[OptimumRow]:
        """The sets that share a campaign's best objective, with their regions."""
        return self._rows_of(identifier, "optima", OptimumRow)

    def setup(self, identifier: str) -> CampaignSetup:
        """Returns a campaign's setup: parameters, versions, fingerprints."""
        return self._get(_path("campaigns", identifier, "setup"), CampaignSetup, kind="campaign", identifier=identifier)

    def studies(self, identifier: str) -> StudyPage:
        """Returns the robustness and validation studies of a campaign's best sets and map, made by any campaign."""
        return self._get(_path("campaigns", identifier, "studies"), StudyPage, kind="campaign", identifier=identifier)

    def robustness(self, identifier: str) -> list[RobustnessRow]:
        """The examined sets of a campaign, most robust first; none if it has no robustness stage (yet)."""
        return self._rows_of(identifier, "robustness", RobustnessRow)

    def validation(self, identifier: str) -> list[ValidationRow]:
        """Returns the validation of a campaign's map by scenario; empty before that stage."""
        return self._rows_of(identifier, "validation", ValidationRow)

    def compared_runs(self, identifier: str) -> list[ComparedRun]:
        """The runs of a comparison."""
        return self._rows_of(identifier, "comparison", ComparedRun)

    def compared_groups(self, identifier: str) -> list[ComparedGroup]:
        """The runs of a comparison by optimizer, population and reduction: TableName 5."""
        return self._rows_of(identifier, "comparison-groups", ComparedGroup)

    def compared_pairs(self, identifier: str) -> list[ComparedPair]:
        """The runs of a comparison that differ in the reduction alone, side by side."""
        return self._rows_of(identifier, "comparison-pairs", ComparedPair)

    def reduction_effects(self, identifier: str) -> list[ReductionEffect]:
        """Returns the effects over all pairs."""
        return self._rows_of(identifier, "comparison-effects", ReductionEffect)

    def _rows_of(self, identifier: str, table: TableName, model: type[Answer]) -> list[Answer]:
        try:
            return [model.model_validate(row) for row in self.rows(identifier, table)]
        except ValidationError as error:
            raise self._strange() from error

    def accounting(self, identifier: str) -> Accounting:
        """Returns the savings and costs of a campaign."""
        path = _path("campaigns", identifier, "accounting")
        return self._get(path, Accounting, kind="campaign", identifier=identifier)

    def explanation(self, evaluation: str) -> Explanation:
        """Why a cell was, or was not, answered without a simulation; `evaluation` is its number in the table `evaluations`."""
        return self._get(_path("evaluations", evaluation, "explain"), Explanation, kind="evaluation", identifier=evaluation)

    def evaluate(self, specification: Document, key: str | None = None) -> Evaluation:
        """Queues the evaluation of one parameter set."""
        return self._post("/api/v1/evaluations", Evaluation, specification, key=key or uuid.uuid4().hex)

    def evaluation(self, identifier: str) -> Evaluation:
        """A single evaluation by the id that `evaluate` gave."""
        return self._get(_path("evaluations", identifier), Evaluation, kind="evaluation", identifier=identifier)

    def trace(self, evaluation: str) -> TraceAnswer | None:
        """The time series of an evaluation, by its number or by the id of a single one in one scenario; None while they are being made."""
        response = self._request("GET", _path("evaluations", evaluation, "trace"))
        raise_for(response, "evaluation", evaluation)
        return None if response.status_code == 202 else self._answer(response, TraceAnswer)

    def post_influence_map(self, specification: Document) -> InfluenceMapAnswer:
        """Stores an influence map."""
        return self._post("/api/v1/influence-maps", InfluenceMapAnswer, specification)

    def influence_maps(self, limit: int | None = None, cursor: str | None = None) -> InfluenceMapPage:
        """A page of influence maps, newest first."""
        return self._get("/api/v1/influence-maps", InfluenceMapPage, query={"limit": limit, "cursor": cursor})

    def influence_map(self, identifier: str) -> InfluenceMapAnswer:
        """Returns an influence map with its rows."""
        path = _path("influence-maps", identifier)
        return self._get(path, InfluenceMapAnswer, kind="influence map", identifier=identifier)

    def map_of(self, campaign: Campaign) -> InfluenceMapAnswer | None:
        """The influence map that a campaign uses, None if it has none (yet)."""
        link = campaign.links.get("influence_map")
        return None if link is None else self.influence_map(link.rpartition("/")[2])

    def scenarios(self) -> ScenarioPage:
        """The scenarios of all catalogues that the server has."""
        return self._get("/api/v1/scenarios", ScenarioPage)

    def workers(self) -> WorkerPage:
        """The workers."""
        return self._get("/api/v1/workers", WorkerPage)

    def _get(
        self,
        path: str,
        model: type[Answer],
        query: Mapping[str, Any] | None = None,
        kind: str = "",
        identifier: str = "",
    ) -> Answer:
        response = self._request("GET", path, query=query)
        raise_for(response, kind, identifier)
        return self._answer(response, model)

    def _post(
        self,
        path: str,
        model: type[Answer],
        document: Document | None = None,
        query: Mapping[str, Any] | None = None,
        key: str | None = None,
        kind: str = "",
        identifier: str = "",
    ) -> Answer:
        headers = {"Idempotency-Key": key} if key else {}
        # Actions on a campaign (no document) and counting (validate_only) may be repeated as well.
        ask = self._once if document is not None and not key and not query else self._request
        content = None if document is None else plain(document)
        response = ask("POST", path, query=query, headers=headers, document=content)
        raise_for(response, kind, identifier)
        return self._answer(response, model)

    def _request(
        self,
        method: str,
        path: str,
        query: Mapping[str, Any] | None = None,
        headers: Mapping[str, str] | None = None,
        document: Mapping[str, Any] | None = None,
    ) -> httpx.Response:
        """The answer, asked for again while the server asks for it, or breaks off, and patience lasts. To be used where repeating does
        no harm."""
        waited, broken = 0.0, 0
        while True:
            try:
                response = self._once(method, path, query, headers, document)
            except UnavailableError as error:
                broken += 1
                if broken > BROKEN_ANSWERS or not isinstance(error.__cause__, BROKEN_OFF):
                    raise
                pause = SECONDS_TO_RESTART
            else:
                asked = _pause(response)
                if asked is None or waited + asked > PATIENCE_SECONDS:
                    return response
                pause = asked
            time.sleep(pause)
            waited += pause

    def _once(
        self,
        method: str,
        path: str,
        query: Mapping[str, Any] | None = None,
        headers: Mapping[str, str] | None = None,
        document: Mapping[str, Any] | None = None,
    ) -> httpx.Response:
        params = {name: value for name, value in (query or {}).items() if value is not None}
        try:
            return self._http.request(method, path, params=params, headers=headers, json=document)
        except (httpx.TransportError, httpx.InvalidURL) as error:
            raise unreachable(self.url, error) from error

    def _answer(self, response: httpx.Response, model: type[Answer]) -> Answer:
        try:
            return model.model_validate_json(response.content)
        except ValidationError as error:
            raise self._strange() from error

    def _strange(self) -> UnavailableError:
        return UnavailableError(
            f"the server at {self.url} answers in a form this drivecal does not know; are both of one version?"
        )


def _path(*parts: str) -> str:
    return "/api/v1/" + "/".join(quote(part, safe="") for part in parts)


def _pause(response: httpx.Response) -> float | None:
    """Seconds after which the server wants to be asked again; None if it does not."""
    if response.status_code not in {HTTPStatus.TOO_MANY_REQUESTS, HTTPStatus.SERVICE_UNAVAILABLE}:
        return None
    given = response.headers.get("retry-after", "")
    return max(0.1, float(given)) if given.isascii() and given.isdecimal() and len(given) < 10 else None
