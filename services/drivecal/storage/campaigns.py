"""Campaigns: submitted by the API, run by the dispatcher."""

import json
import re
import uuid
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import datetime
from typing import Any, Literal

from sqlalchemy import (
    JSON,
    ColumnElement,
    Connection,
    Dialect,
    Label,
    Row,
    Select,
    SmallInteger,
    Text,
    Update,
    bindparam,
    case,
    cast,
    func,
    literal,
    select,
    text,
    type_coerce,
    update,
)
from sqlalchemy.types import TypeDecorator

from drivecal.contracts.campaign import Baseline, Best, CellCounts, Confirmation, ErrorRate, Progress, Released, SearchState
from drivecal.contracts.specification import CampaignChanges
from drivecal.domain.campaigns import Action, CampaignState, StageName
from drivecal.domain.campaigns import change as change_by
from drivecal.domain.errors import InvalidInputError, NotFoundError, Problem
from drivecal.domain.events import EventKind
from drivecal.storage import admission, events, leases
from drivecal.storage.engine.bulk import insert as insert_into
from drivecal.storage.engine.bulk import rows_among
from drivecal.storage.engine.records import identified, page_by, record
from drivecal.storage.engine.tables import campaign_stages, campaigns
from drivecal.storage.engine.types import STAGES, now
from drivecal.storage.references import runs

CountsByStage = Mapping[StageName, Mapping[str, int]]


class _ByStage(TypeDecorator[dict[StageName, dict[str, int]]]):
    """Cell counts by stage, for stages that have begun, in their order, from the members of a JSON object."""

    impl = Text
    cache_ok = True

    def process_result_value(self, value: Any, *_: Dialect) -> dict[StageName, dict[str, int]]:
        document = json.loads(f"{{{value or ''}}}")
        return {STAGES[number]: document[str(number)] for number in sorted(map(int, document))}


def by_stage() -> Label[dict[StageName, dict[str, int]]]:
    """Returns the column `stages` of a query over the campaigns: their counts by stage."""
    number, cells = (
        cast(type_coerce(campaign_stages.c[name], kind), Text) for name, kind in (("stage", SmallInteger), ("cells", JSON))
    )
    members = type_coerce(func.aggregate_strings(literal('"') + number + literal('":') + cells, ","), _ByStage())
    query = select(members).where(campaign_stages.c.campaign_sequence == campaigns.c.sequence)
    return query.correlate(campaigns).scalar_subquery().label("stages")


def save_counts(connection: Connection, campaign_sequence: int, cells: Mapping[StageName, CellCounts]) -> None:
    """Replaces the counts of some stages of a campaign."""
    rows = [{"campaign_sequence": campaign_sequence, "stage": stage, "cells": each} for stage, each in cells.items()]
    if not rows:  # a comparison whose runs have requested nothing yet
        return
    statement = insert_into(connection, campaign_stages)
    replaced = {"cells": statement.excluded.cells}
    connection.execute(statement.on_conflict_do_update(index_elements=["campaign_sequence", "stage"], set_=replaced), rows)


Kind = Literal["calibration", "evaluation"]
MOST_TAGS = 20
LONGEST_LISTED = 20_000
"""Longest specification in a list, characters: a page of a thousand campaigns has at most 20 MB instead of a GB."""


@dataclass(frozen=True, slots=True)
class CampaignHeading:
    """A campaign's identity, state and requested action, which the dispatcher reads several times a second."""

    sequence: int
    id: str
    kind: Kind
    name: str
    state: CampaignState
    requested_action: Action | None
    priority: int
    """Higher priorities run first; equal ones share the workers."""


