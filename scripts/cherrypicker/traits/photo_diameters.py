"""Diameters by points and photos: one estimate with one error.

Stereo's points scatter by pixels, so the tubes through them err by about as much everywhere along
an axis, whatever its diameter there: thin wood is found too thick and thick wood too thin. So what
the photos' silhouettes (`cherrypicker.photo_check.widths`) add is a difference, not a share, and it
holds where they saw it and near there: a Gaussian process along the axis (simple kriging) [1]_.

References
----------
.. [1] Rasmussen, Williams, "Gaussian processes for machine learning", MIT Press 2006, eq. 2.22.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from cherrypicker.geometry.error_terms import spread
from cherrypicker.skeleton.axes import Axis
from cherrypicker.skeleton.axis_radii import typical_scatter
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.traits.intervals import diameter_terms

#: How far along an axis the errors of a tube's radii go on, m: 0.1 to 0.5 change the mean error of
#: base diameters on five scans of two generators by less than 0.1 mm
REACH_M = 0.2


def with_photos(
    skeleton: Skeleton, axis_list: list[Axis], branches: Iterable[Mapping], scale_error: float = 0.0
) -> Skeleton:
    """Return a skeleton whose radii are what points and photos tell together.

    Parameters
    ----------
    axis_list : list of Axis
        From `cherrypicker.skeleton.axes`.
    branches : iterable of mapping
        ``branches`` of ``photo_check.json``: axes that photos show between clear sky.
    scale_error : float, default 0
        Relative standard error of the scan's scale.

    Returns
    -------
    Skeleton
        With the fields ``photo_error``, the standard error of a node's diameter, NaN on axes that
        no photo tells, and ``radius_by_points``, what it was before. A tube's error has as much
        that nodes share as each has of its own, and the photos' is all theirs in common.
    """
    radius, error = skeleton.radius.copy(), np.full(len(skeleton), np.nan)
    scatter = skeleton.fields.get("residual", np.zeros(len(skeleton)))
    unknown = typical_scatter(skeleton) or 2.0 * radius
    fit = skeleton.fields.get("radius_error", np.zeros(len(skeleton)))
    terms = diameter_terms(2.0 * radius, fit, np.where(scatter > 0, scatter, unknown))
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
