"""Axes that touch one another."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.pruning.standing import StandingTree


def crossings(
    standing: StandingTree, gap: float = 0.005, least_angle_deg: float = 15.0
) -> np.ndarray:
    """Places where two side axes that stand touch, one a pair of axes, (n, 2) int64.

    Of each the node of either axis. Nearer to the last node that both hang on than axes part that
    leave one another at the least angle it is a fork.

    Parameters
    ----------
    gap : float, default 0.005
        What may lie between their surfaces: wind rubs what is nearer (guess).
    least_angle_deg : float, default 15
        A guess.
    """
    skeleton, owner = standing.tree.skeleton, standing.owner
    is_own = (
        standing.stands & ~standing.stem & (standing.along > standing.along[standing.base[owner]])
    )
    own = np.flatnonzero(is_own)
    if not len(own):
        return np.zeros((0, 2), dtype=np.int64)
    radius = skeleton.radius
    reach = 2.0 * radius[own].max() + gap
    near = own[cKDTree(skeleton.points[own]).query_pairs(reach, output_type="ndarray")]
    one, other = near[owner[near[:, 0]] != owner[near[:, 1]]].T
    apart = np.linalg.norm(skeleton.points[one] - skeleton.points[other], axis=1)
    thick = radius[one] + radius[other] + gap
    to_root, found = skeleton.distance_to_root(), {}
    for row in np.flatnonzero(apart <= thick)[np.argsort((apart - thick)[apart <= thick])]:
        pair = frozenset((owner[one[row]], owner[other[row]]))
        fork = standing.fork(int(one[row]), int(other[row]))
        way = to_root[one[row]] + to_root[other[row]] - 2.0 * (to_root[fork] + radius[fork])
        if pair not in found and way > thick[row] / np.sin(np.radians(least_angle_deg) / 2.0):
            found[pair] = (one[row], other[row])
    return np.array(sorted(found.values()), dtype=np.int64).reshape(-1, 2)
