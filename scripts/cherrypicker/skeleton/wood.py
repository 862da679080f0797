"""The target tree's own wood: neighbours are cut off and loose blobs dropped."""

import logging
from dataclasses import dataclass, field

import numpy as np
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from cherrypicker.errors import StageError
from cherrypicker.skeleton.neighbors import component_links, components, knn_edges, sparse_graph
from cherrypicker.skeleton.sampling import median_spacing
from cherrypicker.skeleton.stems import Stem, find_stems

__all__ = ["TargetWood", "select_target_wood"]

logger = logging.getLogger(__name__)

N_NEIGHBORS = 10
REACH_IN_SPACINGS = 3.5  # neighbours within this many point spacings touch each other
GAP_COST = 3.0  # a metre of missing data counts as this many of wood
BORDER_IN_SPACINGS = 3.0
LINE_SHARE = 0.9  # share of the variance along its axis from which a piece has a direction
DIRECTION_COSINE = np.cos(np.radians(30.0))
WHOLE_TREE_SHARE = 0.1  # of the target's wood: from here another stem is a second whole tree


@dataclass
class TargetWood:
    """Which points are the target's wood.

    Attributes
    ----------
    keep : ndarray of shape (n_points,), bool
    base : ndarray of shape (3,), float64
        Base of the target's stem.
    report : dict
        Counts: ``n_stems``, ``n_wood``, ``n_kept``, ``n_neighbors_cut``, ``n_floating``, and
        ``other_trees``: base, number of points and top of every other stem's wood.
    """

    keep: np.ndarray
    base: np.ndarray
    report: dict = field(default_factory=dict)


def select_target_wood(
    points, labels, *, ground=None, target_xy=None, box=None, gap_m=0.15, stem_gap_m=0.6
):
    """Keep the target tree's wood.

    Every wood point goes to the stem base with the shortest way through the wood. Wood that
    comes in over the border of the region of interest belongs to a tree outside: it competes as
    if its stem stood as far from the border point as the target's does. Pieces without a way to
    any stem are kept when the gap to the target's wood is small, or larger but in the direction
    of the piece (missing data along a branch); the rest is dropped and counted.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
        Thinned wood points, z up.
    labels : ndarray of shape (n_points,), int
    ground : ndarray of shape (n_ground, 3), optional
        Ground points, for the height above ground.
    target_xy : array-like of 2 floats, optional
        Where the target stands; left out, the tree with the most wood is the target.
    box : ndarray of shape (2, 2), optional
        x/y corners (low, high) of the region of interest; left out, nothing comes in from
        outside.
    gap_m : float, default 0.15
        Longest gap along the direction of a branch that is still bridged; half of it in any
        other direction.
    stem_gap_m : float, default 0.6
        Longest gap between two pieces of trunk.

    Returns
    -------
    TargetWood

    Raises
    ------
    StageError
        If there is no wood.
    """
    if not len(points):
        raise StageError("no wood points", key="contract.classes")
    spacing = median_spacing(points, cKDTree(points)) if len(points) > 1 else 0.0
    edges = knn_edges(points, N_NEIGHBORS, REACH_IN_SPACINGS * spacing)
    links = _bridges(points, labels, edges, gap_m, stem_gap_m)
    stems = find_stems(points, ground) or [_lowest_base(points, labels)]
    owner, way = _compete(points, edges, links, stems, _border_seeds(points, box, spacing))
    target = _target_stem(stems, owner, target_xy)
    keep = owner == target
    report = _report(points, stems, owner, target)
    other = ", ".join(f"{tree['n_points']:,}" for tree in report["other_trees"])
    logger.info(
        "kept %s of %s wood points (%.1f %%): %s on neighbours, %s loose",
        f"{report['n_kept']:,}",
        f"{report['n_wood']:,}",
        100 * report["n_kept"] / report["n_wood"],
        f"{report['n_neighbors_cut']:,}",
        f"{report['n_floating']:,}",
    )
    if any(tree["whole"] for tree in report["other_trees"]):
        logger.warning("a second whole tree stands in the region of interest (%s points)", other)
    return TargetWood(keep, stems[target].base, report)


def _lowest_base(points, labels):
    """The base of a cloud without a clear stem: its lowest trunk (or else wood) points."""
    rows = np.flatnonzero(labels == 1)
    rows = rows if len(rows) >= 3 else np.arange(len(points))
    height = points[rows, 2]
    low = rows[height <= height.min() + 0.02 * (np.ptp(points[:, 2]) or 1.0)]
    return Stem(np.median(points[low], axis=0), low)


