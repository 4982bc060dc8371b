"""The analysis that decides about each parameter, for every kind of decision."""

from math import nan

import numpy as np
import pytest

from drivecal.domain.influence import EVERYWHERE, Influence
from drivecal.sensitivity.scenario import ParameterInfluence, Region, RegionConfirmation, decided_by
from drivecal.sensitivity.thresholds import EffectStatistics, Verdict, measures

NOWHERE = Influence(influential=False)


def verdict(s_rel: float, threshold: float = 0.02) -> Verdict:
    """A verdict of two effects whose s_rel is the number."""
    return Verdict(measures(np.array([s_rel, -s_rel]) / np.sqrt(2)), threshold, s_rel >= threshold)


UNMEASURED = Verdict(EffectStatistics(nan, nan, nan, 0), None, influential=True)


def whole(verdict: Verdict) -> tuple[RegionConfirmation, ...]:
    return (RegionConfirmation(Region(0, "whole", 3), 0, 30, verdict),)


@pytest.mark.parametrize(
    ("result", "by"),
    [
        (ParameterInfluence(EVERYWHERE, (verdict(0), verdict(0.5), verdict(0.1)), (), verdict(0)), "intervals"),
        (ParameterInfluence(EVERYWHERE, (UNMEASURED, verdict(0.1)), (), verdict(0)), "intervals"),
        (ParameterInfluence(EVERYWHERE, (UNMEASURED, verdict(0.0)), (), verdict(0)), "intervals"),
        (ParameterInfluence(EVERYWHERE, (verdict(0), verdict(0)), whole(verdict(0.3)), verdict(0)), "confirmation"),
        (ParameterInfluence(EVERYWHERE, (verdict(0), verdict(0)), whole(verdict(0)), verdict(0.4)), "global"),
        (ParameterInfluence(NOWHERE, (verdict(0), verdict(0.01)), whole(verdict(0)), verdict(0)), "intervals"),
        (ParameterInfluence(NOWHERE, (verdict(9.4), verdict(0)), whole(verdict(0.003)), verdict(0.001)), "global"),
    ],
    ids=["interval", "measured before unmeasured", "unmeasured", "whole range", "global", "nothing", "overruled"],
)  # fmt: skip
def test_the_deciding_analysis_is_named(result: ParameterInfluence, by: str) -> None:
    assert decided_by(result, unknown=False) == by


def test_nothing_is_decided_by_figures_if_nothing_is_known() -> None:
    assert decided_by(ParameterInfluence(EVERYWHERE, (verdict(0),), (), None), unknown=True) == "unknown"
