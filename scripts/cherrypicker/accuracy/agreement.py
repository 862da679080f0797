"""How well our numbers agree with those measured by hand, and what others have published."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean, stdev

from cherrypicker.accuracy.quantities import QUANTITIES

#: Limits of agreement lie so many standard deviations around the bias: 95 % of normal differences
#: (Bland and Altman 1986, Lancet 327(8476):307).
LIMITS_SD = 1.96


@dataclass(frozen=True)
class Agreement:
    """Ours against hand measurements of one trait; None where too few tell it."""

    n: int
    mae: float
    rmse: float
    bias: float  # mean of ours minus hand
    r2: float | None  # 1 - squared differences / squares of hand about its mean; may be negative
    relative_rmse: float | None  # RMSE over the hand measurements' mean
    # low, high: Bland and Altman's limits of agreement
    low: float | None
    high: float | None
    n_intervals: int  # pairs that have a 90 % interval
    n_covered: int  # of these, those that hold the hand measurement


def limits_of_agreement(differences: Sequence[float]) -> tuple[float, float | None, float | None]:
    """Return the mean of some differences and their lower and upper limit, None of a single one."""
    bias = fmean(differences)
    if len(differences) < 2:
        return bias, None, None
    half = LIMITS_SD * stdev(differences)
    return bias, bias - half, bias + half


def agreement(pairs: Sequence[dict]) -> Agreement:
    """Return how well pairs of one trait, at least one, agree.

    Each has ``hand`` and ``ours``, and ``low`` and ``high`` or None.
    """
    hand = [pair["hand"] for pair in pairs]
    errors = [pair["ours"] - pair["hand"] for pair in pairs]
    squares, mean = sum(error**2 for error in errors), fmean(hand)
    bias, low, high = limits_of_agreement(errors)
    spread = sum((value - mean) ** 2 for value in hand)
    known = [pair for pair in pairs if pair["low"] is not None and pair["high"] is not None]
    rmse = math.sqrt(squares / len(pairs))
    return Agreement(
        n=len(pairs),
        mae=fmean(map(abs, errors)),
        rmse=rmse,
        bias=bias,
        r2=1.0 - squares / spread if spread > 0 else None,
        relative_rmse=rmse / mean if mean else None,
        low=low,
        high=high,
        n_intervals=len(known),
        n_covered=sum(pair["low"] <= pair["hand"] <= pair["high"] for pair in known),
    )


def by_trait(pairs: Iterable[dict]) -> dict[str, list[dict]]:
    """Return the pairs that have a number of ours by trait, in the traits' order."""
    found: dict[str, list[dict]] = {}
    for pair in pairs:
        if pair["ours"] is not None:
            found.setdefault(pair["trait"], []).append(pair)
    return {name: found[name] for name in QUANTITIES if name in found}


@dataclass(frozen=True)
class Published:
    """What a paper tells of one trait."""

    trait: str
    source: str
    measured_on: str
    mae: float | None = None  # in the trait's unit
    r2: float | None = None
    relative_rmse: float | None = None


_QIU = "AppleQSM, laser scans: Qiu et al. 2024, Plant Phenomics 6:0179"
_APPLES = "84 apple trees"
_SLEGLOVA = (
    "photos with TreeQSM against a digitizer: Šleglová et al. 2025, Remote Sensing 17(2):202"
)
_FOREST = "small trees of the forest"
PUBLISHED = (
    Published("height_m", _QIU, _APPLES, mae=0.061, r2=0.92),
    Published("height_m", _SLEGLOVA, _FOREST, relative_rmse=0.3419),
    Published("trunk_diameter_m", _QIU, _APPLES, mae=0.00471, r2=0.83),
    Published("trunk_diameter_m", _SLEGLOVA, _FOREST, relative_rmse=0.699),
    Published("wood_volume_m3", _SLEGLOVA, _FOREST, relative_rmse=1.0787),
    Published("n_shoots", _SLEGLOVA, _FOREST, relative_rmse=1.4203),
    Published("branch_diameter_m", _QIU, _APPLES, mae=0.00686, r2=0.77),
    Published("branch_angle_deg", _QIU, _APPLES, mae=7.48, r2=0.69),
)
