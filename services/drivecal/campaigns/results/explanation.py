"""Explains why a cell was reused or not, from what the campaign saw when it requested the cell."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from sqlalchemy import Connection

from drivecal.campaigns.resolve.maps import stored_map
from drivecal.campaigns.resolve.resolved_spec import ResolvedSpec, resolved_spec, specification_of
from drivecal.campaigns.results.prediction import inspected_lot, prediction_of
from drivecal.contracts.explanation import Audit, Difference, Explanation, Prediction, Proof, Reason, Reference
from drivecal.contracts.specification import CampaignSpecification
from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import NotFoundError
from drivecal.domain.evaluations import AuditCount, Outcome
from drivecal.domain.influence import InfluenceMap
from drivecal.domain.parameters import Setting, billionths
from drivecal.domain.scales import Scale, told
from drivecal.reduction import explanation
from drivecal.reduction.audit import stopped_after
from drivecal.reduction.explanation import CellComparison, Nearest
from drivecal.reduction.reasons import sentence
from drivecal.storage import audits, campaigns, lots, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.lots import LotVerdict, StoredLot
from drivecal.storage.references import influence_maps, parameter_sets, reference_candidates, runs
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
    def influence_map(self) -> InfluenceMap | None:
        if self.campaign.influence_map_id is None:
            return None
        return stored_map(influence_maps.get(self.connection, self.campaign.influence_map_id))

    @cached_property
    def comparison(self) -> CellComparison:
        own = self.cell.parameter_set_id
        parameters = parameter_sets.load(self.connection, [own])[own]
        ranges = {
            parameter.name: billionths(parameter.upper) - billionths(parameter.lower)
            for parameter in self._pinned.space.parameters
        }
        return CellComparison(
            self.influence_map or InfluenceMap({}),
            self.cell.scenario,
            parameters.names,
            np.array(parameters.codes, dtype=np.int64),
            np.array([ranges[name] for name in parameters.names], dtype=np.int64),
        )

    @cached_property
    def lot(self) -> StoredLot | None:
        return None if self.cell.lot is None else lots.by_id(self.connection, self.cell.lot)

    @cached_property
    def prediction(self) -> Prediction | None:
        return prediction_of(self.connection, self.campaign, self.cell, self._pinned)

    @cached_property
    def evaluator(self) -> str:
        """Name and version of the campaign's evaluator."""
        return self._pinned.evaluator

    @property
    def scale(self) -> Scale:
        """Scale of the campaign's scores."""
        return self._pinned.scale

    @cached_property
    def _pinned(self) -> ResolvedSpec:
        return resolved_spec(self.campaign)


def explain(connection: Connection, evaluation_id: int) -> Explanation:
    """Explains an evaluation's answer. Raises NotFoundError."""
    cell = results.by_id(connection, evaluation_id)
    case = _Case(connection, cell, campaigns.by_sequence(connection, cell.campaign_sequence))
    lot = case.lot
    if lot is not None and lot.kind is Outcome.PREDICTED and cell.outcome is not Outcome.CERTIFIED:
        released = cell.plan is Outcome.PREDICTED
        return _explanation(case, "predicted" if released else "sampled" if cell.sampled else "lot_rejected")
    if cell.plan is Outcome.SIMULATED and not cell.audited and cell.outcome is not Outcome.CERTIFIED:
        if lot is not None and lot.verdict is LotVerdict.REJECTED:
            return _explanation(case, "lot_rejected")
        return _not_reused(case)
    answered_as = Outcome.CERTIFIED if cell.outcome is Outcome.CERTIFIED else cell.plan
    reason: Reason = "audited" if cell.audited else _REASONS[answered_as]
    if cell.reference is None:
        raise AssertionError(f"evaluation {cell.id} names no reference")
    reference, differences = _reference(case, cell.reference)
    return _explanation(
        case, reason, reference=reference, differences=differences, audit=_audit(case, reference) if cell.audited else None
    )


_REASONS: Mapping[Outcome, Reason] = {
    Outcome.REPEATED: "repeated",
    Outcome.REUSED: "reused",
    Outcome.CERTIFIED: "certified",
}


