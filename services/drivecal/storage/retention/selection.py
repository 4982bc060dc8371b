"""Selection of the campaigns that may be pruned: ended before a moment, and named by no campaign that stays."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import ColumnElement, Connection, Text, cast, or_, select

from drivecal.domain.campaigns import CampaignState
from drivecal.storage.engine.bulk import rows_among
from drivecal.storage.engine.tables import campaigns, influence_maps, setups

_ID = re.compile(r"[0-9a-f]{32}")
_ENDED = tuple(state for state in CampaignState if state.ended)


@dataclass(frozen=True, slots=True)
class Prunable:
    """A campaign that may be pruned. `sets`: the parameter sets that an earlier pruning kept, best first; None if there was none.

    `whole`: whether its row goes with its last cell, as that of a single evaluation or a deleted campaign does.
    """

    sequence: int
    id: str
    name: str
    kind: str
    ended_at: datetime
    sets: tuple[int, ...] | None
    whole: bool


@dataclass(frozen=True, slots=True)
class Spared:
    """A campaign that is old enough and stays; `reason`: why."""

    id: str
    reason: str


@dataclass(frozen=True, slots=True)
class Selection:
    """Campaigns to prune, oldest first, and old ones that stay whole."""

    prunable: Sequence[Prunable]
    spared: Sequence[Spared]


@dataclass(frozen=True, slots=True)
class _Campaign:
    sequence: int
    id: str
    name: str
    kind: str
    state: CampaignState
    started: bool
    ended_at: datetime | None
    setups: frozenset[str]
    known: bool
    """Whether its setups are known."""
    names: frozenset[str]
    """Ids of campaigns that it reruns or examines, and of the maker of its influence map."""
    problem: str | None
    pruned: Mapping[str, Any] | None
    deleted: bool


def select_campaigns(connection: Connection, before: datetime, problems: Collection[str] | None) -> Selection:
    """Returns the campaigns that ended `before` a moment; with `problems` only those of these names or digests.

    A campaign stays whole while a campaign that stays reruns it, examines its sets or uses its influence map. So does one whose setups a
    started campaign uses: that may be answered by its runs at any moment.
    """
    rows = {row.sequence: row for row in _campaigns(connection)}
    by_id = {row.id: row.sequence for row in rows.values()}
    old = {
        row.sequence
        for row in rows.values()
        if row.ended_at is not None and row.ended_at < before and (problems is None or row.problem in problems)
    }
    reasons: dict[int, str] = {}
    for user in (row for row in rows.values() if row.started and row.state not in _ENDED):
        for row in (rows[number] for number in old):
            if not user.known or row.setups & user.setups or not row.known:
                reasons.setdefault(row.sequence, f"campaign {user.id} is {user.state} and may use its results")
    _spread(rows, by_id, old, reasons)
    listed = sorted((rows[number] for number in old), key=lambda row: row.sequence)
    return Selection(
        [_prunable(row) for row in listed if row.sequence not in reasons],
        [Spared(row.id, reasons[row.sequence]) for row in listed if row.sequence in reasons],
    )


def _spread(rows: Mapping[int, _Campaign], by_id: Mapping[str, int], old: Collection[int], reasons: dict[int, str]) -> None:
    """Adds the reasons of campaigns that stay because others stay, until nothing changes."""
    staying = [number for number in rows if number not in old or number in reasons]
    while staying:
        row = rows[staying.pop()]
        named = [(by_id[name], f"campaign {row.id} uses it and stays") for name in row.names if name in by_id]
        for number, reason in named:
            if number in old and number not in reasons:
                reasons[number] = reason
                staying.append(number)


def _prunable(row: _Campaign) -> Prunable:
    if row.ended_at is None:
        raise AssertionError(f"campaign {row.id} has not ended")
    kept = None if row.pruned is None else tuple(row.pruned["sets"])
    whole = row.deleted or row.kind == "evaluation"
    return Prunable(row.sequence, row.id, row.name, row.kind, row.ended_at, () if row.deleted else kept, whole)


def _campaigns(connection: Connection, *conditions: ColumnElement[bool]) -> Iterable[_Campaign]:
    table = campaigns.c
    columns = (
        *(table.sequence, table.id, table.name, table.kind, table.state, table.started_at, table.ended_at),
        *(table.rerun_of, table.pruned, table.deleted_at, table.resolution),
        *(cast(table.spec, Text).label("spec"), influence_maps.c.source.label("map_maker")),
    )
    with_maps = campaigns.outerjoin(influence_maps, influence_maps.c.id == table.influence_map_id)
    query = select(*columns).select_from(with_maps).where(*conditions).order_by(table.sequence)
    for row in connection.execute(query.execution_options(yield_per=100)):
        named = {name for name in (row.rerun_of, row.map_maker) if name}
        fingerprints = _setups(row.resolution)
        yield _Campaign(
            sequence=row.sequence,
            id=row.id,
            name=row.name,
            kind=row.kind,
            state=CampaignState(row.state),
            started=row.started_at is not None,
            ended_at=row.ended_at,
            setups=fingerprints,
            known=row.started_at is None or row.resolution is not None or row.state in _ENDED,
            names=frozenset(named | set(_ID.findall(row.spec)) - {row.id}),
            problem=json.loads(row.spec).get("problem"),
            pruned=row.pruned,
            deleted=row.deleted_at is not None,
        )


def _setups(resolution: Mapping[str, Any] | None) -> frozenset[str]:
    """Returns the fingerprints of a resolution's setups; the vehicles of a study follow from them."""
    return frozenset((resolution or {}).get("setups", {}).values())


@dataclass(frozen=True, slots=True)
class User:
    """A campaign that may use what a pruning would remove; `known`: False if it has started and its setups follow in a moment."""

    id: str
    known: bool


def user_since(
    connection: Connection, open_before: Collection[int], newest: int, fingerprints: Collection[str], prunable: Collection[str]
) -> User | None:
    """Returns a campaign that may use runs of these setups, or that came after the campaign numbered `newest` and names one of the
    `prunable` ids; None without one. The caller holds `removal.alone`."""
    table = campaigns.c
    watched = or_(table.sequence.in_(list(open_before)), table.sequence > newest)
    for row in _campaigns(connection, watched):
        if row.sequence > newest and row.names & set(prunable):
            return User(row.id, known=True)
        if row.started and (not row.known or row.setups & set(fingerprints)):
            return User(row.id, row.known)
    return None


def open_campaigns(connection: Connection) -> tuple[list[int], int]:
    """Returns the numbers of campaigns that have not ended, and that of the newest campaign."""
    listed = connection.scalars(select(campaigns.c.sequence).where(campaigns.c.ended_at.is_(None)))
    newest = connection.scalar(select(campaigns.c.sequence).order_by(campaigns.c.sequence.desc()).limit(1))
    return list(listed), newest or 0


def fingerprints_of(connection: Connection, setup_ids: Collection[int]) -> frozenset[str]:
    """Returns the fingerprints of setups by their ids."""
    query = select(setups.c.fingerprint)
    return frozenset(row.fingerprint for row in rows_among(connection, query, setups.c.id, sorted(setup_ids)))
