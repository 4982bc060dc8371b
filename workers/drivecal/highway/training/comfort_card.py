"""Tables of the learned evaluator's model card, from its arrays and held-out manoeuvres."""

from collections.abc import Mapping, Sequence

import numpy as np

from drivecal.highway.comfort.regression import Rater
from drivecal.highway.comfort.regression_arrays import Regression
from drivecal.highway.manoeuvres import Manoeuvre
from drivecal.highway.training.comfort import PanelAgreement, rated_by_panel
from drivecal.highway.training.rated_drives import RatedDrive
from drivecal.highway.training.tables import table
from drivecal.plugins.ports import Floats

AGREEMENT, CALIBRATION = "agreement on held-out manoeuvres", "calibration"


def ratings(regressions: Mapping[Manoeuvre, Regression], drives: Sequence[RatedDrive]) -> Floats:
    """Returns the evaluator's ratings, shape (n,)."""
    rater = Rater(regressions)
    return np.array([rater.rate_channels(drive.manoeuvre, drive.channels).rating for drive in drives])


def agreement_table(ours: Floats, drives: Sequence[RatedDrive]) -> str:
    """Returns the table of agreement between these ratings and the panel's, by class.

    It includes the agreement of the reference scale itself, an upper bound for evaluators learned from the panel.
    """
    panel = rated_by_panel(drives)
    reference = np.array([drive.rating for drive in drives])
    simulated = np.array([drive.group.startswith("set ") for drive in drives])
    rows = []
    for manoeuvre in Manoeuvre:
        in_class = np.array([drive.manoeuvre is manoeuvre for drive in drives])
        for label, selected, rated in (
            (manoeuvre.value, in_class, ours),
            (f"{manoeuvre.value}, built-in scenarios only", in_class & simulated, ours),
            (f"{manoeuvre.value}, the reference scale itself", in_class, reference),
        ):
            agreement = PanelAgreement.of(rated[selected], panel[selected])
            shares = (agreement.equal, agreement.within_one, agreement.kappa, agreement.error)
            rows.append([label, str(agreement.count), *(f"{share:.2f}" for share in shares)])
    return table(
        ["class", "manoeuvres", "equal score", "within one", "quadratic weighted kappa", "r.m.s. error of the rating"], rows
    )


def calibration_table(ours: Floats, drives: Sequence[RatedDrive]) -> str:
    """Returns the table of the panel's mean rating by class and score of these ratings, with the number of drives."""
    panel = rated_by_panel(drives)
    scores = np.floor(ours + 0.5).astype(int)
    rows = []
    for manoeuvre in Manoeuvre:
        in_class = np.array([drive.manoeuvre is manoeuvre for drive in drives])
        means = []
        for score in range(8):
            selected = in_class & (scores == score)
            means.append(f"{panel[selected].mean():.1f} ({selected.sum()})" if selected.any() else "none")
        rows.append([manoeuvre.value, *means])
    return table(["score given", *(str(score) for score in range(8))], rows)
