"""The prediction of a cell with the stored answers behind it: the predictor learns once more what it knew when the cell was requested."""

from collections.abc import Mapping
from functools import partial

import numpy as np
from sqlalchemy import Connection

from drivecal.campaigns.cells.predicting import batch_of, slice_size
from drivecal.campaigns.resolve.resolved_spec import ResolvedSpec
from drivecal.contracts.explanation import InspectedLot, Neighbour, Prediction
from drivecal.contracts.specification import CampaignSpecification
from drivecal.domain.parameters import ParameterSet
from drivecal.reduction.prediction import MOST_KNOWN, FeatureSpace, ScenarioLearner
from drivecal.storage import lots, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.references import runs
from drivecal.storage.results import StoredEvaluation

NEIGHBOURS = 5
"""Stored sets that are listed."""


def prediction_of(
    connection: Connection,
    campaign: StoredCampaign,
    cell: StoredEvaluation,
    resolved: ResolvedSpec,
    neighbours: int = NEIGHBOURS,
) -> Prediction | None:
    """Returns the prediction of a calibration's cell with the `neighbours` of most weight; None if no predictor was asked."""
    if cell.predicted_score is None or cell.confidence is None:
        return None
    return Prediction(
        score=cell.predicted_score,
        confidence=cell.confidence,
        sampled=cell.sampled,
        agrees=cell.agrees if cell.sampled else None,
        lot=None if cell.lot is None else _lot(connection, campaign.sequence, cell.lot),
        neighbours=_neighbours(connection, campaign, cell, resolved, neighbours),
    )


def _lot(connection: Connection, campaign_sequence: int, number: int) -> InspectedLot:
    (lot,) = (lot for lot in lots.of_campaign(connection, campaign_sequence) if lot.id == number)
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
    connection: Connection, campaign: StoredCampaign, cell: StoredEvaluation, resolved: ResolvedSpec, most: int
) -> list[Neighbour]:
    from drivecal.reduction.forest import Forest  # scikit-learn loads slowly

    specification = CampaignSpecification.model_validate(campaign.spec)
    if specification.optimizer is None:
        return []
    tolerance, width = specification.reduction.tolerance, slice_size(specification.optimizer.population)
    features = FeatureSpace(resolved.space, resolved.space.names)
    learner = ScenarioLearner(partial(Forest, tolerance), tolerance)
    watermark = campaign.watermark or 0
    evaluations: list[int] = []
    sets: list[ParameterSet] = []
    scores: list[int] = []
    for run in runs.rated(connection, cell.setup_id, resolved.evaluator, watermark, MOST_KNOWN):
        evaluations.append(run.evaluation)
        sets.append(run.parameters)
        scores.append(run.score)
    own = batch_of(cell.stage, cell.iteration, cell.individual, width)
    for answer in results.known(connection, campaign.sequence, [cell.setup_id], after=0)[0]:
        if batch_of(answer.stage, answer.iteration, answer.individual, width) < own:
            evaluations.append(answer.id)
            sets.append(answer.parameters)
            scores.append(answer.score)
    learner.learn(features(sets), np.array(scores, dtype=np.float64), np.zeros(len(scores)))
    predictor = learner.fitted()
    if not isinstance(predictor, Forest):
        return []
    weights = predictor.weights(features([cell.parameters]))
    newest = evaluations[-len(weights) :]
    heaviest = np.argsort(-weights, kind="stable")[:most].tolist()
    known: Mapping[int, StoredEvaluation] = {place: results.by_id(connection, newest[place]) for place in heaviest}
    first = len(scores) - len(weights)
    return [
        Neighbour(
            evaluation=neighbour.id,
            stage=neighbour.stage,
            iteration=neighbour.iteration,
            individual=neighbour.individual,
            score=scores[first + place],
            weight=float(weights[place]),
            parameters=neighbour.parameters.floats,
        )
        for place, neighbour in known.items()
    ]
