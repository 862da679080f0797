"""Tell trunk from branch by the limbs of every tree that stands in a cloud.

A network that looks at points cannot see the border between the two, which is a matter of how
thick an axis goes on over a fork. So the wood is shared out to the stems that it hangs on, and each
tree's limbs are grown and joined, as the skeleton's are later (`cherrypicker.limbs`). The trunk is
the axis of order 0 (`cherrypicker.skeleton.axes`), and its points are those of the limbs along it.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import Label, wood_mask
from cherrypicker.geometry.sampling import majority_label, thin_to_limit
from cherrypicker.limbs.growth import grow_limbs
from cherrypicker.limbs.joints import join_limbs
from cherrypicker.segmentation.spheres import TreeFrame
from cherrypicker.segmentation.white_rings import MAX_OFF, STEP_M, ring_points
from cherrypicker.skeleton.axes import TRUNK_KEEPS, TRUNK_SKIP, Axis, axes
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.wood.gaps import STEM_GAP_M
from cherrypicker.wood.target_wood import share_wood

__all__ = ["StemModel", "StemTrace", "relabel_wood", "trace_stems"]

logger = logging.getLogger(__name__)

VOXEL_M = 0.006  # wood is thinned to: about what our stereo's points lie apart (guess)
MAX_POINTS = 120_000  # or to so many points; bounds the time
MIN_POINTS = 60  # thinned points of a tree; of fewer the network's labels stay (guess)
HALF_LOST = (1 + TRUNK_KEEPS) / 2  # tubes are smooth: half of a step lies on either side of it
FLARE = 1.15  # a stem's foot is so much wider than its tube there (a guess)
HIDDEN_M = 0.1  # grass hides no more of a stem (a guess)
EDGE_M = 0.01  # longest edge of an axis, as `graph.spacing_m`


@dataclass(frozen=True)
class StemModel:
    """How stems are traced; the field is a config key of ``segment``.

    Attributes
    ----------
    stem_gap_m : float
        Longest gap along a stem that is bridged, metres of the tree's frame.
    """

    stem_gap_m: float = STEM_GAP_M


@dataclass
class StemTrace:
    """The trunk of one tree.

    Attributes
    ----------
    points : ndarray of shape (n_nodes, 3), float64
        Its axis from the foot up.
    radius : ndarray of shape (n_nodes,), float64
    rows : ndarray of int64
        Rows of the tree's wood in the cloud that was traced.
    is_trunk : ndarray of shape (len(rows),), bool
        Which of them are trunk.
    """

    points: np.ndarray
    radius: np.ndarray
    rows: np.ndarray
    is_trunk: np.ndarray


def relabel_wood(
    points: np.ndarray,
    labels: np.ndarray,
    frame: TreeFrame,
    model: StemModel | None = None,
    colors: np.ndarray | None = None,
) -> np.ndarray:
    """Decide between trunk and branch by the limbs of the trees.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
        In the cloud's frame.
    labels : ndarray of shape (n_points,), uint8
    frame : cherrypicker.segmentation.spheres.TreeFrame
    model : StemModel, optional
    colors : ndarray of shape (n_points, 3), optional
        In [0, 1]; white rings on the stems become calibration unit.

    Returns
    -------
    ndarray of shape (n_points,), uint8
        A copy; only what was trunk or branch differs, and ground within a stem, which is trunk.
        Wood that hangs on no stem is branch; trees that make no limb keep their labels.
    """
    result = labels.copy()
    rows = np.flatnonzero(wood_mask(labels))
    wood = frame.apply(points[rows])
    ground = frame.apply(points[labels == Label.GROUND])
    if len(wood) < MIN_POINTS:
        return result
    thin, _, member, _ = thin_to_limit(wood, VOXEL_M, MAX_POINTS)
    known = majority_label(labels[rows], member, len(thin))
    found, loose = trace_stems(thin, known, ground, model or StemModel())
    chosen = known.copy()
    chosen[loose] = Label.BRANCH
    for stem in found:
        chosen[stem.rows] = np.where(stem.is_trunk, Label.TRUNK, Label.BRANCH)
    touched = loose.copy()
    touched[np.concatenate([stem.rows for stem in found] or [np.empty(0, np.int64)])] = True
    result[rows] = np.where(touched[member], chosen[member], labels[rows])
    _relabel_feet(points, result, frame, found)
    if colors is not None:
        _relabel_rings(points, result, colors, frame, found)
    changed = np.count_nonzero(result[rows] != labels[rows])
    logger.info("the stems' course changed %.1f %% of the wood", 100 * changed / len(rows))
    return result


def _relabel_feet(
    points: np.ndarray, labels: np.ndarray, frame: TreeFrame, stems: list[StemTrace]
) -> None:
    """Label ground within a stem trunk, in place: its foot passes for ground in grass."""
    rows = np.flatnonzero(labels == Label.GROUND)
    local = frame.apply(points[rows])
    below = np.arange(0, HIDDEN_M, EDGE_M)[::-1, None] * [0, 0, 1]
    for stem in stems:
        places = np.vstack([stem.points[0] - below, stem.points])
        radius = FLARE * np.concatenate([np.full(len(below), stem.radius[0]), stem.radius])
        low, high = places.min(axis=0) - radius.max(), places.max(axis=0) + radius.max()
        near = np.flatnonzero(((local > low) & (local < high)).all(axis=1))
        distance, nearest = cKDTree(places).query(local[near], workers=1)
        labels[rows[near[distance <= radius[nearest]]]] = Label.TRUNK


def _relabel_rings(
    points: np.ndarray,
    labels: np.ndarray,
    colors: np.ndarray,
    frame: TreeFrame,
    stems: list[StemTrace],
) -> None:
    """Label the white rings on the trunks, in place; the network's are wider by its voxels."""
    rows = np.flatnonzero((labels == Label.TRUNK) | (labels == Label.CALIBRATION_UNIT))
    local = frame.apply(points[rows]) / frame.scale  # true metres: a tall tree's ring shrinks too
    for stem in stems:
        places, radius = stem.points / frame.scale, stem.radius / frame.scale
        distance, nearest = cKDTree(places).query(local, workers=1)
        near = np.flatnonzero(distance <= radius[nearest] + MAX_OFF)
        is_ring = ring_points(local[near], colors[rows[near]], places, radius)
        if is_ring.any():
            off_ring = cKDTree(local[near[is_ring]]).query(local[near], workers=1)[0] > STEP_M
            labels[rows[near[is_ring]]] = Label.CALIBRATION_UNIT
            labels[rows[near[off_ring]]] = Label.TRUNK


