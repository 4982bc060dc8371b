"""Checks that a database is whole: the backend's own checks, and what drivecal promises of its rows. Only reads.

Each check returns a message per fault.
"""

import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice

from sqlalchemy import (
    ColumnElement,
    Connection,
    FromClause,
    SmallInteger,
    and_,
    case,
    exists,
    func,
    or_,
    select,
    text,
    type_coerce,
)

from drivecal.bundles.archives import content_digest
from drivecal.contracts.campaign import CellCounts
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.errors import InvalidInputError
from drivecal.domain.evaluations import ANSWERED_BY_DONOR, INSPECTED, Outcome
from drivecal.storage.campaigns import by_stage
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.tables import (
    bundles,
    campaign_stages,
    campaigns,
    evaluations,
    generations,
    leases,
    lots,
    ratings,
    reference_indexes,
    reference_keys,
    runs,
)
from drivecal.storage.engine.types import ORDER
from drivecal.storage.lots import LotVerdict
from drivecal.storage.maintenance.backup import last_numbers
from drivecal.storage.references.runs import largest_id

Check = Callable[[Connection], Iterator[str]]
TOLD = 5
"""Problems listed per check."""


@dataclass(frozen=True, slots=True)
class VerificationResult:
    """The problems that a check reports; empty if all is well."""

    name: str
    problems: tuple[str, ...]
    seconds: float


def verify(database: Database) -> Iterator[VerificationResult]:
    """Runs all checks on one snapshot of a database at this drivecal's revision."""
    with database.read() as connection:
        for name, check in CHECKS.items():
            started = time.perf_counter()
            sentences = check(connection)
            first = list(islice(sentences, TOLD))
            more = sum(1 for _ in sentences)
            if more:
                first.append(f"and {more:,} more")
            yield VerificationResult(name, tuple(first), time.perf_counter() - started)


def check_storage(connection: Connection) -> Iterator[str]:
    """The backend itself finds its file, indexes and foreign keys in order."""
    if connection.dialect.name == "sqlite":
        messages = connection.exec_driver_sql("PRAGMA integrity_check(5)").scalars()
        yield from (f"SQLite reports: {message}" for message in messages if message != "ok")
        for table, row, parent, _ in connection.exec_driver_sql("PRAGMA foreign_key_check").fetchmany(5):
            yield f"row {row} of {table} points to a row of {parent} that is not there"
        return
    invalid = text(
        "SELECT c.relname FROM pg_index i JOIN pg_class c ON c.oid = i.indexrelid JOIN pg_namespace n ON n.oid = c.relnamespace"
        " WHERE n.nspname = current_schema() AND NOT (i.indisvalid AND i.indisready)"
        " UNION ALL SELECT conname FROM pg_constraint WHERE connamespace = CAST(current_schema() AS regnamespace) AND NOT convalidated"
    )
    yield from (f"PostgreSQL says that {name} is not valid; REINDEX or VALIDATE it" for name in connection.scalars(invalid))


ENDED = tuple(state for state in CampaignState if state.ended)
ROWS = 100
"""Rows in memory at a time."""


def check_counters(connection: Connection) -> Iterator[str]:
    """The counters of each campaign count its cells, and add up."""
    counted: dict[tuple[int, int], Counter[str]] = {}
    stage = type_coerce(evaluations.c.stage, SmallInteger)
    columns = evaluations.c.campaign_sequence, stage, evaluations.c.outcome, evaluations.c.purpose
    by_outcome = select(*columns, func.count(), func.sum(evaluations.c.runs)).group_by(*columns)
    for sequence, number, outcome, purpose, count, starts in connection.execute(by_outcome):
        cells = counted.setdefault((sequence, number), Counter())
        cells.update({outcome or "pending": count, "runs": starts})
        if outcome == Outcome.SIMULATED and purpose in INSPECTED:
            cells[INSPECTED[purpose]] += count
    for sequence, figures in connection.execute(select(generations.c.campaign_sequence, generations.c.figures)):
        calibrated = counted.setdefault((sequence, ORDER[StageName.CALIBRATION]), Counter())
        calibrated["carried_over"] += figures.carried_over
    query = select(campaigns.c.sequence, campaigns.c.id, by_stage()).where(_WHOLE).order_by(campaigns.c.sequence)
    for row in connection.execute(query):
        for stage_of in StageName:
            cells = counted.get((row.sequence, ORDER[stage_of]), Counter())
            cells["requested"] = sum(cells[outcome] for outcome in Outcome)
            cells["proposed"] = sum(cells[part] for part in ("carried_over", "pending", "requested"))
            for part, count in CellCounts(**row.stages.get(stage_of, {})).model_dump().items():
                if part not in _NOT_IN_ROWS and count != cells[part]:
                    yield f"campaign {row.id} counts {count} {part} in its {stage_of}, its rows {cells[part]}"


