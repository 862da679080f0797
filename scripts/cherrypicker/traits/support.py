"""What of a cloud and a skeleton is wood of this tree: gaps, stray pieces, what is whose."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import wood_mask
from cherrypicker.geometry.neighbors import LOCAL_REACH, RANK, link_components, quick_tree
from cherrypicker.geometry.tree_walks import sum_from_root, sum_from_tips
from cherrypicker.pointcloud import PointCloud
from cherrypicker.skeleton import Axis, Skeleton, axis_of_node, densify
from cherrypicker.wood.thinned import FEWEST_OF_PIECE

STEP_M = 0.005  # between places that stand for a tube: half the thinnest stem's radius
MIN_REACH_M = 0.03  # within which a wood point has company, in a scan that is not sparse
# Wood that supports the skeleton, and that belongs to it: with 2.0 alone a gap of 0.2 m in a thick
# stem is none, with 1.5 alone a sound scan from photos is told to lack wood
NEAR_RADII, _OWN_RADII = 1.5, 2.0
# From the skeleton: wood farther away has no axis of its own. Within 3 cm two sound scans from
# photos are told to lack some
_MISSED_M = 0.05
_REACH_POINTS = 5_000  # enough for a median

NO_BRANCH = -1


@dataclass
class Support:
    """Which parts of a skeleton, and which wood points, belong to the tree beyond doubt."""

    # (n_nodes,) bool: false for pieces that are shorter than the gap that they hang on
    node: np.ndarray
    point: np.ndarray  # (n_wood,) bool: wood points near a supported node's piece of skeleton
    owner: np.ndarray  # (n_wood,) int64: see `owning_nodes`
    # (n_gaps,) float64: lengths of the stretches that run through no wood points, in the skeleton's
    # unit
    gaps: np.ndarray
    # n_stray, stray_length: pieces left out, and their length
    n_stray: int
    stray_length: float
    # missed, missed_share, missed_length: (n, 3) float64, wood that the skeleton leaves out, and
    # places along the pieces left out; the share of the tree's wood points that the former are, and
    # the extent of the largest cluster of them, see `missed_wood`
    missed: np.ndarray
    missed_share: float
    missed_length: float


def support_reach(wood: cKDTree) -> float:
    """Distance within which a wood point has company, and points of a sparse scan touch.

    It is 0.03 at least.
    """
    some = wood.data[:: 1 + wood.n // _REACH_POINTS]
    distance = wood.query(some, k=[min(RANK + 1, wood.n)])[0]
    return max(MIN_REACH_M, LOCAL_REACH * float(np.median(distance)))


def owning_nodes(
    points: np.ndarray, skeleton: Skeleton
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Upper node of the edge in whose wood, or nearest to whose surface, each point lies.

    An edge's tube is a row of balls. Of all balls the point goes to the one of least power
    distance, d^2 - r^2 (Aurenhammer, Power diagrams, SIAM J. Comput. 16(1), 1987), so that a thin
    lateral does not take the surface of the stem that it grows from. In four dimensions, with
    sqrt(R^2 - r^2) as the fourth coordinate of a ball and R the largest radius, that is the nearest
    neighbour. Wood points (n_points, 3) have the skeleton's frame and unit. With the nodes come the
    points' distances from the axis there and the wood's radii, (n_points,) each.
    """
    places, node, radius, _ = densify(skeleton, STEP_M)
    square = radius**2  # a number's own may differ from an array's in the last digit
    lifted = np.column_stack([places, np.sqrt(square.max() - square)])
    _, ball = cKDTree(lifted).query(np.column_stack([points, np.zeros(len(points))]))
    return node[ball], np.linalg.norm(points - places[ball], axis=1), radius[ball]


