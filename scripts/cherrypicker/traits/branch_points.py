"""Which branch each wood point belongs to."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import wood_mask
from cherrypicker.geometry.neighbors import quick_tree
from cherrypicker.pointcloud import PointCloud
from cherrypicker.skeleton import Axis, Skeleton, axis_of_node
from cherrypicker.skeleton.samples import densify
from cherrypicker.traits.support import OWN_RADII, support_reach

NO_BRANCH = -1
_STEP_M = 0.005  # between the balls that stand for a tube: half the thinnest stem's radius (guess)


def branch_of_points(
    points: np.ndarray, skeleton: Skeleton, axis_list: list[Axis], reach: float
) -> np.ndarray:
    """Return the axis in whose wood, or nearest to whose surface, each point lies.

    A branch's tube is a row of balls. Of all balls the point goes to the one of least power
    distance, d^2 - r^2 (Aurenhammer, Power diagrams, SIAM J. Comput. 16(1), 1987), so that a thin
    lateral does not take the surface of the stem that it grows from. In four dimensions, with
    sqrt(R^2 - r^2) as the fourth coordinate of a ball and R the largest radius, that is the nearest
    neighbour.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
        Wood, in the skeleton's frame and unit.
    skeleton : Skeleton
    axis_list : list of Axis
        From `cherrypicker.skeleton.axes`; the place in it is the ``branch_id``.
    reach : float
        Points this near to an axis, or within twice its radius, are its own.

    Returns
    -------
    ndarray of shape (n_points,), int32
        ``branch_id``, -1 for what is of no branch.
    """
    places, node, radius, _ = densify(skeleton, _STEP_M)
    lifted = np.column_stack([places, np.sqrt(radius.max() ** 2 - radius**2)])
    _, ball = cKDTree(lifted).query(np.column_stack([points, np.zeros(len(points))]))
    distance = np.linalg.norm(points - places[ball], axis=1)
    branch = axis_of_node(skeleton, axis_list)[node[ball]]
    is_own = distance <= np.maximum(OWN_RADII * radius[ball], reach)
    return np.where(is_own, branch, NO_BRANCH).astype(np.int32)


def branch_cloud(cloud: PointCloud, skeleton: Skeleton, axis_list: list[Axis]) -> PointCloud:
    """Return the wood of a labelled cloud with a ``branch_id`` a point, ``branches.ply``.

    Returns
    -------
    PointCloud
        With ``source``, each point's row in `cloud`. Wood of no branch (a neighbour's, or what the
        skeleton leaves out) has the ``branch_id`` -1.
    """
    rows = np.flatnonzero(wood_mask(cloud["label"]))
    wood = cloud.select(rows)
    reach = support_reach(quick_tree(wood.points))
    branch = branch_of_points(wood.points, skeleton, axis_list, reach)
    return wood.with_fields(branch_id=branch, source=rows.astype(np.int32))