_NOT_IN_ROWS = {"unrepeatable", "unscored", "cut", "lost", "shared", "discarded"}
_WHOLE = campaigns.c.deleted_at.is_(None)
"""Campaigns with all their cells: a deleted one counts its former cells."""


def check_ended(connection: Connection) -> Iterator[str]:
    """Campaigns that have ended have no leases, and succeeded ones no cell without an answer; answered cells have no lease."""
    ended = campaigns.c.state.in_(ENDED)
    for row in connection.execute(select(campaigns.c.id, campaigns.c.state).where(ended != campaigns.c.ended_at.is_not(None))):
        yield f"campaign {row.id} is {row.state}, and its end is {'not ' if row.state in ENDED else ''}written down"
    cells = evaluations.join(campaigns)
    pending = select(campaigns.c.id, func.count()).select_from(cells).where(evaluations.c.outcome.is_(None))
    for name, count in connection.execute(pending.where(campaigns.c.state == CampaignState.SUCCEEDED).group_by(campaigns.c.id)):
        yield f"campaign {name} has succeeded, and {count} of its cells have no answer"
    leased = select(campaigns.c.id, func.count()).select_from(leases.join(cells)).group_by(campaigns.c.id)
    for name, count in connection.execute(leased.where(ended)):
        yield f"campaign {name} has ended, and {count} of its cells are leased"
    for name, count in connection.execute(leased.where(evaluations.c.outcome.is_not(None))):
        yield f"{count} cells of campaign {name} have their answers, and are leased"


def check_answers(connection: Connection) -> Iterator[str]:
    """Every answered cell has its run, of its own setup; every copy was answered by a result that may answer others."""
    cell, run, donor = evaluations.c, runs.alias("run"), evaluations.alias("donor")
    joined = evaluations.outerjoin(run, run.c.id == cell.run_id).outerjoin(donor, donor.c.id == cell.reference)
    same = and_(
        run.c.setup_id == cell.setup_id, or_(cell.outcome == Outcome.REUSED, run.c.parameter_set_id == cell.parameter_set_id)
    )
    of_claims = campaign_stages.c.campaign_sequence == cell.campaign_sequence, campaign_stages.c.stage == StageName.CLAIMS
    single = campaigns.c.sequence == cell.campaign_sequence, campaigns.c.kind == "evaluation"
    same |= (cell.outcome == Outcome.REPEATED) & (exists().where(*of_claims) | exists().where(*single))  # by an earlier version
    answered = cell.outcome.in_((Outcome.SIMULATED, *ANSWERED_BY_DONOR))
    broken = answered & (run.c.id.is_(None) | ~same)
    yield from _cells(connection, joined, broken, "have no run of their own cell")
    scored = answered | (cell.outcome == Outcome.PREDICTED)
    yield from _cells(connection, joined, scored & (cell.score.is_(None) | cell.rating.is_(None)), "have no score")
    failed = (cell.outcome == Outcome.FAILED) & (cell.run_id.is_not(None) | cell.score.is_not(None))
    yield from _cells(connection, joined, failed, "failed and have a result all the same")
    orphaned = cell.outcome.in_(ANSWERED_BY_DONOR) & (
        donor.c.id.is_(None) | (donor.c.outcome != Outcome.SIMULATED) | donor.c.outcome.is_(None)
    )
    yield from _cells(connection, joined, orphaned, "are copies of cells that may not answer others")


def check_lots(connection: Connection) -> Iterator[str]:
    """Checks that lots' answers are released by inspected lots alone, and that lots with a verdict have their sample and no open cell."""
    cell = evaluations.c
    joined = evaluations.outerjoin(lots, lots.c.id == cell.lot)
    released = lots.c.verdict.is_not_distinct_from(LotVerdict.RELEASED)
    unchecked = (cell.outcome == Outcome.PREDICTED) & (cell.purpose.in_(list(INSPECTED)) | cell.run_id.is_not(None) | ~released)
    yield from _cells(connection, joined, unchecked, "are predictions that no inspected lot released")
    uninspected = (cell.outcome == Outcome.REUSED) & cell.lot.is_not(None) & ~released
    yield from _cells(connection, joined, uninspected, "are reused, and their lots were not released")
    other = cell.lot.is_not(None) & cell.outcome.in_(ANSWERED_BY_DONOR) & (lots.c.kind != cell.outcome)
    yield from _cells(connection, joined, other, "are copies in lots of another kind")
    members = (
        func.count(cell.id),
        func.sum(case((cell.purpose.in_(list(INSPECTED)), 1), else_=0)),
        # a reused answer whose reference has no result is simulated after the verdict
        func.sum(
            case((cell.outcome.is_(None) & ((lots.c.kind != Outcome.REUSED) | (cell.plan == Outcome.REUSED)), 1), else_=0)
        ),
    )
    query = (
        select(lots.c.id, lots.c.size, lots.c.sample, lots.c.verdict, *members)
        .select_from(lots.join(campaigns).outerjoin(evaluations, lots.c.id == cell.lot))
        .where(_WHOLE)
        .group_by(lots.c.id, lots.c.size, lots.c.sample, lots.c.verdict)
    )
    for identifier, size, sample, verdict, count, drawn, waiting in connection.execute(query):
        if count != size:
            yield f"lot {identifier} of {size} answers has {count} cells"
        if verdict is not None and (drawn or 0) != sample:
            yield f"lot {identifier} was {verdict} by a sample of {drawn} cells, not {sample}"
        if verdict == LotVerdict.RELEASED and waiting:
            yield f"lot {identifier} was released, and {waiting} of its cells have no answer"


