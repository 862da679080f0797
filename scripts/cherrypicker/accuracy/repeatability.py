"""Repeatability: how far two scans of one tree on one day differ, trait by trait."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean, stdev

from scipy.stats import chi2, norm

from cherrypicker.accuracy.agreement import LIMITS_SD, limits_of_agreement

#: A trial shows a difference between two groups at this level, two-sided, with this power: the
#: usual ones (Cohen 1988, Statistical Power Analysis for the Behavioral Sciences).
LEVEL, POWER = 0.05, 0.8


@dataclass(frozen=True)
class Pair:
    """One quantity in two scans, in its own unit."""

    what: str  # whose: the tree, or a branch of it
    first: float
    second: float
    half: float | None  # of the 90 % interval of their difference; None where one has none


@dataclass(frozen=True)
class Repeatability:
    """Two scans against one another (Bland and Altman 1996, BMJ 313:744; 1986, Lancet 327:307).

    Shares are of the mean; None where too few pairs tell it.
    """

    n_pairs: int
    mean: float
    bias: float  # mean of second minus first
    within_sd: float  # of a single scan: root of half the mean squared difference
    within_sd_high: float  # its upper 95 % limit, by chi squared with n degrees of freedom
    within_cv: float | None  # root mean square of each pair's own, a share
    repeatability: float  # 95 % of two scans of a tree differ by less
    # Limits of agreement
    low: float | None
    high: float | None
    n_intervals: int  # pairs whose difference has a 90 % interval
    n_covered: int  # of these, those whose interval holds none
    between_cv: float | None  # of the trees themselves, three at least


def repeatability(pairs: Sequence[Pair]) -> Repeatability:
    """Return how well pairs of one quantity, one at least, repeat."""
    n = len(pairs)
    differences = [pair.second - pair.first for pair in pairs]
    means = [(pair.first + pair.second) / 2 for pair in pairs]
    mean = fmean(means)
    bias, low, high = limits_of_agreement(differences)
    squares = sum(difference**2 for difference in differences)
    within = math.sqrt(squares / (2 * n))
    known = [pair for pair in pairs if pair.half is not None]
    own_cv = between_cv = None
    if min(means) > 0:
        shares = ((own / middle) ** 2 / 2 for own, middle in zip(differences, means, strict=True))
        own_cv = math.sqrt(fmean(shares))
    if n > 2 and mean > 0:
        # The trees' spread, less what the scans add to that of their means
        between_cv = math.sqrt(max(stdev(means) ** 2 - within**2 / 2, 0.0)) / mean
    return Repeatability(
        n_pairs=n,
        mean=mean,
        bias=bias,
        within_sd=within,
        within_sd_high=math.sqrt(squares / (2 * chi2.ppf(0.05, n))),
        within_cv=own_cv,
        repeatability=LIMITS_SD * math.sqrt(2) * within,
        low=low,
        high=high,
        n_intervals=len(known),
        n_covered=sum(abs(pair.second - pair.first) <= (pair.half or 0.0) for pair in known),
        between_cv=between_cv,
    )


def trees_to_show(difference: float, cv: float) -> int:
    """Trees of each of two groups that show a difference, by the normal approximation.

    Shares of the mean are the difference between the groups' means and the standard deviation of
    single trees as scanned, `cv`.
    """
    z = norm.ppf(1 - LEVEL / 2) + norm.ppf(POWER)
    return max(2, math.ceil(2 * (z * cv / difference) ** 2))
