"""90 % intervals of traits, by what their errors follow (`cherrypicker.geometry.error_terms`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import NormalDist

import numpy as np

from cherrypicker.geometry.error_terms import Terms, spread

CI90 = (0.05, 0.95)
# Half of it of a normal distribution, in standard deviations
Z90 = NormalDist().inv_cdf(max(CI90))
CM2 = 1e4  # of a square metre


def interval(
    value: float | np.ndarray, terms: Terms, drawn: tuple[float, float] = (0.0, 0.0)
) -> tuple:
    """90 % interval of a trait, of one number or of (n,) float64; not below 0.

    The 5 % and the 95 % quantile of drawn values lie as far below and above it as ``drawn`` says,
    as of a crown whose shoots have lost their ends.
    """
    half = Z90 * spread(terms)
    return np.maximum(value - np.hypot(half, drawn[0]), 0.0), value + np.hypot(half, drawn[1])


@dataclass(frozen=True)
class Estimate:
    """A trait's value, and how sure it is where that is known."""

    value: float
    se: float | None = None  # standard error
    ends: tuple[float, float] | None = None  # of the 90 % interval
    # What the error follows: `Terms`, and how far drawn values lie below and above the value
    terms: Terms = field(default_factory=dict)
    is_outgrown: bool = False  # more is known to be missing than the interval allows

    @classmethod
    def of(
        cls,
        value: float,
        terms: Terms,
        drawn: np.ndarray | None = None,
        missing: float = 0.0,
        *,
        scale: float = 0.0,
    ) -> Estimate:
        """An estimate whose error follows its terms; one without an error where there are none.

        ``drawn``, (n_samples,) float64, is how far drawn values lie off the value, ``missing`` how
        much larger it is with the wood that is known to be missing. The scan's scale errs besides:
        ``scale`` is the relative standard error by it.
        """
        if not terms or (drawn is not None and len(drawn) < 2):
            return cls(value)
        terms = {**terms, "scale": scale * value}
        arms, sd, is_outgrown = (0.0, 0.0), spread(terms), False
        if drawn is not None:
            low, high = np.maximum(np.quantile(drawn, CI90) * [-1, 1], 0.0)
            is_outgrown = bool(value + missing > interval(value, terms, (low, high))[1])
            arms, sd = (low, max(high, missing)), np.hypot(sd, drawn.std(ddof=1))
        told = {"drawn_low": arms[0], "drawn_high": arms[1], **terms}
        return cls(value, float(sd), interval(value, terms, arms), told, is_outgrown)

    def circle_area(self) -> Estimate:
        """Area of the circle of this diameter: cm² of metres."""
        area = np.pi / 4 * CM2
        if self.se is None or self.ends is None:
            return Estimate(area * self.value**2)
        low, high = (area * end**2 for end in self.ends)
        return Estimate(area * self.value**2, 2 * area * self.value * self.se, (low, high))


def base_shares(branches: Sequence[Mapping]) -> np.ndarray:
    """90 % interval of each axis's base over its diameter there, (n_axes, 2); NaN without one."""
    names = ("base_diameter_low_m", "base_diameter_high_m", "base_diameter_m")
    ends = np.array([[row[name] for name in names] for row in branches], dtype=np.float64)
    return ends[:, :2] / ends[:, 2:]


def volume_ends(
    volume: np.ndarray, shares: np.ndarray, scale_error: float = 0.0
) -> tuple[float | None, float | None]:
    """90 % interval of a volume of wood; None where a piece of it has none.

    Radii err together: each is off by the share that its axis's base may be, the scan's scale in
    it, and all are at the same end. So are lengths, by the scale alone. Each piece has its volume,
    (n,) float64, and the shares of its axis, (n, 2), as of `base_shares`.
    """
    low, high = shares.T**2 @ volume * interval(1.0, {"scale": scale_error})
    return (None, None) if np.isnan(low + high) else (float(low), float(high))


def diameter_terms(
    diameter: float | np.ndarray,
    error: float | np.ndarray,
    scatter: float | np.ndarray,
    scale_error: float = 0.0,
) -> dict[str, float | np.ndarray]:
    """What the error of a branch's diameter follows, of one or of (n,) float64, in one unit.

    ``error`` is the standard error of the radius by its fit, ``scatter`` the standard deviation of
    the points around it, ``scale_error`` the relative standard error of the scan's scale.
    """
    return {"fit": 2.0 * error, "diameter_shared": scatter, "scale": scale_error * diameter}


def branch_terms(
    shape: Mapping[str, np.ndarray], typical: float, scale_error: float = 0.0
) -> dict[str, Terms]:
    """What the errors of ``base_diameter_m`` and ``insertion_angle_deg`` follow, by these names.

    The shapes are those of `cherrypicker.traits.branches.axis_shapes`, (n_axes,) like the terms.
    ``typical`` is the scatter of the points where an axis has none of its own, ``scale_error`` the
    relative standard error of the scan's scale.
    """
    scatter = np.where(shape["base_residual"] > 0, shape["base_residual"], typical)
    return {
        "base_diameter_m": diameter_terms(
            shape["base_diameter_m"], shape["base_error"], scatter, scale_error
        ),
        "insertion_angle_deg": {
            "angle_least_deg": np.ones(len(scatter)),
            "angle_shared": np.degrees(scatter / np.maximum(shape["stretch"], 1e-9)),
        },
    }