def _bridges(points, labels, edges, gap_m, stem_gap_m):
    """Links over gaps that missing data leave along branches and in the stem."""
    member, _ = components(len(points), edges)
    longest = max(gap_m, stem_gap_m)
    links = component_links(points, edges, longest)
    if not len(links):
        return links
    length = np.linalg.norm(points[links[:, 0]] - points[links[:, 1]], axis=1)
    fine = length <= gap_m / 2
    trunk = (labels[links] == 1).all(axis=1)
    fine |= trunk & (length <= stem_gap_m)
    for index in np.flatnonzero(~fine & (length <= gap_m)):
        a, b = links[index]
        direction = (points[b] - points[a]) / length[index]
        fine[index] = any(
            _points_along(points[member == member[row]], points[row], direction, 2 * gap_m)
            for row in (a, b)
        )
    return links[fine]


def _points_along(piece, end, direction, reach):
    """Whether a piece of wood is a line near its end, and the line has this direction."""
    near = piece[np.linalg.norm(piece - end, axis=1) <= reach]
    if len(near) < 5:
        return False
    _, values, axes = np.linalg.svd(near - near.mean(axis=0), full_matrices=False)
    share = values[0] ** 2 / np.square(values).sum()
    return share >= LINE_SHARE and abs(axes[0] @ direction) >= DIRECTION_COSINE


def _border_seeds(points, box, spacing):
    """Rows of wood points at the border of the region of interest."""
    if box is None:
        return np.empty(0, dtype=np.int64)
    box, margin = np.asarray(box, dtype=np.float64), BORDER_IN_SPACINGS * spacing
    near = (points[:, :2] < box[0] + margin) | (points[:, :2] > box[1] - margin)
    return np.flatnonzero(near.any(axis=1))


def _compete(points, edges, links, stems, border):
    """Stem with the shortest way to each point: its index, len(stems) for a tree outside, or -1.

    Returns the owner of each point and the length of its way.
    """
    n_points, n_stems = len(points), len(stems)
    all_edges = np.vstack([edges, links]).astype(np.int64)
    cost = np.linalg.norm(points[all_edges[:, 0]] - points[all_edges[:, 1]], axis=1)
    cost[len(edges) :] *= GAP_COST
    seeds = [np.stack([np.full(len(s.rows), n_points + i), s.rows], 1) for i, s in enumerate(stems)]
    seed_cost = [np.linalg.norm(points[s.rows] - s.base, axis=1) for s in stems]
    if len(border):
        bases = np.array([stem.base for stem in stems])
        handicap = np.linalg.norm(points[border][:, None] - bases[None], axis=2).min(axis=1)
        seeds.append(np.stack([np.full(len(border), n_points + n_stems), border], 1))
        seed_cost.append(handicap)
    graph = sparse_graph(
        n_points + n_stems + 1,
        np.vstack([all_edges, *seeds]),
        np.concatenate([cost, *seed_cost]),
    )
    way, _, source = dijkstra(
        graph,
        directed=False,
        indices=np.arange(n_points, n_points + n_stems + 1),
        return_predecessors=True,
        min_only=True,
    )
    owner = np.where(np.isfinite(way), source - n_points, -1)[:n_points]
    return owner, way[:n_points]


def _target_stem(stems, owner, target_xy):
    if target_xy is None:
        sizes = [np.count_nonzero(owner == index) for index in range(len(stems))]
        return int(np.argmax(sizes))
    offset = [np.linalg.norm(stem.base[:2] - np.asarray(target_xy)) for stem in stems]
    return int(np.argmin(offset))


def _report(points, stems, owner, target):
    n_kept = int(np.count_nonzero(owner == target))
    others = []
    for index, stem in enumerate(stems):
        own = points[owner == index]
        if index != target and len(own):
            others.append(
                {
                    "base": [round(float(value), 4) for value in stem.base],
                    "n_points": len(own),
                    "top_z": round(float(own[:, 2].max()), 4),
                    "whole": len(own) >= WHOLE_TREE_SHARE * n_kept,
                }
            )
    return {
        "n_stems": len(stems),
        "n_wood": len(points),
        "n_kept": n_kept,
        "n_neighbors_cut": int(np.count_nonzero((owner >= 0) & (owner != target))),
        "n_floating": int(np.count_nonzero(owner < 0)),
        "other_trees": others,
    }
