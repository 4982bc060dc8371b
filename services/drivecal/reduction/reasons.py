"""Explanations in words. Pure."""

from collections.abc import Sequence

from drivecal.contracts.assignments import value_text
from drivecal.contracts.explanation import Difference, Explanation, InspectedLot, Proof, Reference
from drivecal.domain.evaluations import AuditCount
from drivecal.domain.scales import COMFORT, Scale, told

_SAME = "it takes equal parameter sets, and runs that a certificate proves to be the same, only"


def sentence(explanation: Explanation, stop: tuple[int, AuditCount] | None = None, scale: Scale = COMFORT) -> str:
    """An explanation in a few sentences. `stop`: after which iteration and by which audits reuse was stopped."""
    tolerated = scale.amount(scale.tolerance)
    reason = _reason(explanation, stop, tolerated)
    return reason if explanation.proof is None else f"{reason} {_proven(explanation.proof, explanation, tolerated)}"


def _reason(explanation: Explanation, stop: tuple[int, AuditCount] | None, tolerated: str) -> str:
    beginning = {None: "To be simulated", "failed": "Sent to be simulated, without a result"}.get(
        explanation.outcome, "Simulated"
    )
    where = (
        "an evaluation that was deleted"
        if explanation.reference is None
        else _where(explanation.reference, explanation.campaign)
    )
    match explanation.reason:
        case "repeated":
            return f"{_copied('Repeated', explanation)}: {where} has the same parameter set in the same setup."
        case "reused":
            listed = _listed(explanation.differences)
            return f"{_copied('Reused', explanation)}: {where} differs only where {explanation.scenario} is not influenced: {listed}."
        case "certified":
            certified = f"Certified: with these values every decision is that of {where}, so both runs are the same."
            names = ", ".join(difference.parameter for difference in explanation.differences) or "nothing"
            return certified if explanation.reference is None else f"{certified} They differ in {names}."
        case "audited":
            listed = _listed(explanation.differences)
            return f"{beginning} to check the reduction, which would have reused {where}: {listed}. {_verdict(explanation, tolerated)}"
        case "confirmation" if explanation.reference is None:
            simulated = "" if explanation.score is None else f" The simulation gave {told(explanation.score)}."
            return f"{beginning} after the search, to confirm it: the score here was predicted: {_predicted(explanation)}{simulated}"
        case "confirmation":
            trusted = f"the best set's score here was that of {where}, which differs only where it should not matter"
            listed = _listed(explanation.differences)
            return f"{beginning} after the search, to confirm it: {trusted}: {listed}. {_verdict(explanation, tolerated)}"
        case "blocked":
            blocking = [difference for difference in explanation.differences if difference.blocks]
            count = f"{len(blocking)} parameter{'s' if len(blocking) != 1 else ''}"
            nearest = f"the nearest, {where}, is blocked by {count}: {_listed(blocking)}"
            return f"{beginning}: none of {explanation.stored:,} stored sets fits; {nearest}."
        case "nothing_stored":
            return f"{beginning}: nothing was stored for this setup when the campaign asked."
        case "unanswered" if explanation.lot is not None:
            without = "the cell that was to answer it has no result, or its very set was simulated in the sample of its lot"
            return f"{beginning}: {without}; since then {where} would fit."
        case "unanswered":
            return f"{beginning}: the cell that was to answer it ended without a result; since then {where} would fit."
        case "stopped":
            return f"{beginning}: {_stopped(explanation.scenario, stop)}"
        case "no_map":
            return f"{beginning}: without an influence map only equal parameter sets are answered from the table, and this one was new."
        case "exact_only":
            return (
                f"{beginning}: only equal parameter sets are answered from the table here (exact only), and this one was new."
            )
        case "given":
            return f"{beginning}: it is the baseline or a given start set, whose scores no reference or prediction answers."
        case "off":
            return f"{beginning}: reuse is off in this campaign (reduction.mode: off)."
        case "study":
            return f"{beginning}: the study is about what simulations give, so {_SAME}."
        case "predicted":
            return f"{_copied('Predicted', explanation)}: {_predicted(explanation)}"
        case "sampled":
            return f"{beginning} as part of the sample that inspects its lot: {_predicted(explanation)}"
        case "lot_rejected":
            inspected = _predicted(explanation) if explanation.lot is None else f"{_inspected(explanation.lot)}."
            return f"{beginning} because its lot was rejected: {inspected}"
        case "not_accepted":
            confidence = 0.0 if explanation.prediction is None else explanation.prediction.confidence
            doubt = f"its prediction (confidence {confidence:.0%}) was too uncertain for a lot"
            return f"{beginning}: {doubt}, or its set was believed within reach of the best one, or it answers equal sets."
        case "not_predicted":
            return f"{beginning}: the predictor was not asked, because too little was known or asking would have cost more than it saves."
        case "analysis":
            return f"{beginning}: the sensitivity analysis makes the map that reuse rests on, so {_SAME}."


