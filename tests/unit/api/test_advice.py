"""Advice on the optimizer before a campaign is submitted."""

import pytest

from drivecal.api.expectation import advice
from drivecal.campaigns.resolve.problem import resolve
from drivecal.contracts.specification import CampaignSpecification

GENETIC = {"optimizer": {"kind": "genetic", "population": 50, "iterations": 6}}


@pytest.mark.parametrize(
    ("specification", "simulations", "milliseconds", "is_advised"),
    [
        ({}, 600, 5.0, True),
        ({}, 600, 1_000.0, False),
        (GENETIC, 600, 1_000.0, True),
        (GENETIC, 600, 10.0, False),
        (GENETIC, 50_000, 1_000.0, False),
        ({"optimizer": None, "sensitivity": {}}, 600, 5.0, False),
    ],
)
def test_a_search_that_does_not_fit_its_simulations_is_noted(
    specification: dict[str, object], simulations: int, milliseconds: float, *, is_advised: bool
) -> None:
    problem = resolve(CampaignSpecification.model_validate(specification))
    assert bool(advice(problem, simulations, milliseconds)) is is_advised
