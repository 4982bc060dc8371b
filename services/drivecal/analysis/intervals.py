"""Confidence interval of a mean rate over base sets, by betting. Pure.

Variants of one base set are alike, so that only bases are independent. Each base contributes one number in [0, 1], the share of its
variants that are wrong. The interval assumes nothing else: no distribution, no variance, no number of variants.

A bet with stake c on a mean above m multiplies its capital by 1 - c + c x / m for every share x. If m is the mean of the bases' means,
the expected capital is at most 1 for every fixed c (inequality of arithmetic and geometric means), and so is that of a mixture of
stakes. By Markov's inequality it reaches 2 / alpha with a probability of at most alpha / 2. The interval holds every m against which
neither this bet nor the mirrored bet on a mean below m reaches that (Waudby-Smith and Ramdas 2024, "Estimating means of bounded random
variables by betting").

The mixture is fixed beforehand, so that the order of the bases does not matter: one half is c = 1, which is best if the bases agree, the
other half has the arcsine weights of the universal portfolio (Cover and Ordentlich 1996).
"""

import numpy as np

from drivecal.plugins.ports import Floats

CONFIDENCE = 0.95
STAKES = 40
"""Stakes below 1 in the mixture."""
SMALLEST = 1e-12
"""Smallest mean that is distinguished from 0."""
HALVINGS = 40
"""Halvings of the range of a limit's logarithm, to eleven digits."""


def mean_interval(shares: Floats) -> tuple[float, float]:
    """Returns the two-sided confidence interval of the mean of independent `shares` in [0, 1], shape (n,); (0, 1) for none.

    Raises ValueError if a share lies outside [0, 1].
    """
    if np.any(~((shares >= 0.0) & (shares <= 1.0))):
        raise ValueError("shares must lie between 0 and 1")
    if not shares.size:
        return 0.0, 1.0
    return _lower_limit(shares), 1.0 - _lower_limit(1.0 - shares)


def _mixture() -> tuple[Floats, Floats]:
    """The stakes and the logarithms of their weights, both of shape (STAKES + 1,)."""
    angles = np.pi * (2 * np.arange(1, STAKES + 1) - 1) / (4 * STAKES)
    return np.append(np.sin(angles) ** 2, 1.0), np.log(np.append(np.full(STAKES, 0.5 / STAKES), 0.5))


def _lower_limit(shares: Floats) -> float:
    """The smallest mean that the bet on a higher one leaves; its capital falls with the mean."""
    values, counts = np.unique(shares, return_counts=True)
    stakes, weights = _mixture()
    enough = np.log(2.0 / (1.0 - CONFIDENCE))

    def capital(mean: float) -> float:
        with np.errstate(divide="ignore"):  # a stake of 1 is lost at the first share of 0
            gains = np.log1p(stakes[:, np.newaxis] * (values / mean - 1.0))
        return float(np.logaddexp.reduce(weights + gains @ counts))

    if values[-1] < SMALLEST or capital(SMALLEST) < enough:
        return 0.0
    below, above = np.log(SMALLEST), np.log(float(shares.mean()))  # at the observed mean the capital is at most 1
    for _ in range(HALVINGS):
        middle = 0.5 * (below + above)
        below, above = (middle, above) if capital(float(np.exp(middle))) >= enough else (below, middle)
    return float(np.exp(below))
