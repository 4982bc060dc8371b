"""Pruning: groups of old campaigns go whole, with all that they simulated.

A run may answer cells of any campaign on the same setup, and a campaign may name another one. Campaigns that share a setup or a name are
therefore a group, which goes when all of its campaigns are old: with the last campaign on a former version of a simulation, for example.
"""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import Connection, Text, cast, delete, func, select

from drivecal.bundles.installed import installed
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import ConflictError
from drivecal.storage import bundles
from drivecal.storage.engine.bulk import among
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.tables import (
    campaigns,
    evaluations,
    influence_maps,
    leases,
    ratings,
    reference_indexes,
    reference_keys,
    runs,
    setups,
    traces,
)
from drivecal.storage.retention import removal

_ID = re.compile(r"[0-9a-f]{32}")


@dataclass(frozen=True, slots=True)
class StoredEnd:
    """A campaign as a pruning sees it. `links`: fingerprints of its setups, its id, ids of its maps, and the ids that it names."""

    sequence: int
    id: str
    name: str
    kind: str
    state: CampaignState
    ended_at: datetime | None
    problem: str | None
    links: frozenset[str]
    starting: bool
    """Whether its setups follow in a moment."""


@dataclass(frozen=True, slots=True)
class Group:
    """Campaigns that go together; `setups`: the setups that they used, by id."""

    campaigns: Sequence[StoredEnd]
    setups: frozenset[int]


@dataclass(frozen=True, slots=True)
class PruningPlan:
    """A planned pruning. `spared`: old campaigns that stay, with a campaign of their group that is not old. `cells` of campaigns that go,
    by number. `used`: the setups of each campaign, by id."""

    groups: Sequence[Group]
    spared: Sequence[tuple[StoredEnd, StoredEnd]]
    cells: Mapping[int, int]
    runs: int
    used: Mapping[int, Mapping[int, str]]
    before: datetime
    problems: Collection[str] | None


def plan(database: Database, before: datetime, problem: str | None = None) -> PruningPlan:
    """Plans the pruning of campaigns that ended `before` a moment, of one problem or of all. Only reads.

    Raises NotFoundError for an unknown problem, and ConflictError while a campaign starts.
    """
    cell = evaluations.c
    with database.read() as connection:
        problems = None if problem is None else _pushes(connection, problem)
        used: dict[int, dict[int, str]] = defaultdict(dict)
        fingerprints = {row.id: row.fingerprint for row in connection.execute(select(setups.c.id, setups.c.fingerprint))}
        for sequence, setup in connection.execute(select(cell.campaign_sequence, cell.setup_id).distinct()):
            used[sequence][setup] = fingerprints[setup]
        groups, spared = _groups(connection, used, before, problems)
        counted = select(cell.campaign_sequence, func.count()).group_by(cell.campaign_sequence)
        going = {each.sequence for group in groups for each in group.campaigns}
        cells = {sequence: count for sequence, count in connection.execute(counted) if sequence in going}
        by_setup = select(runs.c.setup_id, func.count()).group_by(runs.c.setup_id)
        free = {setup for group in groups for setup in group.setups}
        made = sum(count for setup, count in connection.execute(by_setup) if setup in free)
    return PruningPlan(groups, spared, cells, made, used, before, problems)


def carry_out(database: Database, planned: PruningPlan) -> None:
    """Removes the planned groups, each in a transaction. Raises ConflictError if a campaign came meanwhile that may use one; it stays."""
    for group in planned.groups:
        with database.transaction() as connection:
            removal.alone(connection)
            now, _ = _groups(connection, planned.used, planned.before, planned.problems)
            ids = {each.id for each in group.campaigns}
            if not any(ids == {each.id for each in other.campaigns} for other in now):
                raise ConflictError(f"a campaign came that may use {group.campaigns[0].id}; run the command again")
            _remove(connection, group)


