"""How strongly a point near a limb's surface pulls at its axis and its radius (compiled).

A point on a surface of radius r, seen with noise of standard deviation s, lies at a distance q from
the axis that has Rice's distribution ("Mathematical analysis of random noise", 1945):

    -log p = (q^2 + r^2) / (2 s^2) - log I0(q r / s^2)

For thick wood the distance to the surface counts, less the s^2 / 2r by which noise moves points
outwards (the essential bias of a geometric fit, Al-Sharadqah and Chernov, Electronic Journal of
Statistics 2009); for wood thinner than the noise the distance to the axis; in between some of both.
Sections and the tubes of limbs are fitted by it.
"""

import numpy as np

from cherrypicker.compiled import compiled

THICK_IN_NOISES = 2.0, 4.0  # from here to there points are taken to lie on what was seen; a guess


@compiled
def bessel_ratio(kappa: float) -> float:
    """I1 / I0, by its asymptotic series or its continued fraction from Amos's bound; to 3e-8."""
    if kappa > 16.0:
        x = 1.0 / kappa
        rest = 25 / 128 + x * (13 / 32 + x * 1073 / 1024)
        return 1.0 - x * (0.5 + x * (0.125 + x * (0.125 + x * rest)))
    ratio = kappa / (15.0 + np.sqrt(225.0 + kappa * kappa))
    for order in range(14, 0, -1):
        ratio = kappa / (2.0 * order + kappa * ratio)
    return ratio


@compiled
def rice(away: float, radius: float, noise: float, swell: float) -> tuple:
    """Derivatives of Rice's -log p, times noise^2, by a point's distance and by the radius.

    Rice's points lie all around. Those of a limb seen from one side do not, and the density on a
    smaller circle would make up for a worse fit: for limbs thicker than the noise the centre
    follows the distances to the surface alone. For thinner ones it does not, else any line of
    points would do as the flank of a thick limb.

    Parameters
    ----------
    away, radius, noise : float
        Distance from the axis, radius there and standard deviation, in one unit.
    swell : float
        1 where the points of thick wood lie as far outwards as the noise moves them, 0 where they
        lie on its surface: the noise is not this section's own.

    Returns
    -------
    by_away, by_radius : float
        First derivatives.
    out, side, own, cross : float
        Second ones: by a move of the axis along the point's direction and across it, by the radius,
        and by both; kept positive definite, and for thick wood those of Gauss and Newton.
    """
    kappa = away * radius / noise**2
    ratio = bessel_ratio(kappa)
    slope = 0.5 if kappa < 1e-6 else 1.0 - ratio / kappa - ratio * ratio
    low, high = THICK_IN_NOISES
    seen = min(max((radius / noise - low) / (high - low), 0.0), 1.0)
    pull = (1.0 - seen) * radius * ratio + seen * np.sqrt(radius**2 + swell * noise**2)
    inwards = ratio + (1.0 - swell) * seen * kappa / (2.0 * (1.0 + kappa * kappa))
    out = min(max(1.0 - (radius / noise) ** 2 * slope, 0.1), 1.0)
    own = min(max(1.0 - (away / noise) ** 2 * slope, 0.1), 1.0)
    cross = min(ratio + kappa * slope, 0.999 * np.sqrt(out * own))
    side = (1 - seen) * min(max(1.0 - pull / max(away, 1e-12), 0.0), 1.0)
    out, own, cross = seen + (1 - seen) * out, seen + (1 - seen) * own, seen + (1 - seen) * cross
    return away - pull, radius - away * inwards, out, side, own, -cross