def _inspected(lot: InspectedLot) -> str:
    wrong = f"{lot.errors} of their answers by references were wrong, and at most {lot.acceptance} may be"
    return f"of {lot.size} cells that references were to answer {lot.sample} were simulated, {wrong}"


def _predicted(explanation: Explanation) -> str:
    prediction = explanation.prediction
    if prediction is None or prediction.lot is None:
        return "its prediction is in no lot."
    lot = prediction.lot
    said = f"{lot.known:,} known answers said {told(prediction.score)} with a confidence of {prediction.confidence:.0%}"
    if lot.errors is None:
        return f"{said}; the sample of its lot ({lot.sample} of {lot.size}) is awaited."
    sample = f"of its lot of {lot.size}, {lot.sample} were simulated and {lot.errors} differed, at most {lot.acceptance} may"
    return f"{said}; {sample}: {lot.verdict}."


def _proven(proof: Proof, explanation: Explanation, tolerated: str) -> str:
    where = _where(proof.reference, explanation.campaign)
    if explanation.outcome == "simulated":
        verdict = "and it did" if proof.agrees else "and it did not"
        return f"It also checked a certificate: it was to repeat {where} bit for bit, {verdict}."
    text = f"A certificate says that a simulation would have repeated {where}"
    if proof.agrees is None:
        return f"{text}."
    if proof.agrees:
        return f"{text}, with the same score."
    return f"{text}, with score {told(proof.score)}: reuse is {'wrong here' if proof.wrong else f'off by no more than {tolerated}'}."


def _copied(done: str, explanation: Explanation) -> str:
    state = {None: " (its answer is awaited)", "failed": " without a result"}
    return f"{done}{state.get(explanation.outcome, '')}"


def _where(reference: Reference, campaign: str) -> str:
    place = f"{reference.stage} iteration {reference.iteration + 1}, individual {reference.individual}"
    owner = "" if reference.campaign == campaign else f" of campaign {reference.campaign}"
    return f"evaluation {reference.evaluation} ({place}{owner})"


def _listed(differences: Sequence[Difference]) -> str:
    return "; ".join(map(_difference, differences)) or "no parameter differs"


def _difference(difference: Difference) -> str:
    return (
        f"{difference.parameter} is {value_text(difference.value)} here and {value_text(difference.reference_value)} there"
        f" ({_regions(difference)})"
    )


def _regions(difference: Difference) -> str:
    if difference.region == difference.reference_region == "anywhere":
        return "of no influence"
    if difference.region == difference.reference_region:
        return f"both {_region(difference, difference.region)}"
    return f"{_region(difference, difference.region)} and {_region(difference, difference.reference_region)}"


def _region(difference: Difference, region: str) -> str:
    if region == "below":
        return f"below {difference.lower:g}"
    if region == "anywhere":
        return "where it has no influence"
    if region == "outside":
        return "outside of what the map covers"
    return f"above {difference.upper:g}" if region == "above" else _bounds(difference)


def _bounds(difference: Difference) -> str:
    if difference.lower is None and difference.upper is None:
        return "influential everywhere"
    if difference.lower is None:
        return f"influential up to {difference.upper:g}"
    if difference.upper is None:
        return f"influential from {difference.lower:g} on"
    return f"influential from {difference.lower:g} to {difference.upper:g}"


def _verdict(explanation: Explanation, tolerated: str) -> str:
    audit = explanation.audit
    if audit is None or audit.agrees is None or audit.score is None:
        return "The two cannot be compared: one of them has no result." if explanation.outcome else "Its answer is awaited."
    scores = f"the simulation gave {told(audit.score)}, the reference {told(audit.reference_score)}"
    if audit.agrees:
        return f"They agree: {scores}."
    return f"Reuse would have been wrong: {scores}." if audit.wrong else f"They differ by no more than {tolerated}: {scores}."


def _stopped(scenario: str, stop: tuple[int, AuditCount] | None) -> str:
    if stop is None:
        return f"the self-check had stopped reuse in {scenario}."
    iteration, count = stop
    audits = f"{count.wrong} of {count.audited} audited cells were wrong"
    return f"the self-check stopped reuse in {scenario} after iteration {iteration + 1}: {audits}."