@dataclass(frozen=True, slots=True)
class StoredCampaign(CampaignHeading):
    """A row of the table of campaigns."""

    revision: int
    """Grows with every change of the row."""
    stage: StageName | None
    iteration: int | None
    spec: Mapping[str, Any]
    """The specification with its defaults filled in; empty if it is too long for a `page`."""
    resolution: Mapping[str, Any] | None
    """Setups, evaluator, scale, space, weights and goals, which do not change after the first start."""
    rerun_of: str | None
    influence_map_id: str | None
    watermark: int | None
    """The id of the newest run that it may take its references from, set when it starts; 0 of an isolated campaign."""
    degraded: str | None
    waiting: str | None
    """Why it waits to be started, or some of its cells for something else than their turn."""
    owner: str | None
    """Name of the token that submitted it; None without tokens."""
    error: str | None
    notes: tuple[str, ...]
    stages: CountsByStage
    """Cells by outcome of the stages that have begun."""
    progress: Progress
    error_rate: Mapping[str, ErrorRate]
    released: Mapping[str, Released]
    best: Best | None
    search: SearchState | None
    confirmation: Confirmation | None
    baseline: Baseline | None
    simulating_seconds: float
    created_at: datetime
    started_at: datetime | None
    ended_at: datetime | None
    tags: tuple[str, ...]
    deleted_at: datetime | None
    finish_at: datetime | None
    """The moment at which an outside optimizer said that it proposes no more sets."""

    @property
    def cells(self) -> CellCounts:
        """The counts of the calibration, or of a single evaluation."""
        return self.counts(StageName.CALIBRATION)

    def counts(self, stage: StageName) -> CellCounts:
        """The counts of a stage, zeros if it has not begun."""
        return CellCounts(**self.stages.get(stage, {}))


_PROGRESS = (
    *("stage", "iteration", "progress", "simulating_seconds", "notes"),
    *("error_rate", "released", "best", "search", "confirmation", "baseline"),
)
"""Columns that a campaign's stages write."""
_SELECT = select(campaigns, by_stage())
_BY_ID = _SELECT.where(campaigns.c.id == bindparam("identifier"))
_BY_SEQUENCE = _SELECT.where(campaigns.c.sequence == bindparam("number"))


def insert(
    connection: Connection,
    *,
    name: str,
    spec: Mapping[str, Any],
    kind: Kind = "calibration",
    influence_map_id: str | None = None,
    rerun_of: str | None = None,
    tags: Sequence[str] = (),
    idempotency_key: str | None = None,
    body_digest: str | None = None,
    likeness: str | None = None,
    priority: int = 0,
    owner: str | None = None,
    notes: Sequence[str] = (),
) -> StoredCampaign:
    """Queues a campaign, or returns the campaign that an earlier request with the same `idempotency_key` queued.

    `body_digest` identifies the request by all that tells requests apart, the path included; `likeness` campaigns that search the same.

    Raises ConflictError if the earlier request was another one.
    """
    row: dict[str, Any] = {
        "id": uuid.uuid4().hex,
        "kind": kind,
        "name": name,
        "state": CampaignState.QUEUED,
        "priority": priority,
        "owner": owner,
        "spec": dict(spec),
        "rerun_of": rerun_of,
        "tags": tuple(tags),
        "watermark": 0 if (spec.get("reduction") or {}).get("isolated") else None,
        "influence_map_id": influence_map_id,
        **{f"{stage}_of": (spec.get(stage) or {}).get("of") for stage in ("robustness", "validation")},
        "idempotency_key": idempotency_key,
        "body_digest": body_digest,
        "likeness": likeness,
        "notes": tuple(notes),
        "progress": Progress(),
        "error_rate": {},
        "released": {},
        "simulating_seconds": 0.0,
        "created_at": now(),
    }
    statement = insert_into(connection, campaigns).on_conflict_do_nothing(index_elements=["idempotency_key"])
    inserted = connection.scalar(statement.values(row).returning(campaigns.c.sequence))
    if inserted is not None:
        queued = by_sequence(connection, inserted)
        events.add(connection, queued.sequence, EventKind.QUEUED, {"state": CampaignState.QUEUED, "name": name})
        for note in notes:
            events.add(connection, queued.sequence, EventKind.NOTE, {"text": note})
        return queued
    earlier = admission.earlier(connection, body_digest, idempotency_key)
    if earlier is None:
        raise AssertionError("a campaign conflicts with nothing but one of the same key")
    return by_sequence(connection, earlier)


def get(connection: Connection, campaign_id: str, *, lock: bool = False, deleted: bool = False) -> StoredCampaign:
    """A campaign by its id or its first characters, deleted ones on request and by their whole id; `lock`: until the transaction ends.

    Raises NotFoundError.
    """
    query = _BY_ID if deleted else _BY_ID.where(campaigns.c.deleted_at.is_(None))
    query = query.with_for_update(of=campaigns) if lock else query
    return _campaign(identified(connection, query, "campaign", campaign_id, IDS))


