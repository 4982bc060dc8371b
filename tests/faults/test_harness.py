"""The harness sees campaigns that found something else."""

from dataclasses import replace

import pytest
from tests.support.faults.findings import OF_A_CAMPAIGN, TABLES, Found, assert_equal


def test_whatever_a_campaign_found_differently_is_named() -> None:
    row = {"scenario": "S1", "score": "5"}
    one = Found(dict.fromkeys(OF_A_CAMPAIGN), {name: [row] for name in TABLES}, {("setup", "set"): ("metrics",)})
    assert_equal("same", one, one)
    others = [replace(one, campaign={**one.campaign, name: 1}) for name in OF_A_CAMPAIGN]
    others += [replace(one, tables={**one.tables, name: [{**row, "score": "4"}]}) for name in TABLES]
    others += [replace(one, tables={**one.tables, name: []}) for name in TABLES]
    others += [
        replace(one, runs=runs) for runs in ({}, {("setup", "set"): ("others",)}, {("setup", "other set"): ("metrics",)})
    ]
    for other in others:
        with pytest.raises(AssertionError, match="campaign this"):
            assert_equal("this", other, one)
