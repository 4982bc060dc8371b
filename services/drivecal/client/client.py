"""The client. One method per call of the API; answers are the contracts, errors are drivecal's own."""

import json
import re
import time
import uuid
import warnings
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from http import HTTPStatus
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import httpx
from pydantic import ValidationError

from drivecal.client.documents import Document, in_pieces, plain
from drivecal.client.following import READ_SECONDS, EventParser, Following, Sent, Told, displayed
from drivecal.client.frames import DownloadedTable, RankedSets, Rows
from drivecal.client.outside import AskTell
from drivecal.client.report import report_of
from drivecal.client.transport import Answer, Transport, harmless, named, path_of, raise_for, unreachable
from drivecal.configuration.settings import load_settings
from drivecal.contracts.campaign import (
    PROGRESS,
    Campaign,
    CampaignEvent,
    CampaignPage,
    CampaignProgress,
    ExpectedRuns,
    StudyPage,
)
from drivecal.contracts.comparison import Comparison, ExpectedComparison
from drivecal.contracts.evaluation import CellNumber, Evaluation, Explanation, SeriesAnswer
from drivecal.contracts.inventory import (
    InfluenceMapAnswer,
    InfluenceMapPage,
    ProblemAnswer,
    ProblemPage,
    ScenarioPage,
    WorkerPage,
)
from drivecal.contracts.outside.imported import ImportAnswer, ImportDeleted, StoredCells
from drivecal.contracts.outside.sets import AcceptedSets, AnswerPage, CancelledSet
from drivecal.contracts.results import CampaignResults, FrontSummary, ImportanceAnswer
from drivecal.contracts.setup import CampaignSetup
from drivecal.contracts.specification import Given
from drivecal.contracts.tables import FrontRow, ImportedRow, InfluenceRow, JudgedSet, RobustnessRow, TableName, ValidationRow
from drivecal.domain.errors import ConflictError, InvalidInputError, OverloadError, Problem, restated

if TYPE_CHECKING:
    from drivecal.configuration.problems import Pushed

Noted = TypeVar("Noted", AcceptedSets, ImportAnswer)
Action = Literal["pause", "resume", "cancel", "finish"]
Table = Literal[TableName, "front/evaluated"]