def by_sequence(connection: Connection, sequence: int) -> StoredCampaign:
    """A campaign by its number. Raises NotFoundError."""
    row = connection.execute(_BY_SEQUENCE, {"number": sequence}).one_or_none()
    if row is None:
        raise NotFoundError("campaign", str(sequence))
    return _campaign(row)


def page(
    connection: Connection,
    *,
    state: CampaignState | None = None,
    limit: int = 50,
    cursor: str | None = None,
    conditions: Sequence[ColumnElement[bool]] = (),
) -> tuple[list[StoredCampaign], str | None]:
    """At most `limit` campaigns, newest first, and the cursor of the next page (None on the last). Raises InvalidInputError.

    Specifications longer than LONGEST_LISTED characters are not read (only many start sets are so long): `get` returns them.
    """
    short = case((func.length(cast(campaigns.c.spec, Text)) <= LONGEST_LISTED, campaigns.c.spec)).label("spec")
    columns = [short if column is campaigns.c.spec else column for column in campaigns.c] + [by_stage()]
    rows, following = page_by(connection, listed(columns, state, conditions), campaigns.c.sequence, limit, cursor)
    return [_campaign(row) for row in rows], following


def listed(
    columns: Iterable[ColumnElement[Any]], state: CampaignState | None, conditions: Sequence[ColumnElement[bool]] = ()
) -> Select[Any]:
    """Returns the query of these columns of campaigns, without deleted ones and single evaluations; those asked to cancel count as
    cancelling."""
    # Spelt as the condition of the index `ix_campaigns_listed`: no backend takes the index for a condition with a parameter.
    query = select(*columns).where(campaigns.c.kind != text("'evaluation'"), campaigns.c.deleted_at.is_(None), *conditions)
    asked = campaigns.c.requested_action.is_not_distinct_from("cancel") & campaigns.c.ended_at.is_(None)
    if state is CampaignState.CANCELLING:
        return query.where((campaigns.c.state == state) | asked)
    return query if state is None else query.where(campaigns.c.state == state, ~asked)


IDS = listed([campaigns.c.id], None)
"""The ids of campaigns, which may be abbreviated. A single evaluation needs its whole id."""


def change_labels(connection: Connection, campaign_id: str, new: CampaignChanges) -> StoredCampaign:
    """Changes labels, and returns the campaign. Of tags that are added and removed, none stays. The same labels again change nothing.

    Raises NotFoundError, and InvalidInputError for too many tags.
    """
    before = get(connection, campaign_id, lock=True)
    name = before.name if new.name is None else new.name
    tags = {*(before.tags if new.tags is None else new.tags), *(new.add_tags or ())} - {*(new.remove_tags or ())}
    if len(tags) > max(MOST_TAGS, len(before.tags)):
        remedy = f"a campaign has at most {MOST_TAGS}; remove some of {sorted(before.tags)}"
        raise InvalidInputError(Problem("add_tags", f"the campaign would have {len(tags)} tags", remedy))
    if (name, tags) == (before.name, {*before.tags}):
        return before
    connection.execute(_of(before.sequence).values(name=name, tags=tuple(sorted(tags))))
    return by_sequence(connection, before.sequence)


def having(tags: Sequence[str]) -> list[ColumnElement[bool]]:
    """Returns the conditions of a list of the campaigns with all of the `tags`."""
    stored = func.replace(cast(campaigns.c.tags, Text), r"\"", ",")  # a quote within a tag begins no other tag
    # LIKE would ignore case on SQLite
    return [func.replace(stored, json.dumps(tag).replace(r"\"", ","), "") != stored for tag in tags]


def named(connection: Connection, sequences: Collection[int]) -> dict[int, tuple[str, str]]:
    """Returns ids and names of campaigns, by number."""
    query = select(campaigns.c.sequence, campaigns.c.id, campaigns.c.name)
    return {row.sequence: (row.id, row.name) for row in rows_among(connection, query, campaigns.c.sequence, sorted(sequences))}


def active(connection: Connection) -> list[CampaignHeading]:
    """Returns the campaigns that have not ended, in starting order."""
    states = [state for state in CampaignState if not state.ended]
    columns = [campaigns.c[field.name] for field in fields(CampaignHeading)]
    query = select(*columns).where(campaigns.c.ended_at.is_(None), campaigns.c.state.in_(states))
    rows = connection.execute(query.order_by(campaigns.c.priority.desc(), campaigns.c.sequence))
    return [record(CampaignHeading, row, state=CampaignState(row.state)) for row in rows]


