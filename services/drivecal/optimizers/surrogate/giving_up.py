"""Gives sets up before they were asked in every scenario. This touches what is asked, never what is reported."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from drivecal.optimizers.surrogate.answers import Answers, BegunSet
from drivecal.optimizers.surrogate.merits import Standing
from drivecal.plugins.ports import Floats
from drivecal.plugins.search import Aim

SHARE = 0.02
"""A set is given up when its probability to beat the best falls below this share of its first value."""
LEAST = 0.0001
"""The same, whatever the first value was."""


def beaten(
    aim: Aim, answers: Answers, sets: Sequence[BegunSet], standing: Standing, best: Floats, needs: npt.NDArray[np.bool_]
) -> npt.NDArray[np.bool_]:
    """Returns which sets cannot be better than the best complete ones, even with the best value in every scenario left, shape (n,).

    Args:
        aim: the campaign's aim.
        answers: all answers.
        sets: n sets that are not complete.
        standing: the complete sets.
        best: the best values to be expected of each set, shape (n, n_scenarios, n_values).
        needs: the scenarios of the aim, shape (n_scenarios,).
    """
    values = answers.values(sets)
    missing = ~np.stack([answers.answered(begun) for begun in sets])
    with np.errstate(invalid="ignore"):
        objectives, violations = aim.judge(np.where(missing[:, :, np.newaxis], best, values))
    return standing.beats(objectives, violations) | without_result(answers, sets, needs)


def without_result(answers: Answers, sets: Sequence[BegunSet], needs: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Returns which sets have an answer without a result in a needed scenario, shape (n,)."""
    answered = np.stack([answers.answered(begun) for begun in sets]) & needs
    dead: npt.NDArray[np.bool_] = np.any(answered & np.isnan(answers.values(sets)).any(axis=2), axis=1)
    return dead


def improbable(chance: float, promise: float) -> bool:
    """Returns whether a set is not worth a simulation any more; `promise`: its first probability to beat the best."""
    return chance < promise and chance <= max(SHARE * promise, LEAST)
