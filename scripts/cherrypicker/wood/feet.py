"""Stem bases: where the trees of a cloud stand."""

import logging
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label as label_cells
from scipy.spatial import cKDTree

from cherrypicker.classes import Label
from cherrypicker.geometry.ground_surface import ground_height
from cherrypicker.wood.thinned import FEWEST_OF_PIECE

logger = logging.getLogger(__name__)

# Shares of the height of the wood: they hold for a potted plant and for a forest tree alike.
# They matter little: each halved and doubled, eight laser scans, a tree of the set and two
# rows of five trees (seeds 13 and 16) keep their wood to 0.13 % and 0.0002 of the IoU.
SLICE_LOW, SLICE_HIGH = 0.02, 0.18  # where stems are looked for; the lower end moves a foot by cm
CELL = 0.02  # wood nearer than this, seen from above, is one stem's
REACHES_DOWN_TO = 0.07
LEAST_EXTENT = 0.5  # of the slice
SAME_STEM = 0.10  # stems nearer than this rise from one root
# Guesses that none of those clouds asks; test_target.py, test_target_wood.py and
# test_contraction_on_axes.py have a tree for each.
MOSTLY_TRUNK, HARDLY_TRUNK = 0.5, 0.1
BURIED, MOST_BURIED = 0.05, 0.1  # so far below the ground (of the height), more than that share
LARGE = 0.1  # share of all wood from which a piece is large
FOOT_SHARE = 0.35  # a stem whose foot is hidden starts in this share of the height


@dataclass
class Stem:
    """A stem base."""

    base: np.ndarray  # (3,) float64: centre of the lowest part of the stem
    rows: np.ndarray  # int64: rows of the points of the stem within the slice that it was found in


def find_stems(points: np.ndarray, ground: np.ndarray, labels: np.ndarray) -> list[Stem]:
    """Find the stems that stand in a cloud of wood, most points first; none where nothing looks so.

    A stem is a compact cluster, seen from above, of the wood in a slice low above the ground,
    that reaches down to the ground and fills at least half of the slice's height.

    Points (n_points, 3) are wood, `ground` (n_ground, 3) where that is known; z up. Where some
    cluster is mostly trunk by its labels (n_points,), those that are hardly trunk are no stems: a
    low branch may hang down to the ground.
    """
    lowest = points[:, 2].min()
    height = points[:, 2] - ground_height(points[:, :2], ground, lowest)
    buried = np.mean(height < -BURIED * np.ptp(points[:, 2]))
    if buried > MOST_BURIED:  # without ground some low branches may be called so, above the foot
        logger.warning(
            "%.0f %% of the wood lie below what is labelled ground: it is not used", 100 * buried
        )
        height = points[:, 2] - lowest
    full = float(np.quantile(height, 0.995))
    if full <= 0:
        return []
    rows = np.flatnonzero((height > SLICE_LOW * full) & (height < SLICE_HIGH * full))
    if len(rows) < FEWEST_OF_PIECE:
        return []
    cells = np.floor((points[rows, :2] - points[rows, :2].min(axis=0)) / (CELL * full))
    cells = tuple(cells.astype(np.int64).T)
    grid = np.zeros([column.max() + 1 for column in cells], dtype=bool)
    grid[cells] = True
    clusters, n_clusters = label_cells(grid, structure=np.ones((3, 3)))
    found = []
    for index in range(n_clusters):
        own = rows[clusters[cells] == index + 1]
        low, high = np.quantile(height[own], [0.02, 0.98])
        tall = high - low >= LEAST_EXTENT * (SLICE_HIGH - SLICE_LOW) * full
        if len(own) >= FEWEST_OF_PIECE and tall and low <= REACHES_DOWN_TO * full:
            foot = own[height[own] <= low + 0.03 * full]
            found.append(Stem(_upright(points[foot], points[own], CELL * full), own))
    found.sort(key=lambda stem: -len(stem.rows))
    share = [np.mean(labels[stem.rows] == Label.TRUNK) for stem in found]
    if max(share, default=0.0) >= MOSTLY_TRUNK:
        found = [stem for stem, part in zip(found, share) if part >= HARDLY_TRUNK]
    merged: list[Stem] = []
    for stem in found:
        for other in merged:
            if np.linalg.norm(stem.base[:2] - other.base[:2]) < SAME_STEM * full:
                other.rows = np.sort(np.concatenate([other.rows, stem.rows]))
                break
        else:
            merged.append(stem)
    return merged


def _upright(foot: np.ndarray, points: np.ndarray, reach: float) -> np.ndarray:
    """Middle of the foot's points (n, 3), (3,), of those around which most others stand over them.

    Low branches lie beside a stem; where they are many, the middle of all is theirs.
    """
    around = cKDTree(points[:, :2]).query_ball_point(foot[:, :2], reach, return_length=True)
    most = 2 * around >= around.max()
    upright, middle = np.median(foot[most, :2], axis=0), np.median(foot, axis=0)
    if np.linalg.norm(middle[:2] - upright) <= reach:  # it is on the stem
        return middle
    off = np.linalg.norm(foot[:, :2] - upright, axis=1)
    return np.median(foot[off <= max(2 * reach, off[most].max())], axis=0)


def stems_off_the_ground(points: np.ndarray, piece: np.ndarray, owner: np.ndarray) -> list[Stem]:
    """Bases of large pieces that no way reaches: trees whose foot is hidden or cut off.

    Of wood points (n_points, 3), z up, `piece` (n_points,) tells which hang together, `owner`
    (n_points,) the stem whose way reaches each, or -1.
    """
    size = np.bincount(piece)
    low, height = points[:, 2].min(), np.ptp(points[:, 2])
    found = []
    for index in np.flatnonzero(size >= LARGE * len(points)):
        rows = np.flatnonzero(piece == index)
        if (owner[rows] >= 0).any() or points[rows, 2].min() > low + FOOT_SHARE * height:
            continue
        z = points[rows, 2]
        foot = rows[z <= np.quantile(z, 0.02)]
        found.append(Stem(np.median(points[foot], axis=0), foot))
    return found
