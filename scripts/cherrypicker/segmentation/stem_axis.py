"""Trace the stems of a cloud by geometry: where the trunk runs, how thick it is, where it ends.

A network that looks at points cannot see the border between trunk and branch, which is a matter of
how thick an axis goes on over a fork. Here the wood is flooded from the foot of each stem along a
neighbour graph; connected pieces of equal way from the foot are the nodes of a quick curve skeleton
(level sets, Verroust and Lazarus 2000). Circles fitted to the wood around it give the radii, and
the axis that goes on into the thickest child at every fork is the stem, as in
`cherrypicker.skeleton.axes`. It ends where the rule of the labels ends the trunk.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.geometry.sampling import thin_to_limit
from cherrypicker.segmentation.quick_skeleton import FEWEST_NODES, quick_skeletons
from cherrypicker.skeleton.axes import SIMILAR_RADIUS, TRUNK_KEEPS
from cherrypicker.skeleton.axis_radii import fit_axis_radii
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.wood.gaps import GAP_M, STEM_GAP_M

__all__ = ["StemAxis", "StemModel", "trace_stems"]

SHORT = 0.4  # a child that reaches less far than this share of its siblings' is no heir
FEWEST_SEEN = 12  # points of a circle whose radius counts
ROUGH_M = 0.0008  # radii differ by about this much for the noise of a cloud alone


@dataclass(frozen=True)
class StemModel:
    """How stems are traced; lengths in metres of the tree's frame.

    Attributes
    ----------
    voxel_m : float
        The wood is thinned to voxels of this size.
    max_stem_points : int
        Larger voxels are taken until at most so many points are left.
    level_m : float
        Thickness of a level set at least.
    gap_m : float
        Longest gap that is bridged: a calibration ring, an occluded piece of the stem.
    stem_gap_m : float
        Longest gap between large pieces, such as a stem's foot and its crown.
    min_points : int
        Thinned points that a stem must have, else the network's labels stay.
    min_arc_deg : float
        Median part of the circumference that the lower stem must show.
    max_scatter : float
        Median spread of the lower stem's surface at most, as a share of its radius; a sliver of
        bark seen from one side scatters more about its own middle.
    min_branch_m : float
        Shorter side axes make no fork.
    """

    voxel_m: float = 0.006
    max_stem_points: int = 120_000
    level_m: float = 0.015
    gap_m: float = GAP_M
    stem_gap_m: float = STEM_GAP_M
    min_points: int = 60
    min_arc_deg: float = 75.0
    max_scatter: float = 0.4
    min_branch_m: float = 0.05


@dataclass
class StemAxis:
    """A traced stem, and the wood that hangs on it.

    Attributes
    ----------
    points : ndarray of shape (n, 3), float64
        Axis from the foot to where the trunk ends, about one node a level.
    radius : ndarray of shape (n,), float64
    residual : ndarray of shape (n,), float64
        Robust spread of the surface about the radius.
    ends_at_fork : bool
        The trunk ends at a fork, else it goes on to the tip.
    branches : Skeleton
        The quick skeleton of the whole tree.
    is_branch : ndarray of shape (len(branches),), bool
        Nodes of it that are not on the trunk.
    rows : ndarray of int64
        Rows of the traced cloud's thinned points that hang on this stem.
    is_sound : bool
        Whether the geometry can be trusted.
    """

    points: np.ndarray
    radius: np.ndarray
    residual: np.ndarray
    ends_at_fork: bool
    branches: Skeleton
    is_branch: np.ndarray
    rows: np.ndarray
    is_sound: bool


def trace_stems(wood, ground, model=None):
    """Trace every stem that stands in a cloud.

    Parameters
    ----------
    wood : ndarray of shape (n_points, 3), float64
        Wood of all trees in the tree's frame, z up.
    ground : ndarray of shape (n_ground, 3)
        May be empty.
    model : StemModel, optional

    Returns
    -------
    stems : list of StemAxis
        Empty where nothing looks like a stem.
    thin : ndarray of shape (n_thin, 3), float64
        The thinned wood.
    """
    model = model or StemModel()
    if len(wood) < model.min_points:
        return [], np.empty((0, 3))
    thin, _, _, _ = thin_to_limit(wood, model.voxel_m, model.max_stem_points)
    if len(thin) < model.min_points:
        return [], thin
    trees = quick_skeletons(
        thin,
        ground,
        gap_m=model.gap_m,
        stem_gap_m=model.stem_gap_m,
        level_m=model.level_m,
        min_points=model.min_points,
    )
    stems = [_trace(tree, thin[tree.rows], model) for tree in trees]
    return stems, thin


def _trace(tree, surface, model):
    """The stem of one tree from its quick skeleton."""
    skeleton, level = tree.skeleton, tree.level
    widest = 3.0 * float(np.quantile(skeleton.radius, 0.98)) + level
    fitted = fit_axis_radii(skeleton, surface, spacing=level, max_radius=widest)
    nodes = _main_axis(fitted)
    stem = _refit(fitted, nodes, surface, level)
    end = _trunk_end(fitted, nodes, stem, model)
    on_trunk = np.zeros(len(skeleton), dtype=bool)
    on_trunk[nodes[: end + 1]] = True
    arc = stem.fields["arc_deg"]
    lower = slice(0, max(3, min(end + 1, len(nodes) // 2)))
    residual = np.nan_to_num(stem.fields["residual"])
    is_sound = (
        len(nodes) >= FEWEST_NODES
        and np.median(arc[lower]) >= model.min_arc_deg
        and np.median(residual[lower] / stem.radius[lower]) <= model.max_scatter
    )
    return StemAxis(
        stem.points[: end + 1],
        stem.radius[: end + 1],
        residual[: end + 1],
        end + 1 < len(nodes),
        fitted,
        ~on_trunk,
        tree.rows,
        bool(is_sound),
    )


def _main_axis(skeleton):
    """Nodes of the axis that goes on into the thickest child at every fork, from foot to tip.

    As in `cherrypicker.skeleton.axes`, but for the bumps and shreds of a quick skeleton: a child
    that ends soon is no heir, however thick.
    """
    length, children = skeleton.edge_length, skeleton.children()
    ahead = skeleton.reach() + length
    nodes = [0]
    while len(children[nodes[-1]]):
        node = nodes[-1]
        candidates = children[node]
        candidates = candidates[ahead[candidates] >= SHORT * ahead[candidates].max()]
        if len(candidates) > 1:
            diameter = 2 * float(np.median(skeleton.radius[nodes[-5:]]))
            ways = [_way_up(skeleton, children, ahead, child, 2 * diameter) for child in candidates]
            thick = np.array([_median_radius(skeleton, way, 0.5 * diameter) for way in ways])
            similar = thick >= SIMILAR_RADIUS * thick.max()
            before = skeleton.points[node] - skeleton.points[nodes[max(0, len(nodes) - 6)]]
            after = np.array([skeleton.points[way[-1]] for way in ways]) - skeleton.points[node]
            norm = np.linalg.norm(before) * np.linalg.norm(after, axis=1)
            score = ahead[candidates] * (1.2 + after @ before / np.maximum(norm, 1e-12))
            candidates = candidates[[int(np.argmax(np.where(similar, score, -1.0)))]]
        nodes.append(int(candidates[0]))
    return np.array(nodes)


def _way_up(skeleton, children, ahead, node, reach):
    """Nodes from `node` on along the longest way, up to `reach` far."""
    way, travelled = [node], 0.0
    while len(children[way[-1]]) and travelled < reach:
        following = children[way[-1]]
        way.append(int(following[np.argmax(ahead[following])]))
        travelled += float(np.linalg.norm(skeleton.points[way[-1]] - skeleton.points[way[-2]]))
    return way


def _median_radius(skeleton, way, skip):
    """Median radius along a way, without its first `skip`."""
    points = skeleton.points[way]
    travelled = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    radius = skeleton.radius[way]
    beyond = travelled >= skip
    return float(np.median(radius[beyond])) if beyond.any() else float(radius[-1])


def _refit(fitted, nodes, surface, level):
    """The stem alone, its centres and radii fitted to all wood around it, forks or not.

    The quick skeleton shares the wood at a fork out among its axes; the stem's circles need all
    of its own.
    """
    points, radius = _smooth(fitted.points[nodes], 2), _median(fitted.radius[nodes], 3)
    for _ in range(2):
        n_nodes = len(points)
        chain = Skeleton(points, np.arange(n_nodes) - 1, radius, np.ones(n_nodes, dtype=np.int64))
        distance, nearest = cKDTree(points).query(surface, workers=1)
        near = surface[distance <= 1.5 * radius[nearest] + 0.6 * level]
        refit = fit_axis_radii(chain, near, spacing=level, max_radius=2.5 * radius.max() + level)
        points, radius = _smooth(refit.points, 2), _median(refit.radius, 2)
    refit.points, refit.radius = points, radius
    return refit


def _smooth(points, half):
    """Running median, then mean, of `half` nodes each way; the ends stay within the curve."""
    index = np.clip(np.arange(len(points))[:, None] + np.arange(-half, half + 1), 0, None)
    index = np.minimum(index, len(points) - 1)
    middle = np.median(points[index], axis=1)
    smooth = middle[index].mean(axis=1)
    smooth[0], smooth[-1] = points[0], points[-1]
    return smooth


def _median(values, half):
    index = np.clip(np.arange(len(values))[:, None] + np.arange(-half, half + 1), 0, None)
    return np.median(values[np.minimum(index, len(values) - 1)], axis=1)


def _trunk_end(skeleton, nodes, stem, model):
    """Position in `nodes` of the fork where the trunk ends, else of the tip.

    The radii of both sides of a fork are medians over one diameter around the place one diameter
    away. A fork ends the trunk only where the noise cannot explain the loss.
    """
    position = np.concatenate([[0.0], np.cumsum(stem.edge_length[1:])])
    seen = (stem.fields["arc_deg"] >= model.min_arc_deg) & (stem.fields["n_points"] >= FEWEST_SEEN)
    forks = sorted(_forks(skeleton, nodes, stem, position, model))
    for place, parting in forks:
        diameter = 2 * _radius_below(stem.radius, position, place)
        below = np.flatnonzero(seen & (position <= place - 0.5 * diameter))
        above = np.flatnonzero(seen & (position >= max(place + 0.5 * diameter, parting)))
        below = below[position[below] >= position[below[-1:]] - diameter]
        above = above[position[above] <= position[above[:1]] + diameter]
        if len(below) < 2 or len(above) < 2:  # nothing to compare with
            continue
        if position[above[0]] > max(place + 2.5 * diameter, parting + diameter):
            continue  # a gap: the stem tapers over it
        kept = np.median(stem.radius[above]) + ROUGH_M
        if kept < TRUNK_KEEPS * np.median(stem.radius[below]):
            # The arms of one fork are each followed back only roughly: their middle counts.
            together = [at for at, _ in forks if abs(at - place) <= diameter]
            return int(np.argmin(np.abs(position - np.median(together))))
    return len(nodes) - 1


def _radius_below(radius, position, place):
    """Radius of the stem just below a place, clear of the swelling there."""
    rough = float(np.interp(place, position, radius))
    near = (position <= place - rough) & (position >= place - 5 * rough)
    return float(np.median(radius[near])) if near.any() else rough


def _forks(skeleton, nodes, stem, position, model):
    """Where side axes leave the stem, and where their wood parts from it: arc lengths in pairs.

    Level sets part only where the surfaces do, well above the fork of the axes, so the side axis
    is followed straight back to the stem.
    """
    on_stem = np.zeros(len(skeleton), dtype=bool)
    on_stem[nodes] = True
    children = skeleton.children()
    ahead = skeleton.reach() + skeleton.edge_length
    asides = np.flatnonzero(~on_stem & on_stem[skeleton.parent] & (np.arange(len(on_stem)) > 0))
    forks = []
    for aside in asides:
        parting = position[np.searchsorted(nodes, skeleton.parent[aside])]
        radius = _radius_below(stem.radius, position, parting)
        if ahead[aside] < max(model.min_branch_m, 2 * radius):
            continue
        way = skeleton.points[_way_up(skeleton, children, ahead, aside, 5 * radius)]
        middle = way.mean(axis=0)
        heading = np.linalg.svd(way - middle, full_matrices=False)[2][0]
        near = np.flatnonzero((position <= parting) & (position >= parting - 6 * radius))
        offset = stem.points[near] - middle
        off_line = np.linalg.norm(offset - np.outer(offset @ heading, heading), axis=1)
        forks.append((float(position[near[np.argmin(off_line)]]), float(parting)))
    return forks
