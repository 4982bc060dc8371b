"""Time series of evaluations, simulated again on demand and kept for a limited time."""

from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import Connection, delete, exists, insert, select, update

from drivecal.storage.engine.records import record
from drivecal.storage.engine.tables import campaigns, evaluations, traces
from drivecal.storage.engine.types import now


@dataclass(frozen=True, slots=True)
class StoredTrace:
    """`campaign_sequence`: the single evaluation that makes it; `content`: as the worker packed it, None while there is none."""

    campaign_sequence: int
    content: bytes | None


def find(connection: Connection, evaluation_id: int, *, for_update: bool = False) -> StoredTrace | None:
    """Returns the trace of an evaluation; None without a recent request.

    `for_update` blocks other readers for update until the transaction ends.
    """
    if for_update:
        connection.execute(select(evaluations.c.id).where(evaluations.c.id == evaluation_id).with_for_update())
    row = connection.execute(select(traces).where(traces.c.evaluation_id == evaluation_id)).one_or_none()
    return None if row is None else record(StoredTrace, row)


def ask(connection: Connection, evaluation_id: int, campaign_sequence: int) -> None:
    """Writes down who makes the trace of an evaluation."""
    row = {"evaluation_id": evaluation_id, "campaign_sequence": campaign_sequence, "created_at": now()}
    connection.execute(insert(traces).values(row))


def is_made_by(connection: Connection, campaign_sequence: int) -> bool:
    """Returns whether a single evaluation makes the trace."""
    return connection.scalar(select(exists().where(traces.c.campaign_sequence == campaign_sequence))) or False


def fill(connection: Connection, campaign_sequence: int, content: bytes) -> None:
    """Stores the time series of a single evaluation."""
    connection.execute(update(traces).where(traces.c.campaign_sequence == campaign_sequence).values(content=content))


def forget(connection: Connection, evaluation_id: int) -> None:
    """Removes the trace of an evaluation, so that it can be requested again."""
    connection.execute(delete(traces).where(traces.c.evaluation_id == evaluation_id))


def prune(connection: Connection, before: datetime, most: int) -> None:
    """Removes traces that were requested before a moment, and all but the newest `most`, except unfinished ones."""
    ended = select(campaigns.c.sequence).where(campaigns.c.ended_at.is_not(None))
    newest = select(traces.c.evaluation_id).order_by(traces.c.created_at.desc(), traces.c.evaluation_id.desc()).limit(most)
    old = (traces.c.created_at < before) | traces.c.evaluation_id.not_in(newest)
    connection.execute(delete(traces).where(traces.c.campaign_sequence.in_(ended), old))
