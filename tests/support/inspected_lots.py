"""Batches of a scenario under predicted or reused answers, without a campaign: choose a lot, draw, compare, release or reject."""

from dataclasses import dataclass

import numpy as np

from drivecal.contracts.campaign import ErrorRate
from drivecal.reduction.audit import expected_error_rate
from drivecal.reduction.lots import SamplingPlan, best_plan, draw
from drivecal.reduction.prediction import Bools, Floats, ScenarioLearner, choose_lot


@dataclass(slots=True)
class Tally:
    """Counts of a scenario. `inspected`: predictions in lots; `different`: released ones off by more than the tolerance; `simulated`: runs,
    samples among them."""

    cells: int = 0
    simulated: int = 0
    released: int = 0
    different: int = 0
    lots: int = 0
    inspected: int = 0
    rejected: int = 0
    sampled: int = 0


def inspect(learner: ScenarioLearner, features: Floats, scores: Floats, ratings: Floats, limit: float, secret: bytes) -> Tally:
    """Answers a batch, n sets with features of shape (n, k); the learner then learns what was simulated."""
    tally = Tally(cells=len(scores), simulated=len(scores))
    told = learner.predict(features)
    if told is None:
        learner.learn(features, scores, ratings)
        return tally
    predictions, error_rates = told
    lot = choose_lot(error_rates, limit)
    wrong = learner.is_wrong(predictions.scores, scores)
    simulated, weight = np.arange(len(scores)), np.ones(len(scores))
    if lot is not None:
        sampled = lot.members[draw([int(member).to_bytes(8) for member in lot.members], lot.plan.sample, secret)]
        tally.lots, tally.inspected, tally.sampled = 1, lot.plan.size, len(sampled)
        if lot.plan.releases(int(wrong[sampled].sum())):
            released = np.setdiff1d(lot.members, sampled)
            tally.released, tally.different = len(released), int(wrong[released].sum())
            simulated, weight[sampled] = np.setdiff1d(simulated, released), lot.plan.size / lot.plan.sample
        else:
            tally.rejected = 1
    tally.simulated = len(simulated)
    learner.learn(features[simulated], scores[simulated], ratings[simulated])
    seen = predictions.scores[simulated], predictions.confidence[simulated]
    learner.observe(*seen, scores[simulated], weight[simulated])
    return tally


def plan_of_references(size: int, limit: float, known: ErrorRate) -> SamplingPlan:
    """The plan of a lot of references, as campaigns choose it."""
    return best_plan(size, limit, expected_error_rate(known))


def inspect_references(wrong: Bools, limit: float, known: ErrorRate, secret: bytes) -> tuple[Tally, ErrorRate]:
    """Inspects a lot of references, some of them `wrong`, and adds its sample to the audits `known`."""
    plan = plan_of_references(len(wrong), limit, known)
    sampled = draw([place.to_bytes(8) for place in range(len(wrong))], plan.sample, secret)
    errors = int(wrong[sampled].sum())
    tally = Tally(cells=len(wrong), simulated=len(wrong), lots=1, inspected=len(wrong), sampled=plan.sample)
    if plan.releases(errors):
        tally.released = tally.cells - plan.sample
        tally.simulated, tally.different = plan.sample, int(wrong.sum()) - errors
    else:
        tally.rejected = 1
    seen = {"audited": known.audited + plan.sample, "wrong": known.wrong + errors, "lots": known.lots + 1}
    return tally, known.model_copy(update=seen)
