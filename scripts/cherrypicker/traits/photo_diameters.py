"""Diameters by points and photos: one estimate with one error.

Wind, and cameras that are off, scatter the points of a whole scan farther than the noise that tubes
are fitted with. Around an axis the second moment of points is radius^2 + 2 noise^2: what of the
noise the fit does not know adds the same to the square of every thin tube. The photos' silhouettes
(`cherrypicker.photo_check.widths`) tell how much, from the axes that they show between clear sky,
and it is taken from all.

What is left errs by about as much everywhere along an axis, whatever its diameter there. So what
silhouettes add there is a difference, not a share, and it holds where they saw it and near there: a
Gaussian process along the axis (simple kriging) [1]_.

References
----------
.. [1] Rasmussen, Williams, "Gaussian processes for machine learning", MIT Press 2006, eq. 2.22.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from cherrypicker.geometry.error_terms import spread
from cherrypicker.geometry.rice import THICK_IN_NOISES
from cherrypicker.geometry.robust import weighted_median
from cherrypicker.skeleton.axes import Axis
from cherrypicker.skeleton.axis_radii import typical_scatter
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.traits.intervals import diameter_terms

#: How far along an axis the errors of a tube's radii go on, m: 0.1 to 0.5 change the mean error of
#: base diameters on five scans of two generators by less than 0.1 mm
REACH_M = 0.2


def with_photos(
    skeleton: Skeleton, axis_list: list[Axis], branches: Sequence[Mapping], scale_error: float = 0.0
) -> Skeleton:
    """Return a skeleton whose radii are what points and photos tell together.

    The axes are those of `cherrypicker.skeleton.axes`. ``branches`` of ``photo_check.json`` are
    those that photos show between clear sky. ``scale_error`` is the relative standard error of the
    scan's scale.

    The field ``photo_error`` is the standard error of a node's diameter, NaN on axes that no photo
    tells, and ``radius_by_points`` what the radius was before. A tube's error has as much that
    nodes share as each has of its own, and the photos' is all theirs in common.
    """
    radius, error = _without_swelling(skeleton, axis_list, branches), np.full(len(skeleton), np.nan)
    scatter = skeleton.fields.get("residual", np.zeros(len(skeleton)))
    unknown = typical_scatter(skeleton) or 2.0 * skeleton.radius
    fit = skeleton.fields.get("radius_error", np.zeros(len(skeleton)))
    terms = diameter_terms(2.0 * skeleton.radius, fit, np.where(scatter > 0, scatter, unknown))
    by_points = np.asarray(spread(terms))
    for each in branches:
        nodes = axis_list[each["branch_id"]].nodes
        tube, along = 2.0 * radius[nodes], np.cumsum(skeleton.edge_length[nodes])
        width = np.array(each["widths"], dtype=np.float64)
        seen = np.isfinite(width)
        variance = np.median(by_points[nodes]) ** 2
        shared = variance * np.exp(-np.abs(along[:, None] - along[seen]) / REACH_M)
        noise = each["diameter_se"] ** 2 + variance * np.eye(shared.shape[1])
        gain = np.linalg.solve(shared[seen] + noise, shared.T).T
        # Wood tapers: none is thinner than what photos saw of it or nearer to its tip
        ahead = np.fmin.accumulate(width[::-1])[::-1]
        least = np.where(np.isnan(ahead), np.minimum(tube, np.nanmin(width)), ahead)
        both = np.maximum(tube + gain @ (width - tube)[seen], least)
        left = by_points[nodes] * np.sqrt(1.0 - np.sum(gain * shared, axis=1) / variance)
        radius[nodes], error[nodes] = both / 2.0, np.hypot(left, scale_error * both)
    fields = skeleton.fields | {"photo_error": error, "radius_by_points": skeleton.radius}
    return replace(skeleton, radius=radius, fields=fields)


def _without_swelling(
    skeleton: Skeleton, axis_list: list[Axis], branches: Sequence[Mapping]
) -> np.ndarray:
    """Radii less what points add to thin wood that scatter farther than its tubes know, (n_nodes,).

    The square of a thin diameter has as much too much in all of a tree: the median over what
    silhouettes show, each place as sure as it is thin, and less by their own error (Wiener's share
    of signal and noise). Thick wood is where its points are, whatever they scatter by. Where
    silhouettes tell nothing they are the skeleton's.
    """
    diameter = 2.0 * skeleton.radius
    nodes = [axis_list[each["branch_id"]].nodes for each in branches]
    error = np.repeat([each["diameter_se"] for each in branches], list(map(len, nodes)))
    width = np.array([one for each in branches for one in each["widths"]], dtype=np.float64)
    rows = np.concatenate([np.empty(0, np.int64), *nodes])
    seen = np.isfinite(width) & (skeleton.edge_length[rows] > 0)
    rows, width, error = rows[seen], width[seen], error[seen]
    if not len(rows):
        return skeleton.radius.copy()
    tube = diameter[rows]
    weight = skeleton.edge_length[rows] / tube
    swelling = max(weighted_median(tube**2 - width**2, weight), 0.0)
    unsure = weighted_median(2.0 * tube * error, weight)
    noise = np.sqrt(swelling / 8.0)  # of the points in each direction, beyond what is known
    low, high = THICK_IN_NOISES
    is_thin = np.clip((high - skeleton.radius / max(noise, 1e-12)) / (high - low), 0.0, 1.0)
    # No thinner than silhouettes show a place, or wood of which all may be scatter
    least = np.full(len(diameter), np.median(width[tube**2 <= max(swelling, tube.min() ** 2)]))
    least[rows] = width
    excess = is_thin * swelling**3 / (swelling**2 + unsure**2)
    square = np.maximum(diameter**2 - excess, np.minimum(diameter, least) ** 2)
    return np.sqrt(square) / 2.0