def request_action(connection: Connection, campaign_id: str, action: Action) -> StoredCampaign:
    """Asks the dispatcher to cancel, pause or resume a campaign; what has not started changes at once. Idempotent.

    Gives the campaign as it is then. Raises NotFoundError, and ConflictError for what has ended or is about to be cancelled.
    """
    campaign = get(connection, campaign_id, lock=True)
    asked = campaign.requested_action
    change = change_by(campaign.id, campaign.state, asked, action, has_started=campaign.started_at is not None, now=now())
    if change is None:
        return campaign
    kind, changes = change
    connection.execute(_of(campaign.sequence).values(changes))
    changed = by_sequence(connection, campaign.sequence)
    state = CampaignState.CANCELLING if kind is EventKind.CANCELLING else changed.state
    if state.ended:
        _forget_leases(connection, changed)
    events.add(connection, campaign.sequence, kind, {"state": state})
    return changed


_CARRIED_OUT: dict[Action, tuple[CampaignState, dict[str, Any]]] = {
    "cancel": (CampaignState.RUNNING, {"state": CampaignState.CANCELLING}),
    "pause": (CampaignState.RUNNING, {"state": CampaignState.PAUSED, "degraded": None}),
    "resume": (CampaignState.PAUSED, {"state": CampaignState.RUNNING}),
}


def carry_out(connection: Connection, sequence: int, action: Action) -> bool:
    """Changes the state as requested, a cancel to `cancelling`; False if the request was withdrawn or replaced by another one."""
    expected, changes = _CARRIED_OUT[action]
    asked = campaigns.c.requested_action == action
    changed = _change(connection, sequence, [expected], asked, **changes, requested_action=None)
    if changed and action != "cancel":  # whose event was recorded when it was asked for
        kind = EventKind.PAUSED if action == "pause" else EventKind.RESUMED
        events.add(connection, sequence, kind, {"state": changes["state"]})
    return changed


def start(connection: Connection, sequence: int) -> StoredCampaign | None:
    """Takes a queued campaign up: it is running, with its watermark. While another campaign searches the same, it has the watermark of that
    one, so that both see the same stored results. None if it is not queued any more."""
    here = select(campaigns.c.likeness).where(campaigns.c.sequence == sequence).scalar_subquery()
    running = campaigns.c.started_at.is_not(None) & campaigns.c.ended_at.is_(None) & (campaigns.c.likeness == here)
    beside = connection.scalar(select(campaigns.c.watermark).where(running).order_by(campaigns.c.sequence).limit(1))
    watermark = func.coalesce(campaigns.c.watermark, beside, runs.largest_id(connection))
    started = {"state": CampaignState.RUNNING, "started_at": now(), "watermark": watermark}
    if not _change(connection, sequence, [CampaignState.QUEUED], **started):
        return None
    events.add(connection, sequence, EventKind.RUNNING, {"state": CampaignState.RUNNING})
    return by_sequence(connection, sequence)


def first_watermark(connection: Connection, sequence: int) -> int:
    """Returns the watermark of the first campaign that searched the same as a started campaign, or its own."""
    here = select(campaigns.c.likeness).where(campaigns.c.sequence == sequence).scalar_subquery()
    alike = (campaigns.c.likeness == here) | (campaigns.c.sequence == sequence)
    query = select(campaigns.c.watermark).where(alike, campaigns.c.watermark.is_not(None), campaigns.c.sequence <= sequence)
    return int(connection.scalar(query.order_by(campaigns.c.sequence).limit(1)) or 0)


def save_progress(connection: Connection, campaign: StoredCampaign, cells: Mapping[StageName, CellCounts]) -> None:
    """Writes the progress of a campaign, and its counts of some stages."""
    connection.execute(_of(campaign.sequence).values({name: getattr(campaign, name) for name in _PROGRESS}))
    save_counts(connection, campaign.sequence, cells)


def set_resolution(connection: Connection, sequence: int, resolution: Mapping[str, Any]) -> None:
    """Stores `StoredCampaign.resolution`."""
    connection.execute(_of(sequence).values(resolution=dict(resolution)))


def set_influence_map(connection: Connection, sequence: int, influence_map_id: str) -> None:
    """Stores the map that a campaign's own analysis made."""
    connection.execute(_of(sequence).values(influence_map_id=influence_map_id))