def _groups(
    connection: Connection, used: Mapping[int, Mapping[int, str]], before: datetime, problems: Collection[str] | None
) -> tuple[list[Group], list[tuple[StoredEnd, StoredEnd]]]:
    """Returns the groups that go, and old campaigns of others."""
    rows = {row.sequence: row for row in _campaigns(connection, used)}
    for row in rows.values():
        if row.starting:
            raise ConflictError(f"campaign {row.id} is starting; run the command again in a moment")
    by_link: dict[str, list[int]] = defaultdict(list)
    for row in rows.values():
        for link in row.links:
            by_link[link].append(row.sequence)
    left, groups, spared = dict.fromkeys(rows), list[Group](), list[tuple[StoredEnd, StoredEnd]]()
    while left:
        members, open_ = list[StoredEnd](), [next(iter(left))]
        del left[open_[0]]
        while open_:
            members.append(rows[open_.pop()])
            for link in members[-1].links:
                for sequence in by_link.pop(link, ()):
                    if sequence in left:
                        del left[sequence]
                        open_.append(sequence)
        members.sort(key=lambda each: each.sequence)
        young = [each for each in members if not _is_old(each, before, problems)]
        if young:
            spared += [(each, young[-1]) for each in members if _is_old(each, before, problems)]
        else:
            groups.append(Group(members, frozenset(setup for each in members for setup in used.get(each.sequence, ()))))
    return groups, spared


def _is_old(campaign: StoredEnd, before: datetime, problems: Collection[str] | None) -> bool:
    ended = campaign.ended_at is not None and campaign.ended_at < before
    return ended and (problems is None or campaign.problem in problems)


def _campaigns(connection: Connection, used: Mapping[int, Mapping[int, str]]) -> Iterator[StoredEnd]:
    made: dict[str, set[str]] = defaultdict(set)
    for source, identifier in connection.execute(select(influence_maps.c.source, influence_maps.c.id)):
        made[source].add(identifier)
    table = campaigns.c
    columns = (table.sequence, table.id, table.name, table.kind, table.state, table.started_at, table.ended_at, table.rerun_of)
    query = select(*columns, table.influence_map_id, table.resolution, cast(table.spec, Text).label("spec"))
    for row in connection.execute(query.order_by(table.sequence).execution_options(yield_per=100)):
        state = CampaignState(row.state)
        known = set((row.resolution or {}).get("setups", {}).values()) | set(used.get(row.sequence, {}).values())
        named = {name for name in (row.rerun_of, row.influence_map_id) if name} | set(_ID.findall(row.spec or ""))
        yield StoredEnd(
            sequence=row.sequence,
            id=row.id,
            name=row.name,
            kind=row.kind,
            state=state,
            ended_at=row.ended_at,
            problem=json.loads(row.spec or "{}").get("problem"),
            links=frozenset({row.id} | made[row.id] | known | named),
            starting=row.started_at is not None and row.resolution is None and not state.ended,
        )


def _remove(connection: Connection, group: Group) -> None:
    """Removes a group, rows before the rows that they refer to."""
    numbers, ids = [each.sequence for each in group.campaigns], [each.id for each in group.campaigns]
    cell, keys, index = evaluations.c, reference_keys.c, reference_indexes.c
    maps = [row.sequence for here in among(connection, influence_maps.c.source, ids)
            for row in connection.execute(select(influence_maps.c.sequence).where(here))]  # fmt: skip
    for column, values in ((index.setup_id, sorted(group.setups)), (index.influence_map_sequence, maps)):
        for here in among(connection, column, values):
            connection.execute(delete(reference_keys).where(keys.index_id.in_(select(index.id).where(here))))
            connection.execute(delete(reference_indexes).where(here))
    for here in among(connection, cell.campaign_sequence, numbers):
        for table in (leases, traces):
            connection.execute(delete(table).where(table.c.evaluation_id.in_(select(cell.id).where(here))))
        connection.execute(delete(evaluations).where(here))
    for here in among(connection, runs.c.setup_id, sorted(group.setups)):
        connection.execute(delete(ratings).where(ratings.c.run_id.in_(select(runs.c.id).where(here))))
        connection.execute(delete(runs).where(here))
    for number in numbers:
        connection.execute(delete(traces).where(traces.c.campaign_sequence == number))
        removal.remove_records(connection, number)
    for here in among(connection, campaigns.c.sequence, sorted(numbers, reverse=True)):  # a rerun is younger than its first
        connection.execute(delete(campaigns).where(here))
    for here in among(connection, influence_maps.c.sequence, maps):
        connection.execute(delete(influence_maps).where(here))


def _pushes(connection: Connection, problem: str) -> Collection[str]:
    """Returns the names under which campaigns name a problem: its name, and the digests of all that was pushed under it.

    Raises NotFoundError."""
    own = installed(problem)
    pushed, cursor = {problem, problem if own is None else own.digest}, None
    if own is None:
        bundles.named(connection, problem)
    while True:
        page, cursor = bundles.listing(connection, name=problem, limit=1_000, cursor=cursor)
        pushed |= {heading.digest for heading in page}
        if cursor is None:
            return pushed
