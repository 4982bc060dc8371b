"""The words that are stored and shown: changing one breaks every database and every client."""

from __future__ import annotations

import json

import pytest

from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.evaluations import Breakdown, Failure, Outcome


def test_outcomes_are_those_of_the_interface_in_the_order_of_trying() -> None:
    assert [str(outcome) for outcome in Outcome] == ["repeated", "reused", "predicted", "simulated", "failed"]


def test_reasons_are_plain_words() -> None:
    assert {str(failure) for failure in Failure} == {"collision", "off_road", "task_missed", "unstable"}
    assert {str(breakdown) for breakdown in Breakdown} == {"crash", "hang", "memory", "error"}
    assert json.dumps(list(Failure)) == '["collision", "off_road", "task_missed", "unstable"]'


def test_no_reason_for_a_zero_is_also_a_reason_for_no_result() -> None:
    assert not {str(failure) for failure in Failure} & {str(breakdown) for breakdown in Breakdown}


def test_stages_run_in_the_order_of_the_interface() -> None:
    assert [str(stage) for stage in StageName] == ["sensitivity", "calibration", "robustness", "validation"]


@pytest.mark.parametrize("state", CampaignState)
def test_a_campaign_has_ended_once_nothing_will_change_any_more(state: CampaignState) -> None:
    assert state.ended == (state in {"cancelled", "succeeded", "failed"})


def test_states_are_those_of_the_interface() -> None:
    assert {str(state) for state in CampaignState} == {
        "queued", "running", "paused", "cancelling", "cancelled", "succeeded", "failed",
    }  # fmt: skip