def find_support(skeleton: Skeleton, wood: cKDTree, reach: float, *, max_gap: float) -> Support:
    """Find gaps that the skeleton bridges, and pieces beyond them that may not be wood.

    A piece beyond a gap is the tree's where more of it follows wood than the gap is long. A point
    of wood, which is labelled trunk or branch, supports the skeleton within 1.5 radii or `reach`.
    Stretches without any that are longer than `max_gap`, in the skeleton's unit, are gaps.
    """
    samples = densify(skeleton, STEP_M)
    node = samples.node
    near = wood.query(samples.points)[0] <= np.maximum(NEAR_RADII * samples.radius, reach)
    parent, length = skeleton.parent, skeleton.edge_length
    bare = np.bincount(node[~near], samples.length[~near], len(skeleton))  # of each node's edge
    gap, goes_on = np.zeros(len(parent)), np.zeros(len(parent), dtype=bool)
    for each in range(1, len(parent)):  # parents come before children
        if bare[each] > 0.5 * length[each]:
            gap[each] = bare[each] + gap[parent[each]]
            goes_on[parent[each]] = True
    gap[goes_on | (gap <= max_gap)] = 0.0  # it stands at the node that ends it
    covered = length - bare
    follows = sum_from_tips(parent, covered) - covered  # wood beyond each node
    is_rest = follows < follows[0] / 2  # else the foot is what was not seen
    is_stray = (follows < gap) & is_rest
    kept = sum_from_root(parent, is_stray.astype(float)) == 0

    owner, away, thick = owning_nodes(wood.data, skeleton)
    point = kept[owner] & (away <= np.maximum(_OWN_RADII * thick, reach))
    is_far = away > np.maximum(_OWN_RADII * thick, _MISSED_M)
    missed, extent = missed_wood(wood.data[is_far], wood.data[point], reach)
    return Support(
        kept,
        point,
        owner,
        gap[gap > 0],
        int(is_stray.sum()),
        float(follows[is_stray].sum()),
        np.vstack([missed, samples.points[near & ~kept[node]]]),
        len(missed) / max(len(missed) + int(point.sum()), 1),
        extent,
    )


def missed_wood(far: np.ndarray, own: np.ndarray, reach: float) -> tuple[np.ndarray, float]:
    """Wood that a skeleton leaves out: clusters of points far from it that lie beside its own.

    Of the points far from the skeleton, (n_far, 3), those of such clusters, (n, 3), and the
    diagonal of the box around the largest, in their unit. Points within twice the reach touch each
    other; `own` (n_own, 3) are the skeleton's. A neighbour's wood beside the tree counts too.
    """
    cluster = link_components(far, 2 * reach)
    touches = quick_tree(own).query(far, distance_upper_bound=2 * reach)[0] < np.inf
    is_own = (np.bincount(cluster) >= FEWEST_OF_PIECE) & (np.bincount(cluster, touches) > 0)
    missed = is_own[cluster]
    extents = [np.ptp(far[cluster == one], axis=0) for one in np.flatnonzero(is_own)]
    return far[missed], max((float(np.linalg.norm(extent)) for extent in extents), default=0.0)


def branch_cloud(cloud: PointCloud, skeleton: Skeleton, axis_list: list[Axis]) -> PointCloud:
    """Return the wood of a labelled cloud with a ``branch_id`` a point, ``branches.ply``.

    It is the place in `axis_list`, of `cherrypicker.skeleton.axes`; wood of no branch (a
    neighbour's, or what the skeleton leaves out) has -1. ``source`` is each point's row in `cloud`.
    """
    rows = np.flatnonzero(wood_mask(cloud["label"]))
    wood = cloud.select(rows)
    node, distance, radius = owning_nodes(wood.points, skeleton)
    reach = support_reach(quick_tree(wood.points))
    is_own = distance <= np.maximum(_OWN_RADII * radius, reach)
    branch = np.where(is_own, axis_of_node(skeleton, axis_list)[node], NO_BRANCH)
    return wood.with_fields(branch_id=branch.astype(np.int32), source=rows.astype(np.int32))
