"""The self-check: scores of audited cells against their donors', and results that contradict each other.

A donor of the campaign's own has the score that it was answered with. That of another campaign's donor is its run's rating by this
campaign's evaluator: the evaluation that made the run may have been rated by another one.
"""

from collections import Counter
from collections.abc import Sequence

from sqlalchemy import Connection, FromClause, case, func, select, update

from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import AuditCount, Donor, Outcome
from drivecal.domain.scales import COMFORT, Scale
from drivecal.storage.engine.bulk import rows_among
from drivecal.storage.engine.tables import evaluations, ratings, reference_indexes, reference_keys
from drivecal.storage.evaluations import AUDITED, of_iteration

_donor = evaluations.alias("donor")
_trusted = ratings.alias("trusted")


def settle(
    connection: Connection, campaign_sequence: int, stage: StageName, iteration: int, evaluator: str, scale: Scale = COMFORT
) -> None:
    """Stores for the audited cells of a finished iteration whether the donor had the same score."""
    score = (
        select(_TRUSTED)
        .select_from(_rated(_donor, evaluator))
        .where(_donor.c.id == evaluations.c.reference)
        .correlate(evaluations)
        .scalar_subquery()
    )
    connection.execute(
        update(evaluations)
        .where(*of_iteration(campaign_sequence, stage, iteration), *_SETTLED)
        .values(agrees=func.abs(evaluations.c.score - score) <= scale.rounding)
    )


def count(connection: Connection, campaign_sequence: int, evaluator: str, scale: Scale = COMFORT) -> list[AuditCount]:
    """Returns the audit of a campaign so far, by scenario: simulated scores against known scores of donors."""
    scenario, different, wrong = evaluations.c.scenario, scale.rounding < _CHANGE, scale.largest_agreeing < _CHANGE
    counts = func.count(), func.count(case((different, 1))), func.count(case((wrong, 1)))
    compared = evaluations.c.campaign_sequence == campaign_sequence, *_SETTLED, _TRUSTED.is_not(None)
    query = select(scenario, *counts).select_from(_audited(evaluator)).where(*compared).group_by(scenario).order_by(scenario)
    return [AuditCount(*row) for row in connection.execute(query)]


def wrong_in_lots(
    connection: Connection, campaign_sequence: int, evaluator: str, scale: Scale, lot_ids: Sequence[int]
) -> dict[int, int]:
    """Returns the audited cells of lots whose reference has a wrong score, or that have no result while it has one, by lot."""
    failed = evaluations.c.outcome == Outcome.FAILED
    query = (
        select(evaluations.c.lot, func.count())
        .select_from(_audited(evaluator))
        .where(evaluations.c.campaign_sequence == campaign_sequence, evaluations.c.lot.in_(list(lot_ids)))
        .where(AUDITED, _TRUSTED.is_not(None), failed | (scale.largest_agreeing < _CHANGE))
        .group_by(evaluations.c.lot)
    )
    return dict(connection.execute(query).all()) if lot_ids else {}


def sampled_sets(connection: Connection, campaign_sequence: int, lot: int) -> set[int]:
    """Returns the parameter sets of the audited cells of a lot."""
    cell = evaluations.c
    query = select(cell.parameter_set_id).where(cell.campaign_sequence == campaign_sequence, cell.lot == lot, AUDITED)
    return set(connection.scalars(query))


def trusted(connection: Connection, campaign_sequence: int, evaluator: str, references: Sequence[int]) -> dict[int, Donor]:
    """Returns the results of references as a campaign's evaluator rates them, by id; those without a result are left out."""
    mine = _donor.c.campaign_sequence == campaign_sequence
    score, rating = (case((mine, _donor.c[name]), else_=_trusted.c[name]) for name in ("score", "rating"))
    query = select(_donor.c.id, _donor.c.run_id, score, rating, _donor.c.failure).select_from(_rated(_donor, evaluator))
    usable = query.where(_donor.c.outcome == Outcome.SIMULATED, score.is_not(None))
    return {row[0]: Donor(*row) for row in rows_among(connection, usable, _donor.c.id, references)}


def contradictions(
    connection: Connection,
    campaign_sequence: int,
    influence_map_sequence: int,
    evaluator: str,
    watermark: int,
    scale: Scale = COMFORT,
) -> dict[str, int]:
    """Returns the number of reference keys whose simulated results in a setup differ in their score, by scenario, without zeros.

    Compares the campaign's own simulated cells with each other, and with the stored references of their keys up to `watermark`.
    """
    index, stored_key, stored = reference_indexes.alias("index"), reference_keys.alias("stored_key"), ratings.alias("stored")
    in_setup = (index.c.influence_map_sequence == influence_map_sequence) & (index.c.setup_id == evaluations.c.setup_id)
    same_key = (stored_key.c.index_id == index.c.id) & (stored_key.c.key == evaluations.c.reference_key)
    seen = (stored_key.c.run_id <= watermark) & (stored_key.c.since <= watermark)
    joined = (
        evaluations.outerjoin(index, in_setup & (index.c.evaluator == evaluator))
        .outerjoin(stored_key, same_key & seen)
        .outerjoin(stored, (stored.c.run_id == stored_key.c.run_id) & (stored.c.evaluator == evaluator))
    )
    own, other = evaluations.c.score, stored.c.score
    contradicting = (
        select(evaluations.c.scenario)
        .select_from(joined)
        .where(
            evaluations.c.campaign_sequence == campaign_sequence,
            evaluations.c.reference_key.is_not(None),
            evaluations.c.plan == Outcome.SIMULATED,
            evaluations.c.outcome == Outcome.SIMULATED,
        )
        .group_by(evaluations.c.scenario, evaluations.c.reference_key, evaluations.c.setup_id)  # a setup for each seed
        .having(
            (func.max(own) - func.min(own) > scale.rounding)
            | (func.max(other) - func.min(other) > scale.rounding)
            | (func.abs(func.min(other) - func.min(own)) > scale.rounding)
        )
    )
    return dict(Counter(connection.scalars(contradicting)))


_OWN = _donor.c.campaign_sequence == evaluations.c.campaign_sequence
_TRUSTED = case((_OWN, _donor.c.score), else_=_trusted.c.score)
_CHANGE = func.abs(evaluations.c.score - _TRUSTED)
_SETTLED = AUDITED, evaluations.c.outcome == Outcome.SIMULATED


def _audited(evaluator: str) -> FromClause:
    return _rated(evaluations.join(_donor, _donor.c.id == evaluations.c.reference), evaluator)


def _rated(donors: FromClause, evaluator: str) -> FromClause:
    return donors.outerjoin(_trusted, (_trusted.c.run_id == _donor.c.run_id) & (_trusted.c.evaluator == evaluator))
