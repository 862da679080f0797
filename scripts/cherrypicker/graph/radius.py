"""Radii of a graph's nodes: what the circles say, less the noise of thin wood."""

import numpy as np

from cherrypicker.geometry.axis_radii import fit_axis_radii, less_spread

__all__ = ["fit_radii"]

CLEAR_ARC, CLEAR_SPREAD, FEWEST_CLEAR = 240.0, 0.25, 10  # circles that tell the noise
CLEAR_QUANTILE = 0.25  # bark, flutes and bends scatter points as well: the calmer circles count
RAYLEIGH_SPREAD = 0.6  # robust spread of the distances from an axis without radius, over the noise
LEAST_SHARE = 0.3  # of the distance of its points that a radius has


def fit_radii(
    skeleton, surface, *, spacing, max_radius, least_radius=0.001, recentre=True, is_final=False
):
    """Radius of each node, and its place on the axis, from the surface points around it.

    Parameters
    ----------
    skeleton, surface, spacing, max_radius, least_radius, recentre
        See `cherrypicker.geometry.axis_radii.fit_axis_radii`.
    is_final : bool, default False
        Take the noise that the clear circles of thick wood show off thin wood as well. Pruning
        compares points with radii that do not.

    Returns
    -------
    Skeleton
        With `radius` and the fields ``n_points``, ``arc_deg``, ``residual``.
    """
    return fit_axis_radii(
        skeleton,
        surface,
        spacing=spacing,
        max_radius=max_radius,
        least_radius=least_radius,
        recentre=recentre,
        less_noise=_less_common_noise if is_final else less_spread,
    )


def _less_common_noise(fits):
    """Radii less what noise adds to them.

    Points at r from an axis, with noise s across it, lie at distances of a Rice distribution, whose
    squared median is r^2 + s^2 where r is large and 1.386 s^2 where it is none. Wood thinner than
    the noise hides it: the distances then scatter by less than s. So s is the scatter around the
    clear circles of thicker wood, but no more than thin wood's own scatter allows for.
    """
    radius, spread, is_circle = fits[:, 0], fits[:, 4], fits[:, 5] > 0
    clear = is_circle & (fits[:, 3] >= CLEAR_ARC) & (spread < CLEAR_SPREAD * radius)
    noise = spread
    if np.count_nonzero(clear) >= FEWEST_CLEAR:
        noise = np.maximum(spread, np.quantile(spread[clear], CLEAR_QUANTILE))
        noise = np.where(is_circle, spread, np.minimum(noise, spread / RAYLEIGH_SPREAD))
    squared, noise = radius**2, np.maximum(noise, 1e-12) ** 2
    found = squared - noise
    for _ in range(3):
        share = 0.386 * np.exp(-np.maximum(found, 0.0) / (2 * noise))
        found = squared - noise * (1 + np.where(is_circle, 0.0, share))
    return np.sqrt(np.maximum(found, LEAST_SHARE**2 * squared))
