"""Numbers and the spread that every robust fit here shares."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Standard deviations in the median absolute deviation of a normal distribution.
MAD_TO_SIGMA = 1.4826
#: Tukey's biweight ends here, in standard deviations: 95 % efficiency on Gaussian residuals.
TUKEY = 4.685
#: Cauchy's loss turns from quadratic here, in standard deviations: the same efficiency.
CAUCHY = 2.385


def robust_sigma(residuals: NDArray) -> float:
    """Return the standard deviation of Gaussian residuals about zero, told by their median.

    Parameters
    ----------
    residuals : ndarray
        Of any unit, with or without signs; up to half of them may be outliers.
    """
    return float(MAD_TO_SIGMA * np.median(np.abs(residuals)))
