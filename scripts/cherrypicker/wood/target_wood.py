"""The target tree's own wood: neighbours are cut off and loose blobs dropped."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from cherrypicker.classes import CLASS_NAMES, Label
from cherrypicker.errors import StageError
from cherrypicker.geometry.neighbors import (
    Neighbors,
    component_links,
    components,
    edge_lengths,
    edges_among,
    link_components,
    sparse_graph,
)
from cherrypicker.geometry.sampling import majority_label, thin_to_limit
from cherrypicker.placement.footprint import Footprint
from cherrypicker.pointcloud import PointCloud
from cherrypicker.wood.feet import Stem, find_stems, stems_off_the_ground
from cherrypicker.wood.target import MASS_VOXEL_M, Choice, choose_target
from cherrypicker.wood.thinned import (
    FEWEST_OF_PIECE,
    FEWEST_WOOD,
    N_NEIGHBORS,
    GrowthOptions,
    agreed_labels,
)

logger = logging.getLogger(__name__)

# Looked at on coarse laser scans: what each changes of the wood of eight scans and a tree of the
# set at the two values in brackets, in percent of the worst cloud (which is tree13 or tree33 of
# AdTree, whose points lie 7 cm apart, where nothing else is said).
# Neighbours within this many point spacings touch each other (2.5: 0.1, 5: 10)
REACH_IN_SPACINGS = 3.5
# From one gap to so many points on gaps are usual (100: 10, 400: 0.7), and so many times the one
# that is exceeded as often is bridged (2: 10, 4: 0.5)
POINTS_A_GAP, IN_USUAL_GAPS = 200, 3.0
# Gaps are meant for trees up to this tall, and grow with taller ones (2: 2, 8: 7, of Tree_1)
GAP_HEIGHT_M = 4.0
# A metre of missing data counts as this many of wood (1: the worst IoU of rows 41 and 16 falls from
# 0.999 and 0.998 to 0.996 and 0.987)
GAP_COST = 3.0
# Of the longest gap: any piece bridges a shorter one. With 0.4, and all of it where a piece points
# ahead, 9 of 14 clouds with holes keep up to 0.6 % less of their wood, five up to 0.7 % more; with
# 0.6, 12 keep less and two 0.2 % more, but strays 13 cm off a small tree join it (2026-11-26)
ANY_PIECE_SHARE = 0.5
AROUND = 1.8  # in voxels: neighbours whose points count as well (all that share a face or an edge)
# Of a way over the border, what is the stem's foot and no meeting place (guess)
FOOT_OF_WAY = 0.2


def select_target_wood(
    points: np.ndarray,
    shared: SharedWood,
    chosen: GrowthOptions,
    *,
    target_xy: ArrayLike | None = None,
    region: Footprint | None = None,
) -> tuple[Choice, dict]:
    """Choose the target tree among those that wood was shared out to.

    Of the cloud's points (n_points, 3), z up, the wood was shared out, as `chosen` says: loose wood
    is told that lies as near to the target as gaps are bridged. Place and region are as of
    `choose_target`, whose errors it has.

    With the choice comes a report: counts of the thinned wood, ``n_stems``, ``n_wood``, ``n_kept``,
    ``n_neighbors_cut``, ``n_floating``; and ``loose``, see `_loose`.
    """
    thin, owner = points[shared.sample], shared.owner[shared.sample]
    choice = choose_target(
        thin, shared.bases, owner, spacing=shared.spacing, region=region, target_xy=target_xy
    )
    keep = owner == choice.target.stem
    reach = max(chosen.gap_m, chosen.stem_gap_m * _growth(thin))
    report: dict[str, Any] = {
        "n_stems": len(shared.bases),
        "n_wood": len(owner),
        "n_kept": int(np.count_nonzero(keep)),
        "n_neighbors_cut": int(np.count_nonzero((owner >= 0) & ~keep)),
        "n_floating": int(np.count_nonzero(owner < 0)),
        "loose": _loose(thin, owner, keep, shared.spacing, reach),
    }
    share = 100 * report["n_kept"] / report["n_wood"]
    logger.info(
        "kept {n_kept:,} of {n_wood:,} wood points ({share:.1f} %): {n_neighbors_cut:,} on "
        "neighbours, {n_floating:,} loose".format(share=share, **report)
    )
    return choice, report


@dataclass
class SharedWood:
    """Which stem each point of a cloud hangs on."""

    # (n_points,) int64: number of the stem, their count for wood of trees outside the region of
    # interest, -1 for loose wood, stray points and what is no wood
    owner: np.ndarray
    sample: np.ndarray  # int64: rows of the wood that was shared out, thinned, without stray points
    spacing: float  # median distance of neighbouring points of the sample
    bases: np.ndarray  # (n_stems, 3) float64: middle of each stem's lowest end


def share_wood(
    points: np.ndarray,
    labels: np.ndarray,
    chosen: GrowthOptions,
    *,
    near: Neighbors,
    ground: np.ndarray,
    region: Footprint | None,
) -> SharedWood:
    """Give every wood point to the stem with the shortest way through the wood.

    Wood that comes in over the border of the region of interest belongs to a tree outside, up to
    the thinnest place on its way to a stem. Pieces without a way to any stem are kept when the gap
    to wood that has one is small, or smaller than the piece is long (missing data along a branch);
    the rest hangs on no stem.

    Thinned points of wood (n_points, 3), z up, have labels (n_points,) and at least `N_NEIGHBORS`
    neighbours; their height is that above the points of the ground, (n_ground, 3). A piece longer
    than it bridges a gap of `gap_m`, other pieces half of it; in a tree taller than 4 m it grows
    with the height. Two pieces of trunk bridge `stem_gap_m`. Without a region of interest nothing
    comes in from outside.
    """
    spacing = near.spacing(1)
    edges, _ = near.touching(N_NEIGHBORS, REACH_IN_SPACINGS * spacing)
    # The usual gap between pieces of wood, 0 where pieces are few
    usual, n_longer = 0.0, len(points) // POINTS_A_GAP
    piece, _ = components(len(points), edges)
    is_piece = np.bincount(piece) >= FEWEST_OF_PIECE  # fewer are stray points
    if is_piece.sum() - 1 > n_longer:  # a gap joins two
        links = _links_among(np.flatnonzero(is_piece[piece]), points, edges)
        usual = float(np.sort(edge_lengths(points, links))[-1 - n_longer])
    gap_m = max(chosen.gap_m * _growth(points), IN_USUAL_GAPS * usual)
    links = _bridges(points, labels, edges, gap_m, max(gap_m, chosen.stem_gap_m))
    stems = find_stems(points, ground, labels) or [lowest_base(points, labels)]
    border = np.empty(0, dtype=np.int64)
    if region is not None:
        border = np.flatnonzero(region.inward(points[:, :2]) < REACH_IN_SPACINGS * spacing)
    owner = _compete(points, edges, links, stems, border)
    piece, _ = components(len(points), np.vstack([edges, links]))
    lost = stems_off_the_ground(points, piece, owner)
    if lost:
        stems = stems + lost
        owner = _compete(points, edges, links, stems, border)
    bases = np.array([stem.base for stem in stems])
    return SharedWood(owner, np.arange(len(points)), spacing, bases)


def share_cloud(
    cloud: PointCloud, chosen: GrowthOptions, most: int, *, region: Footprint | None = None
) -> SharedWood:
    """Give the wood of a cloud with ``label``, z up, to the stems that it hangs on: `share_wood`.

    It is thinned to so many points at most. A voxel stays that holds, with its neighbours,
    `min_density` of the median number of points there; what does not is stray and has no owner. A
    `StageError` where there is too little wood.
    """
    labels = np.asarray(cloud["label"])
    rows = np.flatnonzero(np.isin(labels, list(chosen.classes)))
    if len(rows) < FEWEST_WOOD:
        names = ", ".join(CLASS_NAMES.get(int(index), str(index)) for index in chosen.classes)
        raise StageError(
            f"the cloud holds {len(rows)} points of the classes to contract ({names})",
            key="contract.classes, segment",
        )
    points, _, member, size = thin_to_limit(cloud.points[rows], chosen.voxel_size_m, most)
    # Stray points of a dense reconstruction float alone; the thinnest twig that it shows still has
    # a fair share of the points that thick wood has around a voxel
    a, b = cKDTree(points).query_pairs(AROUND * size, output_type="ndarray").T
    n, count = len(points), np.bincount(member)
    support = count + np.bincount(a, count[b], n) + np.bincount(b, count[a], n)
    least = chosen.min_density * np.median(support)
    keep = support >= least
    logger.info(
        f"kept {np.count_nonzero(keep):,} of {n:,} voxels of wood ({100 * keep.mean():.1f} %), the "
        f"rest too thin (under {least:.1f} points around)"
    )
    number = np.where(keep, np.cumsum(keep) - 1, -1)[member]
    rows, member, thin = rows[number >= 0], number[number >= 0], points[keep]
    near = Neighbors(thin, N_NEIGHBORS)
    known = agreed_labels(thin, majority_label(labels[rows], member, len(thin)), near)
    ground = cloud.points[labels == Label.GROUND]
    shared = share_wood(thin, known, chosen, near=near, ground=ground, region=region)
    owner = np.full(len(cloud), -1, dtype=np.int64)
    owner[rows] = shared.owner[member]
    sample = rows[np.unique(member, return_index=True)[1]]
    return SharedWood(owner, sample, shared.spacing, np.round(shared.bases, 6))


def _growth(points: np.ndarray) -> float:
    """By how much the gaps of a cloud of wood are longer than those of a small tree."""
    return max(1.0, float(np.ptp(points[:, 2])) / GAP_HEIGHT_M)


def lowest_base(points: np.ndarray, labels: np.ndarray) -> Stem:
    """The base of a cloud without a clear stem: its lowest trunk (or else wood) points.

    Wood that hangs together with these, and goes on below them, is trunk down to its end.
    """
    height = points[:, 2]
    slab = 0.02 * (np.ptp(height) or 1.0)
    rows = np.flatnonzero(labels == Label.TRUNK)
    rows = rows if len(rows) >= 3 else np.arange(len(points))
    top = height[rows].min() + slab
    below = np.flatnonzero(height <= top)
    piece = link_components(points[below], slab)
    below = below[np.isin(piece, piece[np.isin(below, rows)])]
    low = below[height[below] <= height[below].min() + slab]
    is_told = np.isin(low, rows)
    low = low[is_told] if is_told.any() else low
    return Stem(np.median(points[low], axis=0), low)


def _bridges(
    points: np.ndarray, labels: np.ndarray, edges: np.ndarray, gap_m: float, stem_gap_m: float
) -> np.ndarray:
    """Links over gaps that missing data leave along branches and in the stem.

    Beside short ones, and those of the stem, the shortest of pieces longer than their gap: these
    are no stray points, whatever they point to. A limb whose lower end no photo shows has several
    ends, and none need point to the stem.
    """
    near = component_links(points, edges, ANY_PIECE_SHARE * gap_m)
    # a ring around the stem hides all of it
    in_stem = _links_among(np.flatnonzero(labels == Label.TRUNK), points, edges, stem_gap_m)
    links = np.vstack([near, in_stem])
    edges = np.vstack([edges, links])
    piece, n_pieces = components(len(points), edges)
    low, high = np.full((n_pieces, 3), np.inf), np.full((n_pieces, 3), -np.inf)
    np.minimum.at(low, piece, points)
    np.maximum.at(high, piece, points)
    extent = np.linalg.norm(high - low, axis=1)
    # shorter pieces have no gap left that they are long beside, and would lie between long ones
    rows = np.flatnonzero((extent >= ANY_PIECE_SHARE * gap_m)[piece])
    long = _links_among(rows, points, edges, gap_m)
    is_longer = extent[piece[long]].min(axis=1) >= edge_lengths(points, long)
    return np.vstack([links, long[is_longer]])


def _compete(
    points: np.ndarray, edges: np.ndarray, links: np.ndarray, stems: list[Stem], border: np.ndarray
) -> np.ndarray:
    """Stem with the shortest way to each point: its index, len(stems) for a tree outside, or -1."""
    n_points = len(points)
    all_edges = np.vstack([edges, links])
    cost = edge_lengths(points, all_edges)
    cost[len(edges) :] *= GAP_COST
    starts = [(stem.rows, np.linalg.norm(points[stem.rows] - stem.base, axis=1)) for stem in stems]

    def ways(starts: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, ...]:
        rows, prices = zip(*starts, strict=True)
        source = n_points + np.repeat(np.arange(len(rows)), list(map(len, rows)))
        seeds = np.stack([source, np.concatenate(rows)], axis=1)
        sources, price = np.arange(n_points, n_points + len(rows)), np.concatenate([cost, *prices])
        graph = sparse_graph(n_points + len(rows), np.vstack([all_edges, seeds]), price)
        return dijkstra(
            graph, directed=False, indices=sources, return_predecessors=True, min_only=True
        )

    way, before, owner = ways(starts)
    reached = border[np.isfinite(way[border])]
    if len(reached):
        # The head start that the target's ways get: crowns meet with their thin ends, so the two
        # ways shall be equally long at the thinnest place between the border and the stem
        tree, handicap = cKDTree(points), np.zeros(len(reached))
        member, n_clusters = components(len(reached), edges_among(reached, edges, n_points))
        for cluster in range(n_clusters):
            own = np.flatnonzero(member == cluster)
            steps = [reached[own[np.argmin(way[reached[own]])]]]
            while 0 <= before[steps[-1]] < n_points:
                steps.append(before[steps[-1]])
            path = np.array(steps)
            length = way[path[0]]
            thickness = tree.query_ball_point(points[path], MASS_VOXEL_M, return_length=True)
            open_ways = way[path] >= FOOT_OF_WAY * length  # the stem's foot is no meeting place
            meeting = path[open_ways][np.argmin(thickness[open_ways])]
            handicap[own] = max(0.0, 2 * way[meeting] - length)
        way, _, owner = ways([*starts, (reached, handicap)])
    return np.where(np.isfinite(way), owner - n_points, -1)[:n_points]


def _links_among(
    rows: np.ndarray, points: np.ndarray, edges: np.ndarray, most: float = np.inf
) -> np.ndarray:
    """Shortest links, no longer than `most`, between the pieces of some of the points."""
    return rows[component_links(points[rows], edges_among(rows, edges, len(points)), most)]


def _loose(
    points: np.ndarray, owner: np.ndarray, keep: np.ndarray, spacing: float, reach: float
) -> list:
    """Pieces of wood on no stem, with none nearer than the target's and that within `reach`.

    They may be the target's beyond a gap that no rule bridges. Each has its box (``low``,
    ``high``), ``n_points`` and its ``gap``; the highest first.
    """
    loose = points[owner < 0]
    touching = cKDTree(loose).query_pairs(REACH_IN_SPACINGS * spacing, output_type="ndarray")
    piece, n_pieces = components(len(loose), touching)
    to_own, to_other = (
        cKDTree(points[wood]).query(loose)[0] for wood in (keep, (owner >= 0) & ~keep)
    )
    found = []
    for number in range(n_pieces):
        own = piece == number
        gap, n_points = float(to_own[own].min()), int(np.count_nonzero(own))
        if n_points >= FEWEST_OF_PIECE and gap <= min(reach, to_other[own].min()):
            low, high = np.round([loose[own].min(axis=0), loose[own].max(axis=0)], 4).tolist()
            found.append({"low": low, "high": high, "n_points": n_points, "gap": round(gap, 4)})
    return sorted(found, key=lambda piece: -piece["high"][2])
