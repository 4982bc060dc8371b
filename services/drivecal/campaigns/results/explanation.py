"""Explains the answer of a cell from the rows that the campaign saw when it requested the cell."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from sqlalchemy import Connection

from drivecal.campaigns.resolve.maps import stored_map
from drivecal.campaigns.resolve.resolved_spec import ResolvedSpec, resolved_spec, specification_of
from drivecal.contracts.evaluation import Check, Difference, Explanation, InspectedLot, Prediction, Reason, Reference
from drivecal.contracts.specification import CampaignSpecification
from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import NotFoundError
from drivecal.domain.evaluations import INSPECTED, Outcome, Purpose
from drivecal.domain.influence import InfluenceMap
from drivecal.domain.values import billionths
from drivecal.reduction.explanation import CellComparison, Nearest, sentence
from drivecal.storage import audits, campaigns, lots, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.lots import StoredLot
from drivecal.storage.references import influence_maps, parameter_sets
from drivecal.storage.results import StoredEvaluation


@dataclass(frozen=True)
class _Case:
    """A cell with everything that decided its answer."""

    connection: Connection
    cell: StoredEvaluation
    campaign: StoredCampaign

    @cached_property
    def specification(self) -> CampaignSpecification | None:
        """The campaign's specification; None for a single evaluation."""
        return None if self.campaign.kind == "evaluation" else specification_of(self.campaign)

    @cached_property
    def influence_map(self) -> InfluenceMap:
        """The map that may let a reference answer the cell; a map without entries if only equal sets could answer it."""
        specification, map_id = self.specification, self.campaign.influence_map_id
        if specification is None or map_id is None or self.cell.stage is not StageName.CALIBRATION:
            return InfluenceMap({})
        if specification.reduction.mode not in {"influence", "both"}:
            return InfluenceMap({})
        return stored_map(influence_maps.get(self.connection, map_id))

    @cached_property
    def comparison(self) -> CellComparison:
        own = self.cell.parameter_set_id
        parameters = parameter_sets.load(self.connection, [own])[own]
        ranges = {
            parameter.name: billionths(parameter.upper) - billionths(parameter.lower)
            for parameter in self.pinned.space.parameters
        }
        return CellComparison(
            self.influence_map,
            self.cell.scenario,
            parameters.names,
            np.array(parameters.codes, dtype=np.int64),
            np.array([ranges[name] for name in parameters.names], dtype=np.int64),
        )

    @cached_property
    def lot(self) -> StoredLot | None:
        return None if self.cell.lot is None else lots.by_id(self.connection, self.cell.lot)

    @cached_property
    def pinned(self) -> ResolvedSpec:
        return resolved_spec(self.campaign)


def explain(connection: Connection, evaluation_id: int) -> Explanation:
    """Explains an evaluation's answer. Raises NotFoundError."""
    cell = results.by_id(connection, evaluation_id)
    case = _Case(connection, cell, campaigns.by_sequence(connection, cell.campaign_sequence))
    if cell.outcome is Outcome.FAILED:
        return _explanation(case, "failed")
    if cell.purpose in INSPECTED:
        return _explanation(case, "checked", *_reference(case, cell.reference))
    if cell.plan is Outcome.PREDICTED:
        return _explanation(case, "predicted")
    if (reason := _HITS.get(cell.plan)) is not None:
        return _explanation(case, reason, *_reference(case, cell.reference))
    if (confirmed := _trusted(case)) is not None:
        prediction = prediction_of(connection, confirmed) if confirmed.outcome is Outcome.PREDICTED else None
        return _explanation(case, "checked", *_reference(case, confirmed.reference), prediction=prediction)
    nearest, stored = _nearest(case)
    if nearest is None:
        return _explanation(case, "simulated", stored=0)
    return _explanation(case, "simulated", *_reference(case, nearest.evaluation), distance=nearest.distance, stored=stored)


_HITS: Mapping[Outcome, Reason] = {Outcome.REPEATED: "repeated", Outcome.REUSED: "reused"}


