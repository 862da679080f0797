"""Which of the other stems that the crop saw are trees, now that every point has a class."""

from collections.abc import Mapping

import numpy as np

from cherrypicker.classes import Label
from cherrypicker.pointcloud import PointCloud
from cherrypicker.traits.wood import wood_mask

__all__ = ["only_trees"]

REACH = 1.5  # in radii of the stem, from its axis at the foot
MIN_WOOD_SHARE = 0.5  # of the points there that are not ground


def only_trees(crop: Mapping, cloud: PointCloud, scale: float | None) -> dict:
    """Leave out of a crop's report the other stems that turned out to be things.

    The crop works before the classes are known: a board or a marker on a stake that stands under a
    crown looks like a stem there.

    Parameters
    ----------
    crop : mapping
        ``crop.json``, in the unit of the aligned cloud.
    cloud : PointCloud
        The segmented cloud, z up, with a ``label`` field.
    scale : float or None
        Length of the aligned cloud's unit in that of `cloud`; None for 1.

    Returns
    -------
    dict
        The report; its ``other_stems`` are those that hold mostly wood, or of which no point is
        left to tell.
    """
    factor = 1.0 if scale is None else scale
    above = cloud["label"] != Label.GROUND
    points, is_wood = cloud.points[above], wood_mask(cloud["label"][above])

    def is_tree(stem):
        offset = points[:, :2] - factor * np.array([stem["x"], stem["y"]])
        near = np.hypot(*offset.T) < REACH * factor * stem["radius"]
        near &= points[:, 2] < factor * stem["height"]
        return not near.any() or is_wood[near].mean() >= MIN_WOOD_SHARE

    return {**crop, "other_stems": [s for s in crop.get("other_stems") or [] if is_tree(s)]}