def _not_reused(case: _Case) -> Explanation:
    trusted = _trusted(case)
    if trusted is not None and trusted.outcome is Outcome.PREDICTED:
        believed = replace(case, cell=trusted).prediction
        return _explanation(case, "confirmation", prediction=believed)
    if trusted is not None and trusted.reference is not None:
        reference, differences = _reference(case, trusted.reference)
        return _explanation(case, "confirmation", reference=reference, differences=differences, audit=_audit(case, reference))
    reason, stop = _forbidden(case)
    if reason is not None:
        return _explanation(case, reason, stop=stop)
    reference_set, stored = _nearest(case)
    if reference_set is None:
        return _explanation(case, "nothing_stored", stored=0)
    reference, differences = _reference(case, reference_set.evaluation)
    return _explanation(
        case,
        "blocked" if reference_set.blocking else "unanswered",
        reference=reference,
        differences=differences,
        distance=reference_set.distance,
        stored=stored,
    )


def _trusted(case: _Case) -> StoredEvaluation | None:
    """The cell with the copied or predicted score that this cell's simulation confirmed after the search; None for other cells."""
    cell, specification = case.cell, case.specification
    if specification is None or specification.optimizer is None or cell.stage is not StageName.CALIBRATION:
        return None
    if cell.iteration < specification.optimizer.iterations:
        return None
    return results.first_copy(case.connection, cell.campaign_sequence, cell.scenario, cell.parameter_set_id)


def _forbidden(case: _Case) -> tuple[Reason | None, tuple[int, AuditCount] | None]:
    """Returns the reason why no reuse was possible; if the self-check stopped it, after which iteration and by which audits."""
    specification, cell = case.specification, case.cell
    if specification is None:
        return "exact_only", None
    if specification.reduction.mode == "off":
        return "off", None
    if cell.stage is StageName.SENSITIVITY:
        return "analysis", None
    if cell.stage is not StageName.CALIBRATION:
        return "study", None
    if specification.reduction.mode == "exact":
        return "exact_only", None
    if cell.iteration == 0 and _is_given(case):
        return "given", None
    if specification.reduction.mode == "predicted" or (case.influence_map is None and specification.reduction.mode == "both"):
        return "not_predicted" if cell.confidence is None else "not_accepted", None
    if case.influence_map is None:
        return "no_map", None
    rate = case.campaign.error_rate.get(cell.scenario)
    if rate is not None and rate.stopped:
        counts = audits.by_iteration(case.connection, case.campaign.sequence, cell.scenario, case.evaluator, case.scale)
        stop = stopped_after(counts, specification.reduction.max_error)
        if stop is not None and cell.iteration > stop[0]:
            return "stopped", stop
    return None, None


def _is_given(case: _Case) -> bool:
    """Returns whether a set of the start population is the baseline or a given start set."""
    optimizer = None if case.specification is None else case.specification.optimizer
    baseline = case.campaign.baseline
    given: list[Mapping[str, Setting]] = [] if optimizer is None else list(optimizer.start_sets)
    given += [] if baseline is None else [baseline.parameters]
    values = case.cell.parameters.floats
    return any(all(values.get(name) == value for name, value in each.items()) for each in given)


def _nearest(case: _Case) -> tuple[Nearest | None, int]:
    """The nearest set that the campaign saw when it requested the cell, and the number of these sets. References of earlier campaigns
    precede its own."""
    cell, names = case.cell, case.cell.parameters.names
    watermark = case.campaign.watermark or 0
    nearest: Nearest | None = None
    stored = 0
    place = (cell.stage, cell.iteration, cell.individual)
    sources = (
        reference_candidates.stored_sets(case.connection, cell.setup_id, case.evaluator, watermark, names),
        reference_candidates.own_sets(case.connection, cell.campaign_sequence, cell.scenario, place, names),
    )
    for rank, source in enumerate(sources):
        for sets in source:
            stored += len(sets.values)
            places = np.insert(sets.places, 0, rank, axis=1)
            candidate = case.comparison.nearest(sets.values, places, sets.evaluations)
            if candidate is not None and (nearest is None or candidate.order < nearest.order):
                nearest = candidate
    return nearest, stored


