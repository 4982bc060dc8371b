"""Generations: the iterations of a campaign's calibration stage."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from sqlalchemy import Connection, func, select, update

from drivecal.contracts.campaign import GenerationCounts
from drivecal.storage.engine.records import page_by, record
from drivecal.storage.engine.tables import generations
from drivecal.storage.engine.types import finite


@dataclass(frozen=True, slots=True)
class Figures:
    """Requests and results of a generation; `alternatives` as in `contracts.tables.Generation`."""

    cells: GenerationCounts = field(default_factory=GenerationCounts)
    best: float | None = None
    rating: float | None = None
    mean: float | None = None
    minimum: float | None = None
    alternatives: int = 0

    @property
    def flat(self) -> dict[str, Any]:
        """The figures by name, counters included."""
        return self.cells.model_dump() | {name: value for name, value in asdict(self).items() if name != "cells"}


@dataclass(frozen=True, slots=True)
class StoredGeneration:
    """A generation with all that its successor needs.

    `population`: grid indices by individual; `changed`: which of them were requested; `objectives`: None until it is finished, None
    in it for individuals without a result; `optimizer_state`: after `ask`, kept for the last generation only.
    """

    iteration: int
    figures: Figures
    population: list[list[int]]
    changed: list[bool]
    optimizer_state: Mapping[str, Any] | None
    objectives: list[float | None] | None
    finished: bool


def insert(
    connection: Connection,
    campaign_sequence: int,
    iteration: int,
    *,
    figures: Figures,
    population: Sequence[Sequence[int]],
    changed: Sequence[bool],
    optimizer_state: Mapping[str, Any],
) -> None:
    """Stores a new generation, in the transaction that stores its evaluations, and removes the states of earlier ones."""
    connection.execute(
        update(generations)
        .where(generations.c.campaign_sequence == campaign_sequence, generations.c.optimizer_state.is_not(None))
        .values(optimizer_state=None)
    )
    connection.execute(
        generations.insert().values(
            campaign_sequence=campaign_sequence,
            iteration=iteration,
            population=[list(individual) for individual in population],
            changed=list(changed),
            optimizer_state=dict(optimizer_state),
            finished=False,
            **finite(asdict(figures)),
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


def number(connection: Connection, campaign_sequence: int) -> int:
    """Returns the number of iterations that were asked for."""
    query = select(func.count()).where(generations.c.campaign_sequence == campaign_sequence)
    return int(connection.scalar(query) or 0)


def finish(
    connection: Connection, campaign_sequence: int, iteration: int, figures: Figures, objectives: Sequence[float | None]
) -> None:
    """Stores the results of a generation; NaN among `objectives` becomes None."""
    connection.execute(
        update(generations)
        .where(generations.c.campaign_sequence == campaign_sequence, generations.c.iteration == iteration)
        .values(objectives=list(objectives), finished=True, **finite(asdict(figures)))
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
    return None if row is None else record(StoredGeneration, row, figures=record(Figures, row))


def course(connection: Connection, campaign_sequence: int) -> list[tuple[float | None, float | None, int]]:
    """Returns objective and rating of the best set so far, and the number of sets that share it, by finished iteration."""
    query = (
        select(generations.c.best, generations.c.rating, generations.c.alternatives)
        .where(generations.c.campaign_sequence == campaign_sequence, generations.c.finished)
        .order_by(generations.c.iteration)
    )
    return [(row.best, row.rating, row.alternatives) for row in connection.execute(query)]


def page(
    connection: Connection, campaign_sequence: int, *, limit: int = 100, cursor: str | None = None
) -> tuple[list[tuple[int, Figures]], str | None]:
    """At most `limit` finished iterations with their figures, in order, and the cursor of the next page (None on the last).

    Raises InvalidInputError.
    """
    query = select(generations.c.iteration, *(generations.c[each.name] for each in fields(Figures))).where(
        generations.c.campaign_sequence == campaign_sequence, generations.c.finished
    )
    rows, following = page_by(connection, query, generations.c.iteration, limit, cursor, newest_first=False)
    return [(row.iteration, record(Figures, row)) for row in rows], following
