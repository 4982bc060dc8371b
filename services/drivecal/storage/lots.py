"""Lots of predicted or reused answers: a batch of a scenario with its sampling plan and, once its sample is simulated, its verdict."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from hashlib import sha256
from typing import Any

from sqlalchemy import Connection, Row, case, func, select, update

from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import Outcome
from drivecal.domain.parameters import ParameterSet
from drivecal.storage.engine.records import record
from drivecal.storage.engine.tables import campaigns, evaluations, lots, parameter_sets
from drivecal.storage.evaluations import SAMPLED, stored_after
from drivecal.storage.results import parsed


class LotVerdict(StrEnum):
    """Outcome of an inspection."""

    RELEASED = "released"
    REJECTED = "rejected"


@dataclass(frozen=True, slots=True)
class NewLot:
    """Answers of a batch in a scenario; `individual` is the batch's first. `size` 0: no prediction was accepted."""

    iteration: int
    individual: int
    scenario: str
    size: int
    sample: int
    acceptance: int
    tolerance: float
    aoql: float
    """The largest expected share of released errors (average outgoing quality limit)."""
    known: int
    """Answers that the predictor had learned from; 0 for references."""
    seconds: float
    """CPU time of the predictor; 0 for references."""
    kind: Outcome
    """`PREDICTED` or `REUSED`: the outcome of the released answers."""


@dataclass(frozen=True, slots=True)
class StoredLot(NewLot):
    """A lot; `verdict` and the `errors` of its sample are None before its sample is simulated."""

    id: int
    verdict: LotVerdict | None
    errors: int | None

    @property
    def released(self) -> int:
        """Number of inspected answers that were released."""
        return self.size - self.sample if self.verdict is LotVerdict.RELEASED else 0


def sample_key(connection: Connection, campaign_sequence: int) -> bytes:
    """Returns the key that draws a campaign's samples: a stream of the campaign's seed that no optimizer and no model draws from."""
    spec = connection.scalar(select(campaigns.c.spec).where(campaigns.c.sequence == campaign_sequence)) or {}
    seed = (spec.get("optimizer") or {}).get("seed", 1)
    return sha256(f"samples of lots, seed {seed}".encode()).digest()[:16]


def insert(connection: Connection, campaign_sequence: int, new: Sequence[NewLot]) -> list[int]:
    """Stores lots and returns their ids, in order."""
    if not new:
        return []
    statement = lots.insert().returning(lots.c.id, sort_by_parameter_order=True)
    return list(connection.scalars(statement, [{"campaign_sequence": campaign_sequence} | asdict(lot) for lot in new]))


def of_campaign(connection: Connection, campaign_sequence: int, kind: Outcome | None = None) -> list[StoredLot]:
    """Returns the lots of a campaign, all or of a kind, in the order of their batches."""
    query = select(lots).where(lots.c.campaign_sequence == campaign_sequence).order_by(lots.c.id)
    if kind is not None:
        query = query.where(lots.c.kind == kind)
    return [_lot(row) for row in connection.execute(query)]


def by_id(connection: Connection, number: int) -> StoredLot:
    """Returns a lot that exists."""
    return _lot(connection.execute(select(lots).where(lots.c.id == number)).one())


def _lot(row: Row[Any]) -> StoredLot:
    verdict = None if row.verdict is None else LotVerdict(row.verdict)
    return record(StoredLot, row, kind=Outcome(row.kind), verdict=verdict)


def released_cells(connection: Connection, campaign_sequence: int, kind: Outcome) -> dict[str, int]:
    """Returns the number of answers that lots of a kind released, by scenario, without zeros."""
    cell = evaluations.c
    mine = cell.campaign_sequence == campaign_sequence, cell.outcome == kind, cell.lot.is_not(None)
    query = select(cell.scenario, func.count()).where(*mine).group_by(cell.scenario)
    return dict(connection.execute(query).all())


def references(connection: Connection, campaign_sequence: int, lot_ids: Sequence[int]) -> dict[int, set[int]]:
    """Returns the evaluations that are to answer, or are compared with, the cells of a campaign's lots of references, by lot."""
    cell = evaluations.c
    query = select(cell.lot, cell.reference).where(cell.campaign_sequence == campaign_sequence, cell.lot.in_(list(lot_ids)))
    listed: dict[int, set[int]] = {number: set() for number in lot_ids}
    for number, reference in connection.execute(query.where(cell.reference.is_not(None))) if lot_ids else ():
        listed[number].add(reference)
    return listed


