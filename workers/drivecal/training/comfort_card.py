"""The tables of the learned evaluator's model card, from its arrays and manoeuvres that it was not trained on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from drivecal.comfort.regression import Rater
from drivecal.comfort.regression_arrays import Regression
from drivecal.domain.scenarios import Manoeuvre
from drivecal.plugins.ports import Floats
from drivecal.training.comfort import PanelAgreement, rated_by_panel
from drivecal.training.rated_drives import RatedDrive
from drivecal.training.tables import table

AGREEMENT, CALIBRATION = "agreement on held-out manoeuvres", "calibration"


def ratings(regressions: Mapping[Manoeuvre, Regression], drives: Sequence[RatedDrive]) -> Floats:
    """What the evaluator says, shape (n,)."""
    rater = Rater(regressions)
    return np.array([rater.rate_channels(one.manoeuvre, one.channels).rating for one in drives])


def agreement_table(ours: Floats, drives: Sequence[RatedDrive]) -> str:
    """Of these ratings with the panel's, by class; beside it the agreement of the reference scale itself, which nothing learned from the
    panel can beat."""
    panel = rated_by_panel(drives)
    reference = np.array([one.rating for one in drives])
    ran = np.array([one.group.startswith("set ") for one in drives])
    rows = []
    for manoeuvre in Manoeuvre:
        chosen = np.array([one.manoeuvre is manoeuvre for one in drives])
        for label, which, rated in (
            (manoeuvre.value, chosen, ours),
            (f"{manoeuvre.value}, built-in scenarios only", chosen & ran, ours),
            (f"{manoeuvre.value}, the reference scale itself", chosen, reference),
        ):
            one = PanelAgreement.of(rated[which], panel[which])
            rows.append(
                [label, str(one.count), f"{one.equal:.2f}", f"{one.within_one:.2f}", f"{one.kappa:.2f}", f"{one.error:.2f}"]
            )
    return table(
        ["class", "manoeuvres", "equal score", "within one", "quadratic weighted kappa", "r.m.s. error of the rating"], rows
    )


def calibration_table(ours: Floats, drives: Sequence[RatedDrive]) -> str:
    """The panel's mean rating where these ratings gave each score, by class, and how often they did."""
    panel = rated_by_panel(drives)
    scores = np.floor(ours + 0.5).astype(int)
    rows = []
    for manoeuvre in Manoeuvre:
        chosen = np.array([one.manoeuvre is manoeuvre for one in drives])
        means = []
        for score in range(8):
            which = chosen & (scores == score)
            means.append(f"{panel[which].mean():.1f} ({which.sum()})" if which.any() else "none")
        rows.append([manoeuvre.value, *means])
    return table(["score given", *(str(score) for score in range(8))], rows)