def trace_stems(
    thin: np.ndarray, labels: np.ndarray, ground: np.ndarray, model: StemModel
) -> tuple[list[StemTrace], np.ndarray]:
    """Trace the trunk of every tree in a cloud of thinned wood.

    Parameters
    ----------
    thin : ndarray of shape (n_points, 3), float64
        Wood of all trees in the tree's frame, z up.
    labels : ndarray of shape (n_points,), int
    ground : ndarray of shape (n_ground, 3)
        May be empty.
    model : StemModel

    Returns
    -------
    stems : list of StemTrace
    loose : ndarray of shape (n_points,), bool
        Wood that hangs on no stem.
    """
    shared = share_wood(thin, labels, ground=ground, stem_gap_m=model.stem_gap_m)
    found = []
    for number, stem in enumerate(shared.stems):
        rows = np.flatnonzero(shared.owner == number)
        if len(rows) >= MIN_POINTS:
            try:
                found.append(_trace(thin, rows, stem.base, labels[rows] == Label.TRUNK))
            except ValueError as error:  # no limb
                logger.warning("stem at (%.2f, %.2f): %s", *stem.base[:2], error)
    return found, shared.owner < 0


def _trace(thin: np.ndarray, rows: np.ndarray, base: np.ndarray, known: np.ndarray) -> StemTrace:
    """The trunk of the tree whose wood the rows are."""
    points = thin[rows]
    limbs = grow_limbs(points, base, stem=known)
    nodes, parent, radius, limb = join_limbs(limbs.limbs, limbs.spacing, EDGE_M)
    for number in np.unique(limb)[1:]:  # a stub's tube may be wider than what it grows from
        own = np.flatnonzero(limb == number)
        radius[own] = np.minimum(radius[own], radius[parent[own[0]]])
    skeleton = Skeleton(nodes, parent, radius, np.full(len(nodes), int(Label.BRANCH)))
    trunk = _to_its_end(skeleton, axes(skeleton), limb)
    on_trunk = np.zeros(len(nodes), bool)
    on_trunk[trunk] = True
    is_trunk = np.zeros(len(points), bool)
    for number in np.unique(limb[trunk]):
        own, near = np.flatnonzero(limb == number), np.flatnonzero(limbs.member == number)
        is_trunk[near] = on_trunk[own][cKDTree(nodes[own]).query(points[near])[1]]
    logger.info(
        "stem at (%.2f, %.2f): %.2f m, radius %.1f to %.1f mm, %s of %s points are trunk",
        *nodes[0, :2],
        skeleton.edge_length[trunk[1:]].sum(),
        1000 * radius[trunk[0]],
        1000 * radius[trunk[-1]],
        f"{np.count_nonzero(is_trunk):,}",
        f"{len(points):,}",
    )
    return StemTrace(nodes[trunk], radius[trunk], rows, is_trunk)


def _to_its_end(skeleton: Skeleton, split: list[Axis], limb: np.ndarray) -> np.ndarray:
    """Nodes of the trunk up to where the stem's limb has lost its thickness.

    Order 0 ends at the last fork below that place, which may be a diameter lower: of the arms of
    a head the lowest leaves there, and the stem goes on to the highest.
    """
    trunk = split[0].nodes
    way = np.concatenate([[0.0], np.cumsum(skeleton.edge_length[trunk[1:]])])
    diameter = 2 * skeleton.radius[trunk[-1]]
    below = skeleton.radius[trunk[(way <= way[-1] - TRUNK_SKIP * diameter)]]
    for axis in split[1:]:
        if axis.attach == trunk[-1] and limb[axis.nodes[0]] == limb[trunk[-1]] and len(below):
            least = HALF_LOST * below[-1]
            thin = (skeleton.radius[axis.nodes] < least) | (limb[axis.nodes] != limb[trunk[-1]])
            return np.concatenate(
                [trunk, axis.nodes[: np.argmax(thin)] if thin.any() else axis.nodes]
            )
    return trunk