def errors_so_far(connection: Connection, campaign_sequence: int, lot_ids: Sequence[int]) -> dict[int, int]:
    """Returns the errors in the samples of a campaign's lots, by id: differing answers, and cells without a result."""
    cell = evaluations.c
    wrong = (SAMPLED, cell.outcome.is_not(None), cell.agrees.is_distinct_from(True))
    query = (
        select(cell.lot, func.count())
        .where(cell.campaign_sequence == campaign_sequence, cell.lot.in_(list(lot_ids)), *wrong)
        .group_by(cell.lot)
    )
    return dict(connection.execute(query).all()) if lot_ids else {}


def error_sizes(connection: Connection, campaign_sequence: int) -> dict[str, tuple[float, float]]:
    """Returns the mean and the largest absolute error of predictions in the samples of a campaign's released lots, by scenario. In the mean
    a sample stands for its share of the lot."""
    cell = evaluations.c
    size, weight = func.abs(cell.score - cell.predicted_score), lots.c.size * 1.0 / lots.c.sample
    query = (
        select(cell.scenario, func.sum(size * weight) / func.sum(weight), func.max(size))
        .join(lots, lots.c.id == cell.lot)
        .where(cell.campaign_sequence == campaign_sequence, SAMPLED, cell.score.is_not(None), cell.predicted_score.is_not(None))
        .where(lots.c.verdict == LotVerdict.RELEASED)
        .group_by(cell.scenario)
    )
    return {name: (mean, largest) for name, mean, largest in connection.execute(query)}


def release_predictions(connection: Connection, campaign_sequence: int, lot_ids: Sequence[int]) -> None:
    """Answers the waiting cells of a campaign's lots with their predictions. Nothing was sent to a worker, so that no cell has a lease."""
    cell = evaluations.c
    waiting = cell.outcome.is_(None), cell.plan == Outcome.PREDICTED
    answer = {"outcome": Outcome.PREDICTED, "score": cell.predicted_score, "rating": cell.predicted_rating}
    if lot_ids:
        mine = cell.campaign_sequence == campaign_sequence, cell.lot.in_(list(lot_ids))
        connection.execute(update(evaluations).where(*mine, *waiting).values(answer))


def conclude(connection: Connection, verdicts: Mapping[int, tuple[LotVerdict, int]]) -> None:
    """Stores verdicts and errors of lots, by id."""
    for number, (verdict, errors) in verdicts.items():
        connection.execute(update(lots).where(lots.c.id == number).values(verdict=verdict, errors=errors))


@dataclass(frozen=True, slots=True)
class KnownAnswer:
    """A simulated answer that a predictor may learn from. A cell that was predicted first has `predicted_score` and `confidence`.
    `stands_for` is the number of predictions that a sampled cell of a released lot represents, else 1."""

    scenario: str
    stage: StageName
    iteration: int
    individual: int
    parameters: ParameterSet
    score: float
    rating: float
    predicted_score: float | None
    confidence: float | None
    stands_for: float


def known_answers(
    connection: Connection, campaign_sequence: int, setup_ids: Collection[int], after: int
) -> tuple[list[KnownAnswer], int]:
    """Returns the simulated answers of a campaign in some setups, of cells stored `after` a cell's id, in the order of their
    request, and the id of the newest. Call it while no cell waits for its answer."""
    cell = evaluations.c
    weight = case(((lots.c.verdict == LotVerdict.RELEASED) & SAMPLED, lots.c.size * 1.0 / lots.c.sample), else_=1.0)
    place = cell.scenario, cell.stage, cell.iteration, cell.individual
    known = cell.score, cell.rating, cell.predicted_score, cell.confidence, weight
    query = (
        select(cell.id, *place, parameter_sets.c.parameter_values, *known)
        .join(parameter_sets)
        .outerjoin(lots, lots.c.id == cell.lot)
        .where(*stored_after(campaign_sequence, after), cell.setup_id.in_(list(setup_ids)), cell.outcome == Outcome.SIMULATED)
        .order_by(cell.stage, cell.iteration, cell.individual, cell.scenario)
    )
    rows = connection.execute(query).all()
    answers = [KnownAnswer(*row[1:5], parsed(row.parameter_values), *row[6:]) for row in rows]
    return answers, max((row.id for row in rows), default=after)
