"""The analysis that decides about each parameter, for every kind of decision."""

import re
from math import nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivecal.domain.influence import EVERYWHERE, Influence
from drivecal.sensitivity.designs import EffectStatistics, measures
from drivecal.sensitivity.scenario import ParameterInfluence, Region, RegionConfirmation, decision
from drivecal.sensitivity.thresholds import MuSigmaThresholds, Verdict

NOWHERE = Influence(influential=False)


def verdict(s_rel: float, threshold: float = 0.02) -> Verdict:
    """A verdict of two effects whose s_rel is the number."""
    return Verdict(measures(np.array([s_rel, -s_rel]) / np.sqrt(2)), threshold, s_rel >= threshold)


UNMEASURED = Verdict(EffectStatistics(nan, nan, nan, 0), None, influential=True)


def whole(verdict: Verdict) -> tuple[RegionConfirmation, ...]:
    return (RegionConfirmation(Region(0, "whole", 3), 0, 30, verdict),)


@pytest.mark.parametrize(
    ("result", "by", "figures"),
    [
        (ParameterInfluence(EVERYWHERE, (verdict(0), verdict(0.5), verdict(0.1)), (), verdict(0)), "intervals", ("interval 2 of 3", "0.5")),
        (ParameterInfluence(EVERYWHERE, (UNMEASURED, verdict(0.1)), (), verdict(0)), "intervals", ("interval 2 of 2", "0.1")),
        (ParameterInfluence(EVERYWHERE, (UNMEASURED, verdict(0.0)), (), verdict(0)), "intervals", ("interval 1 of 2", "two")),
        (ParameterInfluence(EVERYWHERE, (verdict(0), verdict(0)), whole(verdict(0.3)), verdict(0)), "confirmation", ("0.3",)),
        (ParameterInfluence(EVERYWHERE, (verdict(0), verdict(0)), whole(verdict(0)), verdict(0.4)), "global", ("0.4",)),
        (ParameterInfluence(NOWHERE, (verdict(0), verdict(0.01)), whole(verdict(0)), verdict(0)), "intervals", ("0.01",)),
        (ParameterInfluence(NOWHERE, (verdict(9.4), verdict(0)), whole(verdict(0.003)), verdict(0.001)), "global", ("9.4", "0.003")),
    ],
    ids=["interval", "measured before unmeasured", "unmeasured", "whole range", "global", "nothing", "overruled"],
)  # fmt: skip
def test_the_deciding_analysis_is_named_with_its_figures(result: ParameterInfluence, by: str, figures: tuple[str, ...]) -> None:
    decided = decision(result, unknown=False)
    assert decided.by == by
    assert [figure for figure in figures if figure not in decided.reason] == []


def test_nothing_is_decided_by_figures_if_nothing_is_known() -> None:
    assert decision(ParameterInfluence(EVERYWHERE, (verdict(0),), (), None), unknown=True).by == "unknown"


@given(st.floats(0, 1), st.floats(0, 1))
def test_thresholds_on_mu_and_sigma_are_shown_beside_what_was_measured(mu: float, sigma: float) -> None:
    threshold = MuSigmaThresholds(mu, sigma)
    result = ParameterInfluence(EVERYWHERE, (Verdict(measures(np.array([0.2, 0.4])), threshold, influential=True),), (), None)
    reason = decision(result, unknown=False).reason
    shown = [float(figure) for figure in re.findall(r"[0-9][0-9.e-]*", reason.partition("|mu|")[2])]
    assert shown == pytest.approx([0.3, mu, 0.02**0.5, sigma], rel=0.01)