_STARTS = re.compile(r"worker-[\d.]+|process \d+")
"""Each attempt to start a worker has numbers of its own: they are no news."""


def degrade(connection: Connection, sequences: Collection[int], reason: str | None) -> None:
    """Stores why running campaigns are slow or stand still for now; None if they are not. Leaves campaigns alone that ended meanwhile."""
    if not sequences:
        return
    works = campaigns.c.state.in_([CampaignState.RUNNING, CampaignState.CANCELLING])  # checked again after a wait for the row
    changed = works & campaigns.c.sequence.in_(list(sequences)) & campaigns.c.degraded.is_distinct_from(reason)
    statement = update(campaigns).where(changed).values(degraded=reason, revision=campaigns.c.revision + 1)
    before = dict(connection.execute(select(campaigns.c.sequence, campaigns.c.degraded).where(changed)).all())
    for sequence in sorted(connection.execute(statement.returning(campaigns.c.sequence)).scalars()):
        if reason is None:
            events.add(connection, sequence, EventKind.RECOVERED)
        elif _STARTS.sub("", before.get(sequence) or "") != _STARTS.sub("", reason):
            events.add(connection, sequence, EventKind.DEGRADED, {"reason": reason})


def stall(connection: Connection, sequence: int, minutes: int, reason: str) -> None:
    """Tells that a running campaign has had no result for some minutes while its cells wait."""
    connection.execute(_of(sequence))
    events.add(connection, sequence, EventKind.STALLED, {"minutes": minutes, "reason": reason})


def explain(connection: Connection, waits: Mapping[int, str]) -> None:
    """Stores why campaigns wait, by number; the others that have not ended do not wait."""
    open_ones = select(campaigns.c.sequence, campaigns.c.waiting).where(campaigns.c.ended_at.is_(None))
    for sequence, waiting in connection.execute(open_ones).all():
        if waiting != waits.get(sequence):
            is_open = campaigns.c.ended_at.is_(None)  # checked again after a wait for the row
            connection.execute(_of(sequence).where(is_open).values(waiting=waits.get(sequence)))


def waits(connection: Connection) -> list[tuple[str, str, CampaignState, str]]:
    """Returns id, name, state and reason of the campaigns that wait, in the order of submission."""
    columns = campaigns.c.id, campaigns.c.name, campaigns.c.state, campaigns.c.waiting
    query = select(*columns).where(campaigns.c.ended_at.is_(None), campaigns.c.waiting.is_not(None))
    return [
        (row.id, row.name, CampaignState(row.state), row.waiting)
        for row in connection.execute(query.order_by(campaigns.c.sequence))
    ]


def end(connection: Connection, sequence: int, state: CampaignState, error: str | None = None) -> bool:
    """Ends a campaign as `state`; False if it has ended already."""
    left = {"error": error, "ended_at": now(), "requested_action": None, "degraded": None, "waiting": None}
    ended = _change(connection, sequence, [each for each in CampaignState if not each.ended], state=state, **left)
    if ended:
        _forget_leases(connection, by_sequence(connection, sequence))
        events.add(connection, sequence, EventKind(state), {"state": state} | ({} if error is None else {"error": error}))
    return ended


def _forget_leases(connection: Connection, campaign: StoredCampaign) -> None:
    """Counts what was started for cells that get no answer any more."""
    started = leases.forget(connection, campaign.sequence)
    counts = {stage: campaign.counts(stage) for stage in started}
    changed = {
        stage: each.model_copy(update={"runs": each.runs + started[stage][0], "lost": each.lost + started[stage][1]})
        for stage, each in counts.items()
    }
    save_counts(connection, campaign.sequence, changed)


def _change(
    connection: Connection, sequence: int, expected: Collection[CampaignState], *conditions: ColumnElement[bool], **values: Any
) -> bool:
    """Changes a campaign in one of the `expected` states; False if it was in none of them."""
    statement = _of(sequence).where(campaigns.c.state.in_(list(expected)), *conditions)
    return connection.execute(statement.values(values)).rowcount == 1


def _of(sequence: int) -> Update:
    return update(campaigns).where(campaigns.c.sequence == sequence).values(revision=campaigns.c.revision + 1)


def _campaign(row: Row[Any]) -> StoredCampaign:
    return record(StoredCampaign, row, state=CampaignState(row.state), spec=row.spec or {})
