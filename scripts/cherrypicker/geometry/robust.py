"""Numbers and the spread that every robust fit here shares."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

#: Standard deviations in the median absolute deviation of a normal distribution.
MAD_TO_SIGMA = 1.4826
#: Tukey's biweight ends here, in standard deviations: 95 % efficiency on Gaussian residuals.
TUKEY = 4.685
#: Cauchy's loss turns from quadratic here, in standard deviations: the same efficiency.
CAUCHY = 2.385


def robust_sigma(residuals: NDArray) -> float:
    """Standard deviation of Gaussian residuals about zero, up to half of them outliers."""
    return float(MAD_TO_SIGMA * np.median(np.abs(residuals)))


def weighted_median(values: NDArray | Sequence[float], weights: NDArray | Sequence[float]) -> float:
    """The least of some values up to which half of their weights, of a sum above 0, are."""
    return float(np.quantile(values, 0.5, weights=weights, method="inverted_cdf"))
