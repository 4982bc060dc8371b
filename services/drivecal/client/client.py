"""The client. One method per call of the API; answers are the contracts, errors are drivecal's own."""

import json
import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from http import HTTPStatus
from typing import Any, Literal, Self
from urllib.parse import quote

import httpx
from pydantic import RootModel, ValidationError

from drivecal.client.answers import raise_for, unreachable
from drivecal.client.documents import Document, plain
from drivecal.client.event_stream import EventParser, ServerSentEvent
from drivecal.client.following import READ_SECONDS, Following, Sent, Told
from drivecal.client.frames import DownloadedTable
from drivecal.client.problems import Pushed, archive_of, push_headers
from drivecal.client.tables import Answer, TypedTables
from drivecal.configuration.settings import load_settings
from drivecal.contracts.accounting import Accounting
from drivecal.contracts.campaign import Campaign, CampaignPage, ExpectedRuns, StudyPage
from drivecal.contracts.comparison import ExpectedComparison
from drivecal.contracts.evaluation import Evaluation, FailurePage, SeriesAnswer, TraceAnswer
from drivecal.contracts.events import PROGRESS, CampaignEvent, CampaignProgress
from drivecal.contracts.explanation import Explanation
from drivecal.contracts.inventory import InfluenceMapAnswer, InfluenceMapPage, ScenarioPage, WorkerPage
from drivecal.contracts.problems import ProblemAnswer, ProblemPage
from drivecal.contracts.setup import CampaignSetup
from drivecal.contracts.tables import SolutionPage, TableName
from drivecal.contracts.trust import TrustAnswer
from drivecal.domain.errors import OverloadError, UnavailableError

Action = Literal["pause", "resume", "cancel"]

KINDS = {"campaigns": "campaign", "evaluations": "evaluation", "influence-maps": "influence map", "problems": "problem"}
"""Names of what the collections hold, for messages."""
ATTEMPTS_TO_CONNECT = 3
BROKEN_ANSWERS = 2
"""Broken connections in a call before the server counts as unreachable; a restart breaks some."""
SECONDS_TO_RESTART = 1.0
BROKEN_OFF = (httpx.ReadError, httpx.WriteError, httpx.CloseError, httpx.RemoteProtocolError)
PATIENCE_SECONDS = 30.0
"""Total wait for a server that asks to try again, in calls that are safe to repeat."""


