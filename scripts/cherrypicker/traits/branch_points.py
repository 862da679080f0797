"""Which branch each wood point belongs to."""

from __future__ import annotations

import numpy as np

from cherrypicker.classes import wood_mask
from cherrypicker.geometry.neighbors import quick_tree
from cherrypicker.pointcloud import PointCloud
from cherrypicker.skeleton import Axis, Skeleton, axis_of_node
from cherrypicker.traits.support import OWN_RADII, owning_nodes, support_reach

NO_BRANCH = -1


def branch_cloud(cloud: PointCloud, skeleton: Skeleton, axis_list: list[Axis]) -> PointCloud:
    """Return the wood of a labelled cloud with a ``branch_id`` a point, ``branches.ply``.

    Parameters
    ----------
    axis_list : list of Axis
        From `cherrypicker.skeleton.axes`; the place in it is the ``branch_id``.

    Returns
    -------
    PointCloud
        With ``source``, each point's row in `cloud`. Wood of no branch (a neighbour's, or what the
        skeleton leaves out) has the ``branch_id`` -1.
    """
    rows = np.flatnonzero(wood_mask(cloud["label"]))
    wood = cloud.select(rows)
    node, distance, radius = owning_nodes(wood.points, skeleton)
    reach = support_reach(quick_tree(wood.points))
    is_own = distance <= np.maximum(OWN_RADII * radius, reach)
    branch = np.where(is_own, axis_of_node(skeleton, axis_list)[node], NO_BRANCH)
    return wood.with_fields(branch_id=branch.astype(np.int32), source=rows.astype(np.int32))
