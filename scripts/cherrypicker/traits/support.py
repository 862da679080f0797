"""What of the cloud and the skeleton is wood of this tree: its gaps, its stray pieces."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.compiled import compiled
from cherrypicker.geometry.neighbors import components
from cherrypicker.geometry.sampling import voxel_thin
from cherrypicker.skeleton.model import Skeleton

# All guesses, looked at on the demo's and on generated trees
_SAMPLE_M = 0.01  # step along the skeleton
MIN_REACH_M = 0.03  # within which a wood point has company, in a scan that is not sparse
_COMPANY = 4  # points within it
_ON_SKELETON = 0.2  # of the reach: points this near belong to the skeleton for sure
_NEAR_RADII, OWN_RADII = 1.5, 2.0  # wood that supports the skeleton, and that belongs to it
_SPARSE = 1.5  # reach over the distance to a neighbour
_REACH_POINTS = 5_000  # enough for a median
_MISSED_M = 0.05  # from the skeleton: wood farther away has no axis of its own
_MIN_MISSED_POINTS = 10
_BESIDE_M = 0.15  # from the tree: a loose piece this near is likely its own


@dataclass
class Support:
    """Which parts of a skeleton, and which wood points, belong to the tree beyond doubt."""

    # (n_nodes,) bool: false for pieces that are shorter than the gap that they hang on
    node: np.ndarray
    # (n_wood,) bool: wood points on a supported node's piece of skeleton, and those near it that do
    # not float alone
    point: np.ndarray
    farthest: float  # no such point lies farther from the skeleton than this
    # (n_gaps,) float64: lengths of the stretches that run through no wood points, in the skeleton's
    # unit
    gaps: np.ndarray
    # n_stray, stray_length: pieces left out, and their length
    n_stray: int
    stray_length: float
    # missed_share, missed_length: share of the tree's wood points that the skeleton leaves out, and
    # the extent of the largest cluster of them, see `missed_wood`
    missed_share: float = 0.0
    missed_length: float = 0.0
    # (n_boxes, 2, 3) float64: lower and upper corners around these clusters, and around pieces left
    # out
    missed_boxes: np.ndarray = field(default_factory=lambda: np.empty((0, 2, 3)))


def quick_tree(points: np.ndarray) -> cKDTree:
    """A k-d tree that is built quickly and asked seldom."""
    return cKDTree(points, balanced_tree=False, compact_nodes=False)


def densify(
    skeleton: Skeleton, step: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Sample every edge of a skeleton at most `step` apart.

    Returns
    -------
    points : ndarray of shape (n_samples, 3), float64
    node : ndarray of shape (n_samples,), int64
        The edge's upper node (the root for its own sample).
    radius : ndarray of shape (n_samples,), float64
    spacing : ndarray of shape (n_samples,), float64
        Length of skeleton that the sample stands for.
    """
    nodes = np.arange(1, len(skeleton))
    length = skeleton.edge_length[1:]
    count = np.maximum(np.ceil(length / step).astype(int), 1)
    node = np.repeat(nodes, count)
    start = np.repeat(np.cumsum(count) - count, count)
    share = (np.arange(len(node)) - start + 1.0) / np.repeat(count, count)
    parent = skeleton.parent[node]
    points = skeleton.points[parent] + share[:, None] * (
        skeleton.points[node] - skeleton.points[parent]
    )
    radius = (1 - share) * skeleton.radius[parent] + share * skeleton.radius[node]
    spacing = np.repeat(length / count, count)
    return (
        np.vstack([skeleton.points[:1], points]),
        np.concatenate([[0], node]),
        np.concatenate([skeleton.radius[:1], radius]),
        np.concatenate([[0.0], spacing]),
    )


