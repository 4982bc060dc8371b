"""The prediction of a cell with the stored answers behind it: the predictor learns once more what it knew when the cell was requested."""

from itertools import groupby

import numpy as np
from sqlalchemy import Connection

from drivecal.campaigns.cells.predicting import batch_of, slice_size
from drivecal.campaigns.resolve.resolved_spec import ResolvedSpec, specification_of
from drivecal.contracts.explanation import InspectedLot, Neighbour, Prediction
from drivecal.reduction.prediction import MOST_KNOWN, FeatureSpace, ScenarioLearner
from drivecal.storage import lots, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.lots import StoredLot
from drivecal.storage.references import runs
from drivecal.storage.results import StoredEvaluation

NEIGHBOURS = 5
"""Stored sets that are listed."""


def prediction_of(
    connection: Connection,
    campaign: StoredCampaign,
    cell: StoredEvaluation,
    resolved: ResolvedSpec,
) -> Prediction | None:
    """Returns the prediction of a calibration's cell with the stored answers of most weight; None if no predictor was asked."""
    if cell.predicted_score is None or cell.confidence is None:
        return None
    return Prediction(
        score=cell.predicted_score,
        confidence=cell.confidence,
        sampled=cell.sampled,
        agrees=cell.agrees if cell.sampled else None,
        lot=None if cell.lot is None else inspected_lot(lots.by_id(connection, cell.lot)),
        neighbours=_neighbours(connection, campaign, cell, resolved),
    )


def inspected_lot(lot: StoredLot) -> InspectedLot:
    """Returns a stored lot as an explanation shows it."""
    return InspectedLot(
        id=lot.id,
        size=lot.size,
        sample=lot.sample,
        acceptance=lot.acceptance,
        tolerance=lot.tolerance,
        limit=lot.aoql,
        known=lot.known,
        errors=lot.errors,
        verdict=lot.verdict,
    )


def _neighbours(
    connection: Connection, campaign: StoredCampaign, cell: StoredEvaluation, resolved: ResolvedSpec
) -> list[Neighbour]:
    from drivecal.reduction.regression_forest import predictor_on  # scikit-learn loads slowly

    specification = specification_of(campaign)
    if specification.optimizer is None:
        return []
    tolerance, width = specification.reduction.tolerance_on(resolved.scale), slice_size(specification.optimizer.population)
    features = FeatureSpace(resolved.space, resolved.space.names)
    learner = ScenarioLearner(predictor_on(resolved.scale, tolerance), tolerance)
    own = batch_of(cell.stage, cell.iteration, cell.individual, width)
    earlier = runs.rated(connection, cell.setup_id, resolved.evaluator, campaign.watermark or 0, MOST_KNOWN)
    answers, _ = lots.known_answers(connection, campaign.sequence, [cell.setup_id], after=0)
    batches = [[(run.evaluation, run.parameters, run.score) for run in earlier if features.holds(run.parameters)]]
    for batch, listed in groupby(answers, lambda answer: batch_of(answer.stage, answer.iteration, answer.individual, width)):
        if batch < own:
            batches.append([(answer.id, answer.parameters, answer.score) for answer in listed])
    for known in batches:
        scores = np.array([score for _, _, score in known], dtype=np.float64)
        learner.learn(features([parameters for _, parameters, _ in known]), scores, np.zeros(len(known)))
    predictor = learner.fitted()
    if predictor is None:
        return []
    weights = predictor.weights(features([cell.parameters]))
    trained = [each for known in batches for each in known][: learner.trained_on][-len(weights) :]
    heaviest = np.argsort(-weights, kind="stable")[:NEIGHBOURS].tolist()
    neighbours = [(results.by_id(connection, trained[place][0]), trained[place][2], weights[place]) for place in heaviest]
    return [
        Neighbour(
            evaluation=neighbour.id,
            stage=neighbour.stage,
            iteration=neighbour.iteration,
            individual=neighbour.individual,
            score=score,
            weight=float(weight),
            parameters=neighbour.parameters.floats,
        )
        for neighbour, score, weight in neighbours
    ]
