"""Explanations are told in words that name the cell's reference, the values and the regions."""

from __future__ import annotations

from typing import Any

import pytest

from drivecal.contracts.explanation import Audit, Difference, Explanation, Proof, Reference
from drivecal.domain.evaluations import AuditCount
from drivecal.reduction.reasons import sentence

DONOR = Reference(evaluation=17, campaign="c", stage="calibration", iteration=2, individual=5, score=4, failure=None)


def _difference(region: Any, reference_region: Any, lower: float | None, upper: float | None) -> Difference:
    return Difference(
        parameter="P1",
        value=0.1,
        reference_value=0.25,
        region=region,
        reference_region=reference_region,
        lower=lower,
        upper=upper,
        blocks=region != reference_region or region == "influential",
    )


def _explanation(reason: Any, **changes: Any) -> Explanation:
    known: dict[str, Any] = {
        "evaluation": 99, "campaign": "c", "stage": "calibration", "iteration": 3, "individual": 0, "scenario": "S1",
        "outcome": "simulated", "score": 4, "failure": None, "reason": reason, "sentence": "", "reference": DONOR,
    }  # fmt: skip
    return Explanation(**known | changes)


@pytest.mark.parametrize(
    ("difference", "words"),
    [
        (_difference("anywhere", "anywhere", None, None), "of no influence"),
        (_difference("anywhere", "outside", None, None), "where it has no influence and outside of what the map covers"),
        (_difference("below", "below", 0.3, 0.7), "both below 0.3"),
        (_difference("above", "above", 0.3, 0.05), "both above 0.05"),
        (_difference("below", "influential", 0.2, None), "below 0.2 and influential from 0.2 on"),
        (_difference("below", "above", 0.2, 0.22), "below 0.2 and above 0.22"),
        (_difference("influential", "above", None, 0.2), "influential up to 0.2 and above 0.2"),
        (_difference("influential", "influential", 0.0, 0.7), "both influential from 0 to 0.7"),
        (_difference("influential", "influential", None, None), "both influential everywhere"),
    ],
)
def test_a_difference_is_told_with_its_regions(difference: Difference, words: str) -> None:
    told = sentence(_explanation("reused", outcome="reused", differences=[difference]))
    assert "evaluation 17 (calibration iteration 3, individual 5)" in told
    assert f"P1 is 0.1 here and 0.25 there ({words})" in told


@pytest.mark.parametrize(
    ("outcome", "proof", "words"),
    [
        (
            "reused",
            {"agrees": True, "wrong": False},
            "would have repeated evaluation 17 (calibration iteration 3, individual 5), with the",
        ),
        ("reused", {"agrees": False, "wrong": False}, "with score 4: reuse is off by no more than 1"),
        ("reused", {"agrees": False, "wrong": True}, "with score 4: reuse is wrong here."),
        ("reused", {"agrees": None, "wrong": None}, "A certificate says that a simulation would have repeated evaluation 17 ("),
        (
            "simulated",
            {"agrees": True, "wrong": None},
            "It also checked a certificate: it was to repeat evaluation 17 (calibration",
        ),
    ],
)
def test_what_a_certificate_says_of_a_cell_that_it_did_not_answer_is_told(
    outcome: str, proof: dict[str, Any], words: str
) -> None:
    reason = "reused" if outcome == "reused" else "blocked"
    known = Proof(reference=DONOR, score=4, **proof)
    told = sentence(_explanation(reason, outcome=outcome, proof=known, stored=1))
    assert words in told
    assert told.startswith(sentence(_explanation(reason, outcome=outcome, stored=1)))


def test_a_blocked_cell_names_what_blocks_it_alone() -> None:
    listed = [_difference("influential", "influential", None, None), _difference("anywhere", "anywhere", None, None)]
    told = sentence(_explanation("blocked", differences=listed, stored=1234))
    assert told.startswith("Simulated: none of 1,234 stored sets fits; the nearest, evaluation 17")
    assert "is blocked by 1 parameter: P1" in told
    assert "of no influence" not in told


@pytest.mark.parametrize(
    ("audit", "words"),
    [
        (Audit(score=4, reference_score=4, agrees=True, wrong=False), "They agree: the simulation gave 4, the reference 4."),
        (Audit(score=3, reference_score=4, agrees=False, wrong=False), "They differ by no more than 1"),
        (Audit(score=2, reference_score=4, agrees=False, wrong=True), "Reuse would have been wrong"),
        (Audit(score=None, reference_score=4, agrees=None, wrong=None), "one of them has no result"),
    ],
)
def test_an_audit_is_told_with_both_scores(audit: Audit, words: str) -> None:
    assert words in sentence(_explanation("audited", audit=audit))


def test_the_stop_of_reuse_is_told_with_its_audits() -> None:
    told = sentence(_explanation("stopped", reference=None), (2, AuditCount("S1", 40, 9, 7)))
    assert told.endswith("stopped reuse in S1 after iteration 3: 7 of 40 audited cells were wrong.")


def test_references_of_other_campaigns_and_answers_still_awaited_are_told_as_such() -> None:
    foreign = DONOR.model_copy(update={"campaign": "another"})
    told = sentence(_explanation("repeated", outcome=None, reference=foreign))
    assert told.startswith(
        "Repeated (its answer is awaited): evaluation 17 (calibration iteration 3, individual 5 of campaign another)"
    )