def _cells(connection: Connection, joined: FromClause, broken: ColumnElement[bool], sentence: str) -> Iterator[str]:
    query = select(func.count(), func.min(evaluations.c.id)).select_from(joined).where(broken)
    count, first = connection.execute(query).one()
    if count:
        yield f"{count:,} answered cells {sentence}, the first of them evaluation {first}"


def check_references(connection: Connection) -> Iterator[str]:
    """Checks that each setup and parameter set has one rated run of an existing cell."""
    origin = evaluations.alias("origin")
    several = select(runs.c.setup_id, runs.c.parameter_set_id).group_by(runs.c.setup_id, runs.c.parameter_set_id)
    for setup, parameters in connection.execute(several.having(func.count() > 1).limit(5)):
        yield f"parameter set {parameters} has several runs in setup {setup}"
    unrated = ~exists().where(ratings.c.run_id == runs.c.id)
    lost = ~exists().where(origin.c.id == runs.c.evaluation_id, origin.c.campaign_sequence == runs.c.campaign_sequence)
    for sentence, broken in (("have no rating", unrated), ("were simulated for no cell that is there", lost)):
        count, first = connection.execute(select(func.count(), func.min(runs.c.id)).where(broken)).one()
        if count:
            yield f"{count:,} runs {sentence}, the first of them run {first}"
    newest = max(largest_id(connection), last_numbers(connection, [runs]).get("runs", 0))
    beyond = select(campaigns.c.id, campaigns.c.watermark).where(campaigns.c.watermark > newest).limit(5)
    for name, watermark in connection.execute(beyond):
        yield f"campaign {name} may use runs up to {watermark}, and the newest is {newest}"


def check_key_copies(connection: Connection) -> Iterator[str]:
    """Checks that reference keys agree with their runs."""
    key = reference_keys.c
    joined = (
        reference_keys.outerjoin(reference_indexes, reference_indexes.c.id == key.index_id)
        .outerjoin(runs, (runs.c.id == key.run_id) & (runs.c.setup_id == reference_indexes.c.setup_id))
        .outerjoin(ratings, (ratings.c.run_id == key.run_id) & (ratings.c.evaluator == reference_indexes.c.evaluator))
    )
    differs = or_(
        ratings.c.run_id.is_(None),
        runs.c.id.is_(None),
        key.run_id > reference_indexes.c.run_id,
        key.since > reference_indexes.c.run_id,
        key.since != ratings.c.since,
        key.evaluation_id != runs.c.evaluation_id,
        key.score != ratings.c.score,
        key.rating != ratings.c.rating,
        key.failure.is_distinct_from(runs.c.failure),
    )
    used = reference_indexes.c.id.is_(None) | (reference_indexes.c.influence_map_sequence > 0)  # others are being removed
    count = connection.execute(select(func.count()).select_from(joined).where(differs, used)).scalar_one()
    if count:
        yield f"{count:,} reference keys differ from the runs that they stand for"


def check_bundles(connection: Connection) -> Iterator[str]:
    """Compares pushed problems with their digests."""
    for digest, archive in connection.execute(select(bundles.c.digest, bundles.c.archive).execution_options(yield_per=1)):
        try:
            is_whole = content_digest(archive) == digest
        except InvalidInputError:
            is_whole = False
        if not is_whole:
            yield f"the content of the problem with the digest {digest[:12]} is another one"


CHECKS: dict[str, Check] = {
    "storage": check_storage,
    "counters": check_counters,
    "ended campaigns": check_ended,
    "answered cells": check_answers,
    "lots": check_lots,
    "references": check_references,
    "copies in reference keys": check_key_copies,
    "problems": check_bundles,
}