class Client(Transport):
    """A client of the server at `url`. Four or more first characters stand for the id of a campaign or an influence map.

    Every method raises UnavailableError if nothing answers, InvalidInputError if the server refuses the input, and NotAuthorisedError if
    the server does not know the `token` or requires one. NotFoundError and ConflictError are about the requested object.

    If the server is busy or its database is away, the client asks again after the time that it names, for up to 30 seconds. It only
    repeats calls that change nothing the second time.
    """

    def __init__(
        self,
        url: str | None = None,
        token: str | None = None,
        *,
        timeout: float = 30.0,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        """Connects to a server.

        Args:
            url: Address of the server; by default that of the settings, as on the command line.
            token: Token to send; by default that of the settings, and an empty one sends none.
            timeout: Seconds to wait for an answer.
            transport: Sends the requests in the place of a connection.
        """
        if url is None or token is None:
            settings = load_settings(url=url)
            url, token = settings.url, settings.token if token is None else token
        super().__init__(url, token, timeout, transport)

    def submit(self, specification: Document, key: str | None = None) -> Campaign:
        """Queues a campaign.

        Args:
            specification: A mapping, a model, or the path of a YAML or JSON file.
            key: Submitting again with the same key gives the same campaign; by default each submission has its own.
        """
        return self._post(Campaign, "campaigns", document=specification, key=key or uuid.uuid4().hex)

    def expected_runs(self, specification: Document) -> ExpectedRuns:
        """Checks a campaign without queueing it and returns its expected cost."""
        return self._post(ExpectedRuns, "campaigns", document=specification, validate_only="true")

    def compare(self, specification: Document, key: str | None = None) -> Comparison:
        """Queues the campaigns of a comparison of optimizers or reductions, which have its tag; with the same `key` only once."""
        return self._post(Comparison, "comparisons", document=specification, key=key or uuid.uuid4().hex)

    def expected_comparison(self, specification: Document) -> ExpectedComparison:
        """Checks a comparison without queueing it and returns its expected cost."""
        return self._post(ExpectedComparison, "comparisons", document=specification, validate_only="true")

    def comparison(self, tag: str) -> Comparison:
        """Compares the campaigns with a tag, as far as they are."""
        return self._get(Comparison, "comparisons", tag)

    def campaign(self, identifier: str) -> Campaign:
        """Returns a campaign."""
        return self._get(Campaign, "campaigns", identifier)

    def watch(
        self, identifier: str, deadline: float | None = None, told: Told | None = None, *, from_beginning: bool = True
    ) -> Iterator[Campaign]:
        """Yields the campaign now and after each change until it has ended. Tolerates a restart of the server.

        Args:
            identifier: Id of the campaign.
            deadline: Moment of the monotonic clock after which TimeoutError is raised.
            told: Is called with each event.
            from_beginning: `told` also gets the events before this call.
        """
        return iter(Following(self.campaign_unless, self.events, identifier, deadline, told, tells=from_beginning))

    def wait(self, identifier: str, timeout: float | None = None, *, progress: bool = True) -> Campaign:
        """Returns the campaign once it has ended.

        Args:
            identifier: Id of the campaign.
            timeout: Seconds after which TimeoutError is raised; the campaign continues.
            progress: A notebook displays the campaign meanwhile.
        """
        deadline = None if timeout is None else time.monotonic() + timeout
        states = self.watch(identifier, deadline, from_beginning=False)
        return deque(displayed(states) if progress else states, maxlen=1)[0]  # the states before need no memory

    def campaign_unless(self, identifier: str, etag: str) -> tuple[Campaign | None, str, float | None]:
        """Returns the campaign, None if its ETag is still `etag`; its ETag; the seconds to wait before the next request."""
        place, headers = ("campaigns", identifier), {"If-None-Match": etag} if etag else {}
        response = self._request("GET", place, headers=headers, again=not etag)  # later, `Following` has a patience of its own
        raise_for(response, *named(place))
        wait = float(response.headers["retry-after"]) if "retry-after" in response.headers else None
        if response.status_code == HTTPStatus.NOT_MODIFIED:
            return None, etag, wait
        return self._answer(response, Campaign, place), response.headers.get("etag", ""), wait

    def events(self, identifier: str, last_id: int | None = None) -> Iterator[Sent]:
        """Yields the events of a campaign; None is a sign of life. The stream ends when the campaign has ended or the server stops.

        Args:
            identifier: Id of the campaign.
            last_id: Id of the last known event; by default the stream begins with the first event.

        Raises:
            OverloadError: The server has no place for a stream.
        """
        headers = {"Accept": "text/event-stream"} | ({} if last_id is None else {"Last-Event-ID": str(last_id)})
        timeout = httpx.Timeout(self._http.timeout.connect, read=READ_SECONDS)
        path = path_of(("campaigns", identifier, "events"))
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
        except httpx.RequestError as error:
            raise unreachable(self.url, error) from error

    def _sent(self, event: Mapping[str, str]) -> Sent:
        try:
            data = harmless(event["data"].encode())
            if event.get("event") == PROGRESS:
                return CampaignProgress.model_validate_json(data)
            return CampaignEvent.model_validate({**json.loads(data), "id": event.get("id")})
        except (TypeError, ValueError) as error:
            raise self._strange() from error

    def act(self, identifier: str, action: Action) -> Campaign:
        """Asks for a campaign to be paused, resumed, cancelled or, with an external optimizer, finished. Asking twice is no error."""
        return self._post(Campaign, "campaigns", identifier, action)

    def ask_tell(self, specification: Document | None = None, *, resume: str | None = None) -> AskTell:
        """Begins a campaign that evaluates the sets of an optimizer of yours.

        Args:
            specification: The campaign; its `optimizer` is `{kind: external}` unless it says more.
            resume: Id of an open campaign to go on with, in the place of a specification.
        """
        if resume is not None:
            campaign = self.campaign(resume)
            if (campaign.spec.get("optimizer") or {}).get("kind") != "external":
                raise ConflictError(f"campaign {campaign.id} proposes its sets itself; resume another one")
            return AskTell(self, campaign)
        document = dict(plain({} if specification is None else specification))
        if isinstance(given := document.get("optimizer") or {}, Mapping):
            document["optimizer"] = {"kind": "external"} | dict(given)
            if (kind := document["optimizer"]["kind"]) != "external":
                raise InvalidInputError(Problem("optimizer.kind", f"{kind} proposes its sets itself", "leave it out"))
        return AskTell(self, self.submit(document))

    def propose(self, identifier: str, sets: Sequence[Mapping[str, Any]]) -> AcceptedSets:
        """Sends up to 1,000 sets to a campaign with an external optimizer: `{"key": "a1", "parameters": {...}}`. Once per key."""
        return _noted(self._call(AcceptedSets, "POST", "campaigns", identifier, "sets", document={"sets": list(sets)}))

    def answers(self, identifier: str, after: int = 0, wait: float = 0.0) -> AnswerPage:
        """Returns the answers of proposed sets after a number, by cell; waits for one if there is none yet.

        Args:
            identifier: Id of the campaign.
            after: `last` of the answers before.
            wait: Seconds to wait, at most two thirds of the client's time limit.
        """
        limit = self._http.timeout.read
        seconds = wait if limit is None else min(wait, 2 / 3 * limit)
        return self._get(AnswerPage, "campaigns", identifier, "answers", after=after, wait=seconds)

    def cancel_set(self, identifier: str, key: str) -> CancelledSet:
        """Cancels a proposed set, unless its cells were asked for already."""
        return self._call(CancelledSet, "DELETE", "campaigns", identifier, "sets", key)

    def rerun(self, identifier: str, changes: Document, key: str | None = None) -> Campaign:
        """Queues a new campaign on the references and the influence map of an ended one.

        Args:
            identifier: Id of the ended campaign.
            changes: Changes of its specification; a mapping without weights keeps its weights.
            key: Submitting again with the same key gives the same campaign.
        """
        if isinstance(changes, Mapping) and "weights" not in changes:
            changes = {"weights": self.campaign(identifier).spec.get("weights", {}), **changes}
        return self._post(Campaign, "campaigns", identifier, "rerun", document=changes, key=key or uuid.uuid4().hex)

    def solutions(
        self,
        identifier: str,
        weights: Mapping[str, float] | str | None = None,
        limit: int | None = None,
        score: str | None = None,
        variant: str | None = None,
    ) -> RankedSets:
        """Returns the best parameter sets; the `items` of the answer are its rows.

        Args:
            identifier: Id of the campaign.
            weights: Weights of the scenarios, `{"S1": 2, "S2": 1}` or `S1=2,S2=1`; by default the campaign's.
            limit: Largest number of sets.
            score: Another score of the problem, or `NAME@PUSH`: a score that another push declares.
            variant: A variant of the campaign, for which sets are ranked.
        """
        query = {"weights": weights, "limit": limit, "score": score, "variant": variant}
        return self._get(RankedSets, "campaigns", identifier, "solutions", **query)

    def evaluations(self, identifier: str, **query: Any) -> DownloadedTable:
        """Returns every requested cell of a campaign. `where`: conditions as in the REST API, e.g. `where=["scenario=S1", "P1>=0.5"]`."""
        return self.frame(identifier, "evaluations", **query)

    def frame(self, identifier: str, table: Table, **query: Any) -> DownloadedTable:
        """Returns a whole table of a campaign, for pandas, polars or Arrow; with `where`, a list of conditions, only some rows."""
        return DownloadedTable(b"".join(self.table(identifier, table, "parquet", **query)))

    def table(self, identifier: str, table: Table, form: Literal["csv", "parquet"], **query: Any) -> Iterator[bytes]:
        """Yields a whole table in pieces as they arrive.

        Args:
            identifier: Id of the campaign.
            table: Name of the table.
            form: Format of the file.
            query: Parameters of the REST call, e.g. `where=["scenario=S1"]`.
        """
        place = ("campaigns", identifier, *table.split("/"))
        yield from self._pieces(path_of(place), query | {"format": form}, *named(place))

    def rows(self, identifier: str, table: Table, **query: Any) -> Iterator[dict[str, Any]]:
        """Yields every row of a table."""
        return self._listed(("campaigns", identifier, *table.split("/")), **query)

    def _listed(self, place: Sequence[str], **query: Any) -> Iterator[dict[str, Any]]:
        """Yields the items of all pages of a list."""
        cursor: str | None = None
        while True:
            response = self._request("GET", place, query={"limit": 1000, **query, "cursor": cursor})
            raise_for(response, *named(place))
            try:
                page = json.loads(harmless(response.content))
                items, cursor = page["items"], page["next_cursor"]
            except (ValueError, TypeError, KeyError) as error:
                raise self._strange() from error
            yield from items
            if cursor is None:
                return

    def influence(self, identifier: str) -> Rows[InfluenceRow]:
        """Returns the rows of the influence map that a campaign uses, empty without a map."""
        return self._rows_of(identifier, "influence", InfluenceRow)

    def importance(self, identifier: str, **query: Any) -> ImportanceAnswer:
        """Returns how much the objective depends on each parameter among the sets of a search, or with `scenario` the score there. `query`:
        `scenario`, `weights`, `score` and `variant` as in the REST API."""
        return self._get(ImportanceAnswer, "campaigns", identifier, "importance", **query)

    def front(self, identifier: str, weights: Mapping[str, float] | str | None = None) -> Rows[FrontRow]:
        """Returns the sets that no other set dominates.

        Args:
            identifier: Id of the campaign.
            weights: Weights of the objectives, for the order of the sets.
        """
        return self._rows_of(identifier, "front", FrontRow, weights=weights)

    def front_summary(self, identifier: str, weights: Mapping[str, float] | str | None = None) -> FrontSummary:
        """Returns the objectives, knee, extremes and growth of a front, with ranks as `front` has them."""
        return self._get(FrontSummary, "campaigns", identifier, "front", "summary", weights=weights)

    def evaluated_sets(self, identifier: str) -> Rows[JudgedSet]:
        """Returns all sets that have a value of every objective, dominated ones as well."""
        return self._rows_of(identifier, "front/evaluated", JudgedSet)

    def setup(self, identifier: str) -> CampaignSetup:
        """Returns a campaign's setup: parameters, versions, fingerprints."""
        return self._get(CampaignSetup, "campaigns", identifier, "setup")

    def studies(self, identifier: str) -> StudyPage:
        """Returns the robustness and validation studies of a campaign's best sets and map, made by any campaign."""
        return self._get(StudyPage, "campaigns", identifier, "studies")

    def robustness(self, identifier: str) -> Rows[RobustnessRow]:
        """Returns the examined sets of a campaign, most robust first; empty before the robustness stage."""
        return self._rows_of(identifier, "robustness", RobustnessRow)

    def validation(self, identifier: str) -> Rows[ValidationRow]:
        """Returns the validation of a campaign's map by scenario; empty before that stage."""
        return self._rows_of(identifier, "validation", ValidationRow)

    def _rows_of(self, identifier: str, table: Table, model: type[Answer], **query: Any) -> Rows[Answer]:
        return self._checked_rows(model, ("campaigns", identifier, *table.split("/")), **query)

    def _checked_rows(self, model: type[Answer], place: Sequence[str], **query: Any) -> Rows[Answer]:
        try:
            return Rows(model, (model.model_validate(row) for row in self._listed(place, **query)))
        except ValidationError as error:
            raise self._strange() from error

    def results(self, identifier: str, place: tuple[int, int] | None = None) -> CampaignResults:
        """Returns the results of a campaign: what was asked for, what is best, verdicts on it, and what it cost. The verdicts are about the
        best set, or about the set at a `place`, its iteration and individual."""
        iteration, individual = (None, None) if place is None else place
        return self._get(CampaignResults, "campaigns", identifier, "results", iteration=iteration, individual=individual)

    def explanation(self, evaluation: str) -> Explanation:
        """Returns why a cell was, or was not, answered without a simulation. `evaluation`: its number in the table `evaluations`."""
        return self._get(Explanation, "evaluations", evaluation, "explain")

    def evaluate(self, specification: Document, key: str | None = None) -> Evaluation:
        """Queues the evaluation of one parameter set."""
        return self._post(Evaluation, "evaluations", document=specification, key=key or uuid.uuid4().hex)

    def look_up(self, sets: Sequence[Mapping[str, Given]], **where: Any) -> StoredCells:
        """Returns the stored results of up to 10,000 cells; nothing is simulated.

        Args:
            sets: Parameter sets, each wanted in all scenarios.
            where: `problem`, `catalogue`, `driving_function`, `vehicle` and `evaluator`, as of an evaluation.
        """
        return self._call(StoredCells, "POST", "results", "lookup", document={"sets": list(sets), **where})

    def import_results(
        self, rows: Sequence[Mapping[str, Any]], *, problem: str, source: str, date: str, units: Mapping[str, str] | None = None
    ) -> int:
        """Stores results from elsewhere, which are compared with simulations and answer no cell. Returns how many cells are new.

        Args:
            rows: Mappings with `parameters`, `scenario`, and `scores` or `measures` (`client.imported.read_results` reads files).
            problem: Name of the problem.
            source: Name of the vehicle, test bench or tool.
            date: Day of the results, YYYY-MM-DD.
            units: Units of parameters and measures, refused if the problem has others.
        """
        head = {"problem": problem, "source": source, "date": str(date), "units": dict(units or {})}
        stored = first = 0
        for piece in in_pieces(list(rows)):
            with restated(partial(_moved, first)):
                stored += _noted(self._call(ImportAnswer, "POST", "results", document={**head, "rows": list(piece)})).stored
            first += len(piece)
        return stored

    def imported(self, problem: str, source: str | None = None) -> list[ImportedRow]:
        """Returns a problem's results from elsewhere, all or from one source, with the stored simulations of the same sets."""
        return self._checked_rows(ImportedRow, ("results",), problem=problem, source=source)

    def delete_imported(self, problem: str, source: str) -> int:
        """Deletes the results of a source from elsewhere, and returns how many cells that were."""
        return self._call(ImportDeleted, "DELETE", "results", query={"problem": problem, "source": source}).deleted

    def evaluation(self, identifier: str) -> Evaluation:
        """Returns a single evaluation by the id that `evaluate` returned."""
        if str(identifier).isdecimal() and len(str(identifier)) < 32:
            raise InvalidInputError(Problem("identifier", "it is the number of a row", "give the id that `evaluate` returned"))
        return self._get(Evaluation, "evaluations", identifier)

    def cell(self, identifier: str, iteration: int, individual: int, scenario: str) -> int:
        """Returns the number of the evaluation behind the score of a set in a scenario, of several seeds of the first that reports it.

        Args:
            identifier: Id of the campaign.
            iteration: Iteration of the set, from 0.
            individual: Place of the set in its iteration, from 0.
            scenario: Name of the scenario.
        """
        query = {"iteration": iteration, "individual": individual, "scenario": scenario}
        return self._get(CellNumber, "campaigns", identifier, "cell", **query).evaluation

    def trace(self, evaluation: str) -> SeriesAnswer | None:
        """Returns the time series of an evaluation, None while they are being made.

        `evaluation`: its number, or the id of a single evaluation in one scenario.
        """
        place = ("evaluations", evaluation, "trace")
        response = self._request("GET", place)
        if response.status_code == HTTPStatus.ACCEPTED:
            return None
        return self._answer(response, SeriesAnswer, place)

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

    def push_problem(self, problem: "Pushed") -> ProblemAnswer:
        """Stores a problem: a folder with `problem.yaml`, or an archive of one. Takes a token of an author, or the server's own user."""
        from drivecal.configuration.problems import archive_of, push_headers  # what checks problems takes a second to import

        archive = archive_of(problem)
        headers = push_headers(archive, signed="Authorization" not in self._http.headers)
        return self._call(ProblemAnswer, "POST", "problems", headers=headers, content=archive)

    def problems(self, name: str | None = None, limit: int | None = None, cursor: str | None = None) -> ProblemPage:
        """Returns a page of problems, last pushed first: each name once, or every push of one `name`."""
        return self._get(ProblemPage, "problems", name=name, limit=limit, cursor=cursor)

    def problem(self, name: str) -> ProblemAnswer:
        """Returns a problem by its name or digest."""
        return self._get(ProblemAnswer, "problems", name)

    def scenarios(self) -> ScenarioPage:
        """Returns the scenarios of all catalogues of the server."""
        return self._get(ScenarioPage, "scenarios")

    def workers(self, minutes: int = 0) -> WorkerPage:
        """Returns the workers, and what they did in the last `minutes`, at most 60."""
        return self._get(WorkerPage, "workers", minutes=minutes or None)

    def campaigns(
        self, state: str | None = None, limit: int | None = None, cursor: str | None = None, *, tags: Sequence[str] = ()
    ) -> CampaignPage:
        """Returns a page of campaigns, newest first.

        Args:
            state: Only campaigns in this state.
            limit: Largest number of campaigns.
            cursor: `next_cursor` of the page before.
            tags: Only campaigns with all of these tags.
        """
        return self._get(CampaignPage, "campaigns", state=state, limit=limit, cursor=cursor, tag=list(tags) or None)

    def label(self, identifier: str, **changes: Any) -> Campaign:
        """Changes the labels of a campaign that are given: `name`, `tags` (all of them), `add_tags`, `remove_tags`."""
        document = {label: value for label, value in changes.items() if value is not None}
        return self._call(Campaign, "PATCH", "campaigns", identifier, document=document)

    def delete(self, identifier: str) -> None:
        """Deletes an ended campaign; what it simulated stays in the reference table.

        Raises ConflictError while it runs, and while other campaigns refer to it.
        """
        whole = identifier if len(identifier) >= 32 else self.campaign(identifier).id  # asked again, no part of it names it
        raise_for(self._request("DELETE", ("campaigns", whole)), "campaign", whole)

    def report(self, identifier: str) -> bytes:
        """Returns the page with a campaign's results in it, which needs no server: one HTML file.

        Raises ConflictError for a single evaluation, and if the server has no page.
        """
        campaign = self.campaign(identifier)
        return report_of(lambda path: b"".join(self._pieces(path, {}, "campaign", campaign.id)).decode(), campaign)

    def calibration_file(
        self,
        identifier: str,
        form: Literal["dcm", "cdfx", "csv"],
        rank: int | None = None,
        front: int | None = None,
        weights: Mapping[str, float] | str | None = None,
        score: str | None = None,
        labels: Mapping[str, str] | None = None,
        base: Path | None = None,
        variant: str | None = None,
    ) -> bytes:
        """Returns a set as a calibration file.

        Args:
            identifier: Id of the campaign.
            form: Format of the file.
            rank: Rank of the set in the solutions, by default the first.
            front: Rank of the set on the front, by default the first.
            weights: Weights under which the rank counts.
            score: Score under which the rank counts.
            labels: Names in the file, by parameter; others keep their own.
            base: A DCM or CDFX whose other content is kept, or an A2L that has the kinds of axes.
            variant: Variant for which the rank counts.
        """
        place = ("campaigns", identifier, "calibration-file")
        listed = [f"{name}={label}" for name, label in (labels or {}).items()]
        chosen_by = {"set": rank, "front": front, "weights": weights, "score": score, "variant": variant}
        query = {"format": "dcm" if base is not None and form == "csv" else form, **chosen_by, "label": listed or None}
        response = self._request("GET", place, query=query)
        raise_for(response, *named(place))
        self._refuse_page(response)
        if base is None:
            return response.content
        from drivecal.calibration_data import files  # half of a start of the command line, which few commands need
        from drivecal.calibration_data.carried import carried
        from drivecal.calibration_data.sections import axis_points

        chosen = files.read(response.content, f"set.{query['format']}").characteristics
        searched = {(labels or {}).get(name, name) for name in self.setup(identifier).shapes}
        chosen += [each for each in axis_points(chosen) if each.name in searched]
        return carried(base, form, chosen, response.content)


def _noted(answer: Noted) -> Noted:
    for note in answer.notes:
        warnings.warn(note, stacklevel=3)
    return answer


def _moved(first: int, given: Problem) -> Problem:
    """Returns a fault in a later piece of rows with the number of its row among all."""
    field = re.sub(r"^rows\[(\d+)\]", lambda row: f"rows[{int(row[1]) + first}]", given.field)
    return Problem(field, given.message, f"{given.remedy} (the first {first:,} rows are stored)" if first else given.remedy)