class Client(TypedTables):
    """A client of the server at `url`.

    Every method raises UnavailableError if nothing answers, InvalidInputError if the server refuses the input, and NotAuthorisedError if
    the server does not know the `token` or requires one. NotFoundError and ConflictError are about the requested object.

    If the server is busy or its database is away, the client asks again after the time that it names, for up to PATIENCE_SECONDS. It
    never repeats a call that may already have changed something.
    """

    def __init__(self, url: str | None = None, token: str | None = None, *, timeout: float = 30.0) -> None:
        """Connects to the `url` with the `token`, as on the command line if they are omitted; an empty token sends none."""
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

    def __exit__(self, *_: object) -> None:
        self._http.close()

    def submit(self, specification: Document, key: str | None = None) -> Campaign:
        """Queues a campaign. Submitting again with the same `key` gives the same campaign."""
        return self._post(Campaign, "campaigns", document=specification, key=key or uuid.uuid4().hex)

    def expected_runs(self, specification: Document) -> ExpectedRuns:
        """Checks a campaign without queueing it and returns its expected cost."""
        return self._post(ExpectedRuns, "campaigns", document=specification, validate_only="true")

    def compare(self, specification: Document, key: str | None = None) -> Campaign:
        """Queues a comparison of optimizers or reductions: a campaign whose runs are campaigns of their own."""
        return self._post(Campaign, "comparisons", document=specification, key=key or uuid.uuid4().hex)

    def expected_comparison(self, specification: Document) -> ExpectedComparison:
        """Checks a comparison without queueing it and returns its expected cost."""
        return self._post(ExpectedComparison, "comparisons", document=specification, validate_only="true")

    def campaigns(self, state: str | None = None, limit: int | None = None, cursor: str | None = None) -> CampaignPage:
        """Returns a page of campaigns, newest first."""
        return self._get(CampaignPage, "campaigns", state=state, limit=limit, cursor=cursor)

    def campaign(self, identifier: str) -> Campaign:
        """Returns a campaign."""
        return self._get(Campaign, "campaigns", identifier)

    def watch(
        self, identifier: str, deadline: float | None = None, told: Told | None = None, *, from_beginning: bool = True
    ) -> Iterator[Campaign]:
        """Yields the campaign now and after each change until it has ended. Tolerates a restart of the server.

        Calls `told` with each event, or with later events only if `from_beginning` is False. Raises TimeoutError when the monotonic clock
        passes `deadline`.
        """
        return iter(Following(self, identifier, deadline, told, from_beginning=from_beginning))

    def wait(self, identifier: str, timeout: float | None = None) -> Campaign:
        """Returns the campaign once it has ended. Raises TimeoutError after `timeout` seconds; the campaign continues."""
        deadline = None if timeout is None else time.monotonic() + timeout
        *_, campaign = self.watch(identifier, deadline, from_beginning=False)
        return campaign

    def campaign_unless(self, identifier: str, etag: str) -> tuple[Campaign | None, str, float | None]:
        """Returns the campaign, None if it is still the one of `etag`; its ETag; the seconds to wait before the next request."""
        place, headers = ("campaigns", identifier), {"If-None-Match": etag} if etag else {}
        response = self._once("GET", place, headers=headers)  # `Following` has a patience of its own
        raise_for(response, *_named(place))
        wait = float(response.headers["retry-after"]) if "retry-after" in response.headers else None
        if response.status_code == HTTPStatus.NOT_MODIFIED:
            return None, etag, wait
        return self._answer(response, Campaign, place), response.headers.get("etag", ""), wait

    def events(self, identifier: str, last_id: int | None = None) -> Iterator[Sent]:
        """Yields the events of a campaign, all of them or those after the event `last_id`; None is a sign of life.

        The stream ends when the campaign has ended or the server stops. Raises OverloadError if the server has no place for a stream.
        """
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
        return self._post(Campaign, "campaigns", identifier, action)

    def rerun(self, identifier: str, changes: Document, key: str | None = None) -> Campaign:
        """Queues a new campaign on the references and the influence map of an ended one."""
        return self._post(Campaign, "campaigns", identifier, "rerun", document=changes, key=key or uuid.uuid4().hex)

    def solutions(self, identifier: str, weights: str | None = None, limit: int | None = None) -> SolutionPage:
        """Returns the best parameter sets, under the campaign's weights or others (`S1=2,S2=1`)."""
        return self._get(SolutionPage, "campaigns", identifier, "solutions", weights=weights, limit=limit)

    def evaluations(self, identifier: str, **query: Any) -> DownloadedTable:
        """Returns every requested cell of a campaign. `query` filters as in the REST API, e.g. `scenario="S1"`."""
        return self.frame(identifier, "evaluations", **query)

    def frame(self, identifier: str, table: TableName, **query: Any) -> DownloadedTable:
        """Returns a whole table of a campaign, for pandas, polars or Arrow; with `where`, a list of conditions, only some rows."""
        return DownloadedTable(b"".join(self.table(identifier, table, "parquet", **query)))

    def table(self, identifier: str, table: TableName, form: Literal["csv", "parquet"], **query: Any) -> Iterator[bytes]:
        """Yields a whole table in pieces as they arrive."""
        path = _path("campaigns", identifier, table)
        try:
            with self._http.stream("GET", path, params={**query, "format": form}) as response:
                if not response.is_success:
                    response.read()
                raise_for(response, "campaign", identifier)
                yield from response.iter_bytes()
        except httpx.TransportError as error:
            raise unreachable(self.url, error) from error

    def rows(self, identifier: str, table: TableName, **query: Any) -> Iterator[dict[str, Any]]:
        """Yields every row of a table."""
        cursor: str | None = None
        while True:
            place = ("campaigns", identifier, table)
            response = self._request("GET", place, query={**query, "limit": 1000, "cursor": cursor})
            raise_for(response, *_named(place))
            page = response.json()
            yield from page["items"]
            cursor = page["next_cursor"]
            if cursor is None:
                return

    def setup(self, identifier: str) -> CampaignSetup:
        """Returns a campaign's setup: parameters, versions, fingerprints."""
        return self._get(CampaignSetup, "campaigns", identifier, "setup")

    def failures(self, identifier: str) -> FailurePage:
        """Returns the causes of a campaign's failed cells, frequent ones first."""
        return self._get(FailurePage, "campaigns", identifier, "failures")

    def studies(self, identifier: str) -> StudyPage:
        """Returns the robustness and validation studies of a campaign's best sets and map, made by any campaign."""
        return self._get(StudyPage, "campaigns", identifier, "studies")

    def accounting(self, identifier: str) -> Accounting:
        """Returns the savings and costs of a campaign."""
        return self._get(Accounting, "campaigns", identifier, "accounting")

    def trust(self, identifier: str) -> TrustAnswer:
        """Returns the light of a campaign's result, and the reasons for it."""
        return self._get(TrustAnswer, "campaigns", identifier, "trust")

    def explanation(self, evaluation: str) -> Explanation:
        """Returns why a cell was, or was not, answered without a simulation. `evaluation`: its number in the table `evaluations`."""
        return self._get(Explanation, "evaluations", evaluation, "explain")

    def evaluate(self, specification: Document, key: str | None = None) -> Evaluation:
        """Queues the evaluation of one parameter set."""
        return self._post(Evaluation, "evaluations", document=specification, key=key or uuid.uuid4().hex)

    def evaluation(self, identifier: str) -> Evaluation:
        """Returns a single evaluation by the id that `evaluate` returned."""
        return self._get(Evaluation, "evaluations", identifier)

    def trace(self, evaluation: str) -> TraceAnswer | SeriesAnswer | None:
        """Returns the time series of an evaluation, None while they are being made; of a bundle's, those of its simulator.

        `evaluation`: its number, or the id of a single evaluation in one scenario.
        """
        place = ("evaluations", evaluation, "trace")
        response = self._request("GET", place)
        if response.status_code == HTTPStatus.ACCEPTED:
            return None
        either: RootModel[TraceAnswer | SeriesAnswer] = self._answer(response, RootModel[TraceAnswer | SeriesAnswer], place)
        return either.root

    def post_influence_map(self, specification: Document) -> InfluenceMapAnswer:
        """Stores an influence map."""
        return self._post(InfluenceMapAnswer, "influence-maps", document=specification)

    def influence_maps(self, limit: int | None = None, cursor: str | None = None) -> InfluenceMapPage:
        """Returns a page of influence maps, newest first."""
        return self._get(InfluenceMapPage, "influence-maps", limit=limit, cursor=cursor)

    def influence_map(self, identifier: str) -> InfluenceMapAnswer:
        """Returns an influence map with its rows."""
        return self._get(InfluenceMapAnswer, "influence-maps", identifier)

    def map_of(self, campaign: Campaign) -> InfluenceMapAnswer | None:
        """Returns the influence map that a campaign uses, None without one."""
        link = campaign.links.get("influence_map")
        return None if link is None else self.influence_map(link.rpartition("/")[2])

    def push_problem(self, problem: Pushed) -> ProblemAnswer:
        """Stores a problem: a folder with `problem.yaml`, or an archive of one. Takes a token of an author, or the server's own user."""
        archive = archive_of(problem)
        place, headers = ("problems",), push_headers(archive, signed="Authorization" not in self._http.headers)
        return self._answer(self._request("POST", place, headers=headers, content=archive), ProblemAnswer, place)

    def problems(self, name: str | None = None, limit: int | None = None, cursor: str | None = None) -> ProblemPage:
        """Returns a page of problems, last pushed first: each name once, or every push of one `name`."""
        return self._get(ProblemPage, "problems", name=name, limit=limit, cursor=cursor)

    def problem(self, name: str) -> ProblemAnswer:
        """Returns a problem by its name or digest."""
        return self._get(ProblemAnswer, "problems", name)

    def scenarios(self) -> ScenarioPage:
        """Returns the scenarios of all catalogues of the server."""
        return self._get(ScenarioPage, "scenarios")

    def workers(self) -> WorkerPage:
        """Returns the workers."""
        return self._get(WorkerPage, "workers")

    def _get(self, model: type[Answer], *place: str, **query: Any) -> Answer:
        return self._answer(self._request("GET", place, query=query), model, place)

    def _post(
        self, model: type[Answer], *place: str, document: Document | None = None, key: str | None = None, **query: Any
    ) -> Answer:
        headers = {"Idempotency-Key": key} if key else {}
        # Actions on a campaign (no document) and counting (validate_only) may be repeated as well.
        ask = self._once if document is not None and not key and not query else self._request
        content = None if document is None else plain(document)
        return self._answer(ask("POST", place, query=query, headers=headers, document=content), model, place)

    def _request(self, method: str, place: Sequence[str], **content: Any) -> httpx.Response:
        """Repeats a call that is safe to repeat while the server asks for it or breaks off, for up to PATIENCE_SECONDS."""
        waited, broken = 0.0, 0
        while True:
            try:
                response = self._once(method, place, **content)
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
        place: Sequence[str],
        query: Mapping[str, Any] | None = None,
        headers: Mapping[str, str] | None = None,
        document: Mapping[str, Any] | None = None,
        content: bytes | None = None,
    ) -> httpx.Response:
        params = {name: value for name, value in (query or {}).items() if value is not None}
        try:
            return self._http.request(method, _path(*place), params=params, headers=headers, json=document, content=content)
        except (httpx.TransportError, httpx.InvalidURL) as error:
            raise unreachable(self.url, error) from error

    def _answer(self, response: httpx.Response, model: type[Answer], place: Sequence[str]) -> Answer:
        raise_for(response, *_named(place))
        try:
            return model.model_validate_json(response.content)
        except ValidationError as error:
            raise self._strange() from error

    def _strange(self) -> UnavailableError:
        return UnavailableError(f"{self.url} answers in a form that this drivecal does not know; are both of one version?")


def _path(*parts: str) -> str:
    return "/api/v1/" + "/".join(quote(part, safe="") for part in parts)


def _named(place: Sequence[str]) -> tuple[str, str]:
    """Returns the kind and the identifier of the object at a place; both empty for a list."""
    return (KINDS[place[0]], place[1]) if len(place) > 1 else ("", "")


def _pause(response: httpx.Response) -> float | None:
    """Returns the seconds after which the server wants to be asked again; None if it does not."""
    if response.status_code not in {HTTPStatus.TOO_MANY_REQUESTS, HTTPStatus.SERVICE_UNAVAILABLE}:
        return None
    given = response.headers.get("retry-after", "")
    return max(0.1, float(given)) if given.isascii() and given.isdecimal() and len(given) < 10 else None
