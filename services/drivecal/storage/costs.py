"""Cost of a campaign's cells, summed by how they were answered."""

from collections.abc import Sequence
from statistics import fmean

from sqlalchemy import Connection, case, func, select

from drivecal.domain.evaluations import Outcome, OutcomeCosts
from drivecal.storage.engine.bulk import rows_among
from drivecal.storage.engine.tables import evaluations, runs, setups
from drivecal.storage.references.runs import occupying

RECENT_RUNS = 1_000
"""Runs of a setup that predict the cost of the next."""


def by_outcome(connection: Connection, campaign_sequence: int) -> list[OutcomeCosts]:
    """The answered cells of a campaign, ordered by stage and scenario.

    A cell's time less its run's is what certificates took. Runs stored by releases that did not measure it count as if they took nothing.
    """
    group = (evaluations.c.stage, evaluations.c.scenario, evaluations.c.outcome, evaluations.c.audited)
    maker = evaluations.alias("maker")
    is_simulated = runs.c.id.is_not(None) & (maker.c.outcome.is_(None) | (maker.c.outcome != Outcome.CERTIFIED))
    certifying = case(
        (evaluations.c.outcome == Outcome.CERTIFIED, evaluations.c.milliseconds),
        (runs.c.evaluation_id == evaluations.c.id, evaluations.c.milliseconds - runs.c.milliseconds),
    )
    query = (
        select(
            *group,
            func.count(),
            func.coalesce(func.sum(evaluations.c.milliseconds), 0.0),
            func.count(case((is_simulated, 1))),
            func.coalesce(func.sum(case((is_simulated, runs.c.milliseconds))), 0.0),
            func.coalesce(func.sum(certifying), 0.0),
            func.coalesce(func.sum(case((runs.c.evaluation_id == evaluations.c.id, occupying()))), 0.0),
            func.coalesce(func.sum(case((is_simulated, occupying()))), 0.0),
        )
        .select_from(
            evaluations.outerjoin(runs, runs.c.id == evaluations.c.run_id).outerjoin(maker, maker.c.id == runs.c.evaluation_id)
        )
        .where(evaluations.c.campaign_sequence == campaign_sequence, evaluations.c.outcome.is_not(None))
        .group_by(*group)
        .order_by(*group)
    )
    return [
        OutcomeCosts(
            *(stage, scenario, Outcome(outcome), audited, cells, own / 1000, simulated, answered / 1000, certified / 1000),
            *(occupied / 1000, occupying_runs / 1000),
        )
        for stage, scenario, outcome, audited, cells, own, simulated, answered, certified, occupied, occupying_runs in connection.execute(
            query
        )
    ]


def recent_milliseconds(connection: Connection, fingerprints: Sequence[str]) -> float | None:
    """Time for which one simulation without certificates occupies a worker, over the newest ones in each of these setups, which count
    alike; None if there is none in one. Runs that were proved are not among them: they took next to nothing."""
    means = []
    for (setup,) in rows_among(connection, select(setups.c.id), setups.c.fingerprint, fingerprints):
        newest = select(occupying().label("milliseconds"), runs.c.evaluation_id).where(runs.c.setup_id == setup)
        recent = newest.order_by(runs.c.id.desc()).limit(RECENT_RUNS).subquery()
        simulated = select(recent.c.milliseconds).join(evaluations, evaluations.c.id == recent.c.evaluation_id)
        times = connection.scalars(simulated.where(evaluations.c.proven_by.is_(None))).all()
        means += [fmean(times)] if times else []
    return fmean(means) if fingerprints and len(means) == len(fingerprints) else None
