"""The scans of one series beside one another: one frame, lasting ids of branches, and what changed.

Each scan is compared with the one before it; all are brought into the frame of the first.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.errors import StageError
from cherrypicker.geometry.similarity import moved
from cherrypicker.series.changes import Gone, find_gone, find_new, reach_back, seen_by
from cherrypicker.series.frame import FrameFit, find_frame, marker_starts, moved_by
from cherrypicker.series.match import Match, match_wood
from cherrypicker.series.wood import Wood

logger = logging.getLogger(__name__)

# Of a frame's score, counted once more by how far it is above the runner-up's: the same tree has
# 1.2 and more, after pruning and a year too, another one at most 0.43 (generated trees)
LEAST_FIT = 0.75
# Of the score, from which another frame fits nearly as well, and by how much the later wood may
# seem stretched: at most 0.61 and 0.019 in 32 pairs of generated trees at their right scale
DOUBTED_RUNNER_UP = 0.8
ODD_SCALE = 0.02
_WHY = "is it another tree, or wrong scale or up axis?"


@dataclass
class Scan:
    """A scan of the series."""

    # tree, date: its row in the table of trees
    tree: str
    date: str
    wood: Wood  # its skeleton in its own frame, metres; in that of the first scan once compared
    branches: list[dict]  # rows of its ``branches.csv``, by axis
    cloud: np.ndarray  # (n, 3) float64: its points of wood, as `wood`
    # See `frame.marker_corners`
    markers: dict[tuple, np.ndarray] = field(default_factory=dict)
    scale_error: float = 0.0  # relative standard error of its scale

    def moved(self, frame: np.ndarray) -> Scan:
        """The same scan in another frame; `frame` has shape (4, 4)."""
        markers = {name: moved(corners, frame) for name, corners in self.markers.items()}
        wood, cloud = self.wood.moved(frame), moved(self.cloud, frame)
        return replace(self, wood=wood, cloud=cloud, markers=markers)


@dataclass
class Step:
    """What happened from one scan to the next, both in the frame of the series."""

    earlier: Scan
    later: Scan
    fit: FrameFit  # of the later scan's own frame
    match: Match
    is_there: np.ndarray  # (n_earlier,) bool: where the later scan has wood too
    was_there: np.ndarray  # (n_later,) bool: where the earlier scan has wood too
    # Pieces of the earlier wood that were removed, and of the later that have grown
    gone: Gone
    new: Gone
    moved_markers: dict[str, float]  # how far markers lie from where they were, metres

    @property
    def is_unseen(self) -> np.ndarray:
        """Earlier wood that the later scan lacks, but that was hardly cut, (n_earlier,) bool."""
        return ~self.is_there & (self.gone.piece < 0)

    @property
    def scale_ratio(self) -> float:
        """By how much the later tree would have to be stretched for its forks to fit best.

        Forks are places; along an axis wood fits at any scale. Each is as far from the middle of
        all as at the other date; the median of the ratios is taken.
        """
        pairs = np.array(list(self.match.axes.items()))
        before = self.earlier.wood.feet[pairs[:, 0]]
        after = self.later.wood.feet[pairs[:, 1]]
        far = np.linalg.norm(before - np.median(before, axis=0), axis=1)
        far_after = np.linalg.norm(after - np.median(after, axis=0), axis=1)
        return float(np.median(np.maximum(far, 1e-9) / np.maximum(far_after, 1e-9)))

    @property
    def warnings(self) -> list[str]:
        """What is to be doubted."""
        fit, found = self.fit, []
        if fit.runner_up > DOUBTED_RUNNER_UP * fit.score:
            found.append("frame_unsure: another turn of the tree fits nearly as well")
        ratio = self.scale_ratio
        if abs(ratio - 1.0) > ODD_SCALE:
            found.append(
                f"scale_differs: the later wood fits best when stretched by {ratio:.3f};"
                " is one of the scans' scales wrong?"
            )
        return found


@dataclass
class Comparison:
    """A series."""

    scans: list[Scan]  # by date, in the frame of the first, without those that were left out
    steps: list[Step]  # one less
    # Per scan the lasting id of each axis, (n_axes,) int64: the first scan's own numbers, then new
    ids: list[np.ndarray]
    left_out: dict[str, str]  # trees that could not be compared, and why


def compare_scans(scans: list[Scan]) -> Comparison:
    """Compare the scans of a series, at least two.

    A `StageError` where no two of them are scans of one tree.
    """
    ordered = sorted(scans, key=lambda scan: scan.date)
    left_out, reasons = dict[str, str](), list[str]()
    for first in range(len(ordered) - 1):  # a first scan of another tree does not sink the rest
        found = _compare_from(ordered[first:])
        if found.steps:
            return replace(found, left_out=left_out | found.left_out)
        left_out[ordered[first].tree] = f"its wood fits that of no later scan: {_WHY}"
        reasons += found.left_out.values()
    raise StageError(
        "no two scans of the series fit one another: " + "; ".join(reasons),
        key="series in trees.tsv",
    )


def _compare_from(ordered: list[Scan]) -> Comparison:
    """Compare scans in the order of their dates, each with the last that fits the first."""
    kept, steps, left_out = ordered[:1], list[Step](), {}
    ids = [np.arange(kept[0].wood.axis.max() + 1)]
    next_id = len(ids[0])
    for scan in ordered[1:]:
        fit = find_frame(kept[-1].wood, scan.wood, marker_starts(kept[-1].markers, scan.markers))
        if 2 * fit.score - fit.runner_up < LEAST_FIT:
            left_out[scan.tree] = (
                f"its wood does not fit that of {kept[-1].tree} ({100 * fit.score:.0f} % of it): "
                f"{_WHY}"
            )
            logger.warning("%s is left out: %s", scan.tree, left_out[scan.tree])
            continue
        step = compare_two(kept[-1], scan.moved(fit.matrix), fit)
        lasting = np.full(scan.wood.axis.max() + 1, -1)
        for before, after in step.match.axes.items():
            lasting[after] = ids[-1][before]
        fresh = np.flatnonzero(lasting < 0)
        lasting[fresh] = next_id + np.arange(len(fresh))
        next_id += len(fresh)
        steps.append(step)
        kept.append(step.later)
        ids.append(lasting)
    return Comparison(kept, steps, ids, left_out)


def compare_two(earlier: Scan, later: Scan, fit: FrameFit) -> Step:
    """Compare two scans in one frame."""
    wood, other = earlier.wood, later.wood
    match = match_wood(wood, other)
    reach = match.tolerance
    is_there = (match.to_later >= 0) | seen_by(wood, match.bent, later.cloud, reach)
    # Where later wood would have been at the earlier date: as far off as the wood next to it
    _, nearest = cKDTree(match.bent).query(other.points)
    before = other.points + (wood.points - match.bent)[nearest]
    was_there = (match.to_earlier >= 0) | seen_by(other, before, earlier.cloud, reach)
    gone = reach_back(wood, find_gone(wood, is_there), match.bent, later.cloud, reach)
    new = reach_back(other, find_new(other, was_there, reach), before, earlier.cloud, reach)
    off = moved_by(earlier.markers, later.markers)
    return Step(earlier, later, fit, match, is_there, was_there, gone, new, off)
