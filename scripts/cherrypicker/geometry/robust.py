"""Numbers and the spread that every robust fit here shares."""

from heapq import heappop, heappush

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


class RunningMedian:
    """Median of values that come one by one, each with how often it counts."""

    def __init__(self) -> None:
        # Heaps: those up to the median, the largest first, and those above it
        self._low: list[tuple[float, int]] = []
        self._high: list[tuple[float, int]] = []
        self._n_low = self._n = 0

    @property
    def value(self) -> float:
        """The least value up to which half of the counts are."""
        return -self._low[0][0]

    def add(self, value: float, count: int) -> None:
        """One more value."""
        self._n += count
        if self._low and value > self.value:
            heappush(self._high, (value, count))
        else:
            heappush(self._low, (-value, count))
            self._n_low += count
        while 2 * self._n_low < self._n:
            above, weight = heappop(self._high)
            heappush(self._low, (-above, weight))
            self._n_low += weight
        while len(self._low) > 1 and 2 * (self._n_low - self._low[0][1]) >= self._n:
            below, weight = heappop(self._low)
            heappush(self._high, (-below, weight))
            self._n_low -= weight