def support_reach(wood: cKDTree) -> float:
    """Distance within which a wood point has company: 0.03, or more in a sparse scan.

    Parameters
    ----------
    wood : cKDTree
        Of the wood points.

    Returns
    -------
    float
        1.5 times the median distance to the fourth neighbour, 0.03 at least.
    """
    some = wood.data[:: 1 + wood.n // _REACH_POINTS]
    distance = wood.query(some, k=[min(_COMPANY + 1, wood.n)])[0]
    return max(MIN_REACH_M, _SPARSE * float(np.median(distance)))


def find_support(
    skeleton: Skeleton,
    wood: cKDTree,
    reach: float,
    *,
    max_gap: float,
) -> Support:
    """Find gaps that the skeleton bridges, and pieces beyond them that may not be wood.

    A piece beyond a gap is the tree's where more of it follows wood than the gap is long.

    Parameters
    ----------
    wood : cKDTree
        Of the points labelled trunk or branch.
    reach : float
        A wood point supports the skeleton within 1.5 radii or this distance.
    max_gap : float
        Stretches without wood points longer than this are gaps; in the skeleton's unit.
    """
    samples, owner, radius, spacing = densify(skeleton, _SAMPLE_M)
    near = wood.query(samples)[0] <= np.maximum(_NEAR_RADII * radius, reach)
    bare = np.bincount(owner[~near], spacing[~near], len(skeleton))  # length of each node's edge
    run, is_gap, beyond, kept = _gaps(skeleton.parent, skeleton.edge_length, bare, float(max_gap))
    is_stray = is_gap & (beyond < run) & (beyond < beyond[0] / 2)
    n_stray, stray_length = int(np.count_nonzero(is_stray)), float(beyond[is_stray].sum())
    close, sample = cKDTree(samples).query(wood.data)
    allowed = np.maximum(OWN_RADII * radius, reach)
    point = kept[owner[sample]] & (close <= allowed[sample])
    rows = np.flatnonzero(point)
    # The sparse end of a shoot has few points; those on the skeleton need no company.
    point[rows] = close[rows] <= np.maximum(radius[sample[rows]], _ON_SKELETON * reach)
    rows = rows[~point[rows]]
    company, _ = wood.query(wood.data[rows], k=[_COMPANY + 1], distance_upper_bound=reach)
    point[rows] = np.isfinite(company[:, 0])
    is_far = close > np.maximum(OWN_RADII * radius[sample], _MISSED_M)
    share, length, boxes = missed_wood(wood.data, point, is_far, reach)
    left_out = near & ~kept[owner]
    boxes = np.concatenate([boxes, _boxes(samples[left_out], owner[left_out], skeleton, kept)])
    gaps = run[is_gap]
    return Support(kept, point, allowed.max(), gaps, n_stray, stray_length, share, length, boxes)


def _boxes(
    samples: np.ndarray, owner: np.ndarray, skeleton: Skeleton, kept: np.ndarray
) -> np.ndarray:
    """Boxes around what follows wood of each piece that is left out, (n_pieces, 2, 3) float64."""
    piece = np.arange(len(skeleton))
    for node in np.flatnonzero(~kept):
        if not kept[skeleton.parent[node]]:
            piece[node] = piece[skeleton.parent[node]]
    own = [samples[piece[owner] == number] for number in np.unique(piece[owner])]
    boxes = [[some.min(axis=0), some.max(axis=0)] for some in own]
    return np.array(boxes).reshape(-1, 2, 3)


@compiled
def _gaps(
    parent: np.ndarray, length: np.ndarray, bare: np.ndarray, max_gap: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Gaps of a skeleton whose edges are bare over some length, and what short lies beyond them.

    Returns the bare length that ends at each node, whether a gap ends there, the length of
    skeleton from there upwards without its bare parts, and which nodes are no shorter piece.
    """
    n = len(parent)
    run, beyond = np.zeros(n), np.zeros(n)
    goes_on, is_gap = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
    kept = np.ones(n, dtype=np.bool_)
    for node in range(1, n):  # parents come before children
        if bare[node] > 0.5 * length[node]:
            run[node] = bare[node] + run[parent[node]]
            goes_on[parent[node]] |= run[node] > 0
    for node in range(n - 1, 0, -1):
        beyond[parent[node]] += beyond[node] + length[node] - bare[node]
    for node in range(n):
        is_gap[node] = run[node] > max_gap and not goes_on[node]
        is_rest = beyond[node] < beyond[0] / 2  # else the foot is what was not seen
        kept[node] = not (is_gap[node] and beyond[node] < run[node] and is_rest)
        if node:
            kept[node] &= kept[parent[node]]
    return run, is_gap, beyond, kept


def missed_wood(
    wood: np.ndarray, supported: np.ndarray, is_far: np.ndarray, reach: float
) -> tuple[float, float, np.ndarray]:
    """Wood that a skeleton leaves out: clusters of points far from it that lie beside its own.

    Parameters
    ----------
    wood : ndarray of shape (n_wood, 3), float64
    supported, is_far : ndarray of shape (n_wood,), bool
        Points that belong to the skeleton, and points far from it.
    reach : float
        Points this near touch each other.

    Returns
    -------
    share : float
        Of all the skeleton's and left-out points. A neighbour's wood beside the tree counts too.
    length : float
        Diagonal of the box around the largest cluster, in the unit of `wood`.
    boxes : ndarray of shape (n_clusters, 2, 3), float64
        Lower and upper corners of all such boxes.
    """
    none = 0.0, 0.0, np.empty((0, 2, 3))
    if not is_far.any() or not supported.any():
        return none
    sites, _, member = voxel_thin(wood[is_far], reach)
    pairs = cKDTree(sites).query_pairs(2 * reach, output_type="ndarray")
    cluster, n_clusters = components(len(sites), pairs)
    count = np.bincount(cluster, np.bincount(member, minlength=len(sites)), n_clusters)
    large = (count >= _MIN_MISSED_POINTS)[cluster]
    if not large.any():
        return none
    beside = max(2 * reach, _BESIDE_M)
    is_beside = quick_tree(wood[supported]).query(sites[large])[0] <= beside
    touches = np.bincount(cluster[large], is_beside, n_clusters) > 0
    if not touches.any():
        return none
    low, high = np.full((n_clusters, 3), np.inf), np.full((n_clusters, 3), -np.inf)
    np.minimum.at(low, cluster, sites)
    np.maximum.at(high, cluster, sites)
    n_missed = float(count[touches].sum())
    boxes = np.stack([low, high], axis=1)[touches]
    length = np.linalg.norm(boxes[:, 1] - boxes[:, 0], axis=1).max()
    return n_missed / (n_missed + np.count_nonzero(supported)), float(length), boxes