def _trusted(case: _Case) -> StoredEvaluation | None:
    """Returns the cell with the copied or predicted score that this cell's simulation confirmed after the search, None for other cells."""
    cell, specification = case.cell, case.specification
    if specification is None or specification.optimizer is None or cell.purpose is not Purpose.CONFIRMATION:
        return None
    return results.first_copy(case.connection, cell.campaign_sequence, cell.scenario, cell.parameter_set_id)


def _nearest(case: _Case) -> tuple[Nearest | None, int]:
    """Returns the nearest set that the campaign saw when it requested the cell, and the number of these sets.

    References of earlier campaigns precede its own.
    """
    cell, names = case.cell, case.cell.parameters.names
    watermark = case.campaign.watermark or 0
    nearest: Nearest | None = None
    stored = 0
    sources = (
        results.stored_sets(case.connection, cell.setup_id, case.pinned.evaluator, watermark, names),
        results.own_sets(case.connection, cell, names),
    )
    for rank, source in enumerate(sources):
        for sets in source:
            stored += len(sets.values)
            places = np.insert(sets.places, 0, rank, axis=1)
            candidate = case.comparison.nearest(sets.values, places, sets.evaluations)
            if candidate is not None and (nearest is None or candidate < nearest):
                nearest = candidate
    return nearest, stored


def _reference(case: _Case, evaluation_id: int | None) -> tuple[Reference | None, list[Difference]]:
    """Returns an evaluation that a cell names, and how their parameters differ; None if it was deleted with its campaign."""
    if evaluation_id is None:
        return None, []
    try:
        donor = results.by_id(case.connection, evaluation_id)
    except NotFoundError:
        return None, []
    claimed = sorted(set(donor.parameters.names) ^ set(case.cell.parameters.names))
    rated = audits.trusted(case.connection, case.campaign.sequence, case.pinned.evaluator, [donor.id]).get(donor.id, donor)
    owner = campaigns.by_sequence(case.connection, donor.campaign_sequence)
    reference = Reference.of(donor, evaluation=donor.id, campaign=owner.id, score=rated.score, claimed=claimed)
    return reference, [] if claimed else case.comparison.differences(case.cell.parameters, donor.parameters)


def _check(case: _Case, reference: Reference | None, prediction: Prediction | None) -> Check:
    own, expected = case.cell.score, None
    if reference is not None:
        expected = reference.score
    elif prediction is not None:
        expected = prediction.score
    if own is None or expected is None:
        return Check(expected=expected, agrees=None, wrong=None)
    change = abs(own - expected)
    return Check(expected=expected, agrees=change <= case.pinned.scale.rounding, wrong=case.pinned.scale.is_wrong(change))


def _explanation(
    case: _Case,
    reason: Reason,
    reference: Reference | None = None,
    differences: Sequence[Difference] = (),
    *,
    distance: float | None = None,
    stored: int | None = None,
    prediction: Prediction | None = None,
) -> Explanation:
    cell = case.cell
    prediction = prediction or prediction_of(case.connection, cell)
    answer = Explanation.of(
        cell,
        evaluation=cell.id,
        campaign=case.campaign.id,
        parameters=cell.parameters.floats,
        reason=reason,
        sentence="",
        reference=reference,
        differences=list(differences),
        check=_check(case, reference, prediction) if reason == "checked" else None,
        prediction=prediction,
        lot=None if case.lot is None or case.lot.kind is not Outcome.REUSED else inspected_lot(case.lot),
        distance=distance,
        stored=stored,
    )
    return answer.model_copy(update={"sentence": sentence(answer)})


def prediction_of(connection: Connection, cell: StoredEvaluation) -> Prediction | None:
    """Returns the prediction of a calibration's cell; None if no predictor was asked."""
    if cell.predicted_score is None or cell.confidence is None:
        return None
    return Prediction(
        score=cell.predicted_score,
        confidence=cell.confidence,
        sampled=cell.purpose is Purpose.SAMPLE,
        agrees=cell.agrees if cell.purpose is Purpose.SAMPLE else None,
        lot=None if cell.lot is None else inspected_lot(lots.by_id(connection, cell.lot)),
    )


def inspected_lot(lot: StoredLot) -> InspectedLot:
    """Returns a stored lot as an explanation shows it."""
    return InspectedLot.of(lot, limit=lot.aoql)