def _reference(case: _Case, evaluation_id: int) -> tuple[Reference | None, list[Difference]]:
    """Returns an evaluation that a cell names, and how their parameters differ; None if it was deleted with its campaign."""
    try:
        donor = results.by_id(case.connection, evaluation_id)
    except NotFoundError:
        return None, []
    by_name = dict(zip(donor.parameters.names, donor.parameters.codes, strict=True))
    values = np.array([by_name[name] for name in case.cell.parameters.names], dtype=np.int64)
    score = donor.score
    if donor.run_id is not None and donor.campaign_sequence != case.campaign.sequence:
        score = runs.scores(connection=case.connection, run_ids=[donor.run_id], evaluator=case.evaluator).get(
            donor.run_id, score
        )
    reference = Reference(
        evaluation=donor.id,
        campaign=campaigns.by_sequence(case.connection, donor.campaign_sequence).id,
        stage=donor.stage,
        iteration=donor.iteration,
        individual=donor.individual,
        score=score,
        failure=donor.failure,
    )
    return reference, [_difference(case, donor, difference) for difference in case.comparison.differences(values)]


def _difference(case: _Case, donor: StoredEvaluation, difference: explanation.ParameterDifference) -> Difference:
    influence, name = difference.influence, difference.parameter
    return Difference(
        parameter=name,
        value=case.cell.parameters.floats[name],
        reference_value=donor.parameters.floats[name],
        region=difference.region,
        reference_region=difference.reference_region,
        lower=None if influence.lower is None else float(influence.lower),
        upper=None if influence.upper is None else float(influence.upper),
        blocks=difference.blocks,
    )


def _audit(case: _Case, reference: Reference | None) -> Audit:
    own, donor = case.cell.score, None if reference is None else reference.score
    known = own is not None and donor is not None
    change = abs((own or 0) - (donor or 0))
    return Audit(
        score=own,
        reference_score=donor,
        agrees=change <= case.scale.rounding if known else None,
        wrong=case.scale.is_wrong(change) if known else None,
    )


def _proof(case: _Case) -> Proof | None:
    """The certificate for a cell that something else answered; None without one, or if the evaluation that it names was deleted."""
    cell = case.cell
    if cell.proven_by is None or cell.outcome not in {Outcome.REUSED, Outcome.SIMULATED}:
        return None
    proving, _ = _reference(case, cell.proven_by)
    if proving is None:
        return None
    if cell.outcome is Outcome.SIMULATED:
        return Proof(reference=proving, score=cell.score, agrees=cell.proof_agrees, wrong=None)
    known = cell.score is not None and proving.score is not None
    change = abs((cell.score or 0) - (proving.score or 0))
    return Proof(
        reference=proving,
        score=proving.score,
        agrees=change <= case.scale.rounding if known else None,
        wrong=case.scale.is_wrong(change) if known else None,
    )


def _explanation(
    case: _Case,
    reason: Reason,
    *,
    reference: Reference | None = None,
    differences: Sequence[Difference] = (),
    audit: Audit | None = None,
    distance: float | None = None,
    stored: int | None = None,
    stop: tuple[int, AuditCount] | None = None,
    prediction: Prediction | None = None,
) -> Explanation:
    cell = case.cell
    answer = Explanation(
        evaluation=cell.id,
        campaign=case.campaign.id,
        stage=cell.stage,
        iteration=cell.iteration,
        individual=cell.individual,
        scenario=cell.scenario,
        outcome=cell.outcome,
        score=cell.score,
        failure=cell.failure,
        parameters=cell.parameters.floats,
        attempts=cell.attempts,
        detail=cell.detail,
        reason=reason,
        sentence="",
        reference=reference,
        differences=list(differences),
        audit=audit,
        proof=_proof(case),
        prediction=prediction or case.prediction,
        lot=None if case.lot is None or case.lot.kind is not Outcome.REUSED else inspected_lot(case.lot),
        distance=distance,
        stored=stored,
    )
    return answer.model_copy(update={"sentence": f"{sentence(answer, stop, case.scale)}{_later(case)}"})


def _later(case: _Case) -> str:
    """Returns the sentence that another campaign simulated this copied, predicted or withdrawn cell later; empty if it did not."""
    if not case.cell.is_copied:
        return ""
    later = runs.simulated_later(case.connection, case.campaign.sequence, case.evaluator, case.cell.id)
    return "".join(
        f" Evaluation {run.evaluation} of campaign {run.campaign} simulated this very cell later: score "
        f"{told(reference.score)}, which counts in rankings."
        for run in later
        if (reference := _reference(case, run.evaluation)[0]) is not None
    )
