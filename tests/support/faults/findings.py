"""Results of campaigns, without the parts that may differ between runs, and conditions that hold after any fault."""

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from sqlalchemy import Connection, func, select
from tests.support.faults.workload import Accepted

from drivecal.client.client import Client
from drivecal.contracts.tables import TableName
from drivecal.domain.campaigns import CampaignState
from drivecal.execution.scheduling.scheduler import ATTEMPTS
from drivecal.storage import campaigns
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.tables import campaigns as campaigns_table
from drivecal.storage.engine.tables import evaluations, parameter_sets, ratings, runs, setups
from drivecal.storage.maintenance.consistency import verify
from drivecal.storage.references import metrics

TABLES: tuple[TableName, ...] = ("generations", "influence", "robustness", "validation", "evaluations")
"""Tables of what a campaign did itself. Its ranking shows what others simulated, too, which depends on time."""
OF_A_CAMPAIGN = ("state", "error", "degraded", "stages", "error_rate", "released", "best", "baseline", "notes")
OF_ONE_RUN = {"id", "milliseconds", "worker", "runs"}
"""Columns of an evaluation that say who simulated it, how fast and after how many lost starts, not what came out."""
PLACE = ("stage", "iteration", "individual", "scenario")


class Served(Protocol):
    """A server with campaigns, and its database."""

    @property
    def url(self) -> str: ...

    @property
    def database(self) -> Database: ...


@dataclass(frozen=True)
class Found:
    """One campaign's results: equal for equal campaigns, to the bit."""

    campaign: Mapping[str, Any]
    tables: Mapping[str, list[dict[str, str]]]
    """By name; references of evaluations by their place instead of by an id."""
    runs: Mapping[tuple[str, str], tuple[object, ...]]
    """The distinct simulations of its setups, by fingerprint and parameter set: metrics, failure, and each evaluator's rating."""


def found(coordinator: Served, campaign_id: str) -> Found:
    """Reads a campaign's results over HTTP, and its simulations from the database."""
    with Client(coordinator.url) as client:
        campaign = client.campaign(campaign_id).model_dump(mode="json")
        tables: dict[str, list[dict[str, str]]] = {
            name: list(csv.DictReader(b"".join(client.table(campaign_id, name, "csv")).decode().splitlines()))
            for name in TABLES
        }
    with coordinator.database.read() as connection:
        simulated = _runs(connection, campaigns.get(connection, campaign_id).sequence)
    for released in campaign["released"].values():
        released.pop("seconds")
    for counted in campaign["stages"].values():
        del counted["runs"], counted["lost"]  # a run that is lost with its worker is made again
    campaign["notes"] = [note for note in campaign["notes"] if not note.startswith("predictions are off")]  # measured times
    tables["evaluations"] = _by_place(tables["evaluations"])
    return Found({name: campaign[name] for name in OF_A_CAMPAIGN}, tables, simulated)


def _by_place(rows: list[dict[str, str]]) -> list[dict[str, str]]:
    places = {row["id"]: " ".join(row[name] for name in PLACE) for row in rows}
    lots = sorted({int(row["lot"]) for row in rows if row["lot"]})
    kept = [
        {name: value for name, value in row.items() if name not in OF_ONE_RUN}
        | {"reference": places.get(row["reference"], row["reference"])}
        | {"lot": str(lots.index(int(row["lot"]))) if row["lot"] else ""}
        for row in rows
    ]
    return sorted(kept, key=lambda row: (row["stage"], int(row["iteration"]), int(row["individual"]), row["scenario"]))


def _runs(connection: Connection, sequence: int) -> dict[tuple[str, str], tuple[object, ...]]:
    used = select(evaluations.c.setup_id).where(evaluations.c.campaign_sequence == sequence).distinct()
    rated: dict[int, list[tuple[object, ...]]] = {}
    for rating in connection.execute(select(ratings).order_by(ratings.c.run_id, ratings.c.evaluator)):
        rated.setdefault(rating.run_id, []).append((rating.evaluator, rating.score, rating.rating))
    read = metrics.reader(connection)
    query = (
        select(runs.c.id, setups.c.fingerprint, parameter_sets.c.parameter_values, runs.c.metrics, runs.c.failure)
        .join_from(runs, setups)
        .join(parameter_sets)
        .where(runs.c.setup_id.in_(used))
    )
    return {
        (row.fingerprint, row.parameter_values): (sorted(read(row.metrics).items()), row.failure, rated.get(row.id))
        for row in connection.execute(query)
    }


def assert_equal(name: str, ours: Found, expected: Found) -> None:
    """AssertionError naming what differs, with an example of each."""
    differences = [f"{part}: {ours.campaign[part]} instead of {expected.campaign[part]}" for part in OF_A_CAMPAIGN
                   if ours.campaign[part] != expected.campaign[part]]  # fmt: skip
    for table in TABLES:
        mine, theirs = ours.tables[table], expected.tables[table]
        if len(mine) != len(theirs):
            differences.append(f"{table}: {len(mine)} rows instead of {len(theirs)}")
        unlike = [(one, other) for one, other in zip(mine, theirs, strict=False) if one != other]
        if unlike:
            differences.append(f"{table}: {len(unlike)} rows differ, e.g. {unlike[0][0]} instead of {unlike[0][1]}")
    if ours.runs != expected.runs:
        missing, more = expected.runs.keys() - ours.runs.keys(), ours.runs.keys() - expected.runs.keys()
        other = [key for key in ours.runs.keys() & expected.runs.keys() if ours.runs[key] != expected.runs[key]]
        differences.append(
            f"simulations: {len(missing)} missing, {len(more)} too many, {len(other)} others, e.g. {[*missing, *more, *other][0]}"
        )
    assert not differences, f"campaign {name} differs from its run without faults:\n" + "\n".join(differences)


def assert_sound(coordinator: Served, accepted: Accepted) -> None:
    """Returns what holds of every database whose campaigns have ended. AssertionError naming what does not."""
    wrong = [f"a request was answered {answer}" for answer in accepted.refused]
    wrong += [f"{check.name}: {problem}" for check in verify(coordinator.database) for problem in check.problems]
    with Client(coordinator.url) as client, coordinator.database.read() as connection:
        for name, identifier in accepted.campaigns.items():
            campaign = client.campaign(identifier)
            if campaign.progress.done != campaign.progress.total:
                wrong.append(f"{name} has done {campaign.progress}")
            wrong += [f"{name} has differing runs in {stage}" for stage, cells in campaign.stages.items() if cells.unrepeatable]
        for key, answers in accepted.evaluations.items():
            if len(set(answers)) > 1:
                wrong.append(f"key {key} made evaluations {answers}")
            single = client.evaluation(answers[0])
            if single.state != CampaignState.SUCCEEDED or single.score is None:
                wrong.append(f"the evaluation {answers[0]} is {single.state} with score {single.score}: {single.error}")
        kept = connection.execute(select(func.count()).select_from(campaigns_table)).scalar_one()
        known = len(accepted.campaigns) + len({answers[0] for answers in accepted.evaluations.values()})
        if kept < known:
            wrong.append(f"{known} requests were accepted, {kept} are there")
        tried = connection.execute(select(func.max(evaluations.c.attempts))).scalar_one()
        if tried > ATTEMPTS:
            wrong.append(f"a cell had {tried} attempts")
    assert not wrong, "\n".join(wrong)
