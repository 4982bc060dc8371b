"""Generations: the iterations of a campaign's calibration stage."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, func, select, update

from drivecal.contracts.tables import Generation
from drivecal.storage.engine.records import page_by, record
from drivecal.storage.engine.tables import generations


@dataclass(frozen=True, slots=True)
class StoredGeneration:
    """A generation with all that its successor needs.

    `population`: grid indices by individual; `changed`: which of them were requested; `objectives`: None until it is finished, None
    in it for individuals without a result; `optimizer_state`: after `ask`, kept for the last generation only.
    """

    iteration: int
    figures: Generation
    population: list[list[int]]
    changed: list[bool]
    optimizer_state: Mapping[str, Any] | None
    objectives: list[float | None] | None
    finished: bool


def insert(
    connection: Connection,
    campaign_sequence: int,
    figures: Generation,
    *,
    population: Sequence[Sequence[int]],
    changed: Sequence[bool],
    optimizer_state: Mapping[str, Any],
) -> None:
    """Stores a new generation, in the transaction that stores its evaluations, and removes the states of earlier ones."""
    connection.execute(
        update(generations)
        .where(generations.c.campaign_sequence == campaign_sequence, generations.c.iteration == figures.iteration - 1)
        .values(optimizer_state=None)
    )
    connection.execute(
        generations.insert().values(
            campaign_sequence=campaign_sequence,
            iteration=figures.iteration,
            figures=figures,
            population=[list(individual) for individual in population],
            changed=list(changed),
            optimizer_state=dict(optimizer_state),
            finished=False,
        )
    )


def is_stored(connection: Connection, campaign_sequence: int, iteration: int) -> bool:
    """Returns whether an iteration was requested, at least in part."""
    here = generations.c.campaign_sequence == campaign_sequence, generations.c.iteration == iteration
    return connection.execute(select(generations.c.iteration).where(*here)).first() is not None


def finished(connection: Connection, campaign_sequence: int) -> int:
    """Returns the number of finished iterations before the first that is not."""
    here = generations.c.campaign_sequence == campaign_sequence
    first = select(func.min(generations.c.iteration)).where(here, ~generations.c.finished).scalar_subquery()
    return int(connection.scalar(select(func.coalesce(first, func.max(generations.c.iteration) + 1, 0)).where(here)) or 0)


def populations(connection: Connection, campaign_sequence: int) -> list[list[list[int]]]:
    """Returns the grid indices of each iteration's sets, in order."""
    query = select(generations.c.population).where(generations.c.campaign_sequence == campaign_sequence)
    return list(connection.scalars(query.order_by(generations.c.iteration)))


def finish(connection: Connection, campaign_sequence: int, figures: Generation, objectives: Sequence[float | None]) -> None:
    """Stores the results of a generation; NaN among `objectives` becomes None."""
    connection.execute(
        update(generations)
        .where(generations.c.campaign_sequence == campaign_sequence, generations.c.iteration == figures.iteration)
        .values(objectives=list(objectives), finished=True, figures=figures)
    )


def last(connection: Connection, campaign_sequence: int) -> StoredGeneration | None:
    """Returns the newest generation, with which a resumed campaign continues; None before the first."""
    query = (
        select(generations)
        .where(generations.c.campaign_sequence == campaign_sequence)
        .order_by(generations.c.iteration.desc())
        .limit(1)
    )
    row = connection.execute(query).one_or_none()
    return None if row is None else record(StoredGeneration, row)


def course(connection: Connection, campaign_sequence: int) -> list[Generation]:
    """Returns the finished iterations, in order."""
    query = select(generations.c.figures).where(generations.c.campaign_sequence == campaign_sequence, generations.c.finished)
    return list(connection.scalars(query.order_by(generations.c.iteration)))


def page(
    connection: Connection, campaign_sequence: int, *, limit: int = 100, cursor: str | None = None
) -> tuple[list[Generation], str | None]:
    """At most `limit` finished iterations, in order, and the cursor of the next page (None on the last). Raises InvalidInputError."""
    query = select(generations.c.iteration, generations.c.figures).where(
        generations.c.campaign_sequence == campaign_sequence, generations.c.finished
    )
    rows, following = page_by(connection, query, generations.c.iteration, limit, cursor, newest_first=False)
    return [row.figures for row in rows], following
