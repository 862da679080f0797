"""Where a later scan stands in the frame of an earlier one: a turn and a shift of the whole tree.

A scan's frame has z up and its stem somewhere, so all turns about the vertical through the foot are
tried, at some heights, and what the markers say where they are seen at both dates. The wood
decides: starts are refined by ICP (Besl and McKay 1992) on the skeletons' samples. Wood weighs by
its radius, since thick wood neither bends nor grows much, and by a Gaussian of its distance, which
narrows: what has no counterpart counts for nothing (the weights of Chetverikov's trimmed ICP, 2002,
made soft).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from cherrypicker.geometry.similarity import fit_rigid, moved
from cherrypicker.series.wood import Wood

N_TURNS = 72  # about the vertical that are tried
# By which feet are found too high or too low, one against the other (10 cm was seen)
HEIGHTS_M = np.arange(-0.20, 0.21, 0.05)
N_REFINED = 6  # best of these that are refined
WIDTHS_M = (0.08, 0.05, 0.03, 0.03, 0.02, 0.02, 0.02, 0.02)  # while they are refined
N_SAMPLES = 2000  # of the wood that are looked up, the thickest stretches first


@dataclass(frozen=True)
class FrameFit:
    """A frame and how sure it is."""

    matrix: np.ndarray  # (4, 4) float64: brings points of the later scan into the earlier's frame
    # Share of the earlier wood, by its surface, that has wood of the later one near it; the same
    # for the best frame that is another one
    score: float
    runner_up: float
    source: str  # ``wood`` or ``markers``: the start that led there


def find_frame(earlier: Wood, later: Wood, by_markers: Sequence[np.ndarray] = ()) -> FrameFit:
    """Find the frame of a later scan of the same tree, both in metres and z up.

    `by_markers` are frames that markers say, (4, 4) each, of `marker_starts`.
    """
    search = _Search(earlier, later)
    starts, scores = [], []
    onto = earlier.points[0] + HEIGHTS_M[:, None] * [0.0, 0.0, 1.0]
    for turn in 2 * np.pi * np.arange(N_TURNS) / N_TURNS:
        tried = np.tile(np.eye(4), (len(onto), 1, 1))  # turns that bring foot onto foot
        tried[:, :3, :3] = Rotation.from_rotvec([0.0, 0.0, turn]).as_matrix()
        tried[:, :3, 3] = onto - tried[0, :3, :3] @ later.points[0]
        reached = [search.score(start, WIDTHS_M[0]) for start in tried]
        starts.append(tried[int(np.argmax(reached))])
        scores.append(max(reached))
    order = np.argsort(-np.array(scores), kind="stable")[:N_REFINED]
    best = [("markers", start) for start in by_markers] + [("wood", starts[row]) for row in order]
    refined = [(source, search.refined(start)) for source, start in best]
    found = [search.score(matrix, WIDTHS_M[-1]) for _, matrix in refined]
    top = int(np.argmax(found))
    source, matrix = refined[top]
    others = [
        score
        for score, (_, other) in zip(found, refined, strict=True)
        if Rotation.from_matrix(matrix[:3, :3].T @ other[:3, :3]).magnitude() > 2 * np.pi / N_TURNS
    ]
    return FrameFit(matrix, found[top], max(others, default=0.0), source)


class _Search:
    """Samples of both dates, and a look-up of the later one's."""

    def __init__(self, earlier: Wood, later: Wood) -> None:
        weight = earlier.radius * earlier.length
        rows = np.sort(np.argsort(-weight, kind="stable")[:N_SAMPLES])
        self.points, self.weight = earlier.points[rows], weight[rows] / weight[rows].sum()
        self.later = later.points
        self.tree = cKDTree(later.points)

    def nearest(self, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance of each sample to the later wood under a frame, and that wood's own place."""
        back = (self.points - matrix[:3, 3]) @ matrix[:3, :3]
        distance, row = self.tree.query(back)
        return distance, self.later[row]

    def score(self, matrix: np.ndarray, width: float) -> float:
        distance, _ = self.nearest(matrix)
        return float(self.weight @ np.exp(-0.5 * (distance / width) ** 2))

    def refined(self, matrix: np.ndarray) -> np.ndarray:
        for width in WIDTHS_M:
            distance, place = self.nearest(matrix)
            weight = self.weight * np.exp(-0.5 * (distance / width) ** 2)
            matrix = fit_rigid(place, self.points, weight)
        return matrix


def marker_corners(scale: dict, align: dict) -> dict[tuple, np.ndarray]:
    """Corners of a scan's markers in the metric frame, by its ``scale.json`` and ``align.json``.

    They are (4, 3) each, by dictionary and id; only of markers that the scan's scale rests on and
    that stand in one place.
    """
    to_aligned = np.array(align["transform"])
    return {
        (marker.get("dictionary", scale.get("dictionary", "")), marker["id"]): scale["scale"]
        * moved(np.asarray(marker["corners"]), to_aligned)
        for marker in scale.get("markers", ())
        if marker.get("used") and marker.get("corners") and marker.get("n_places", 1) == 1
    }


def marker_starts(earlier: dict, later: dict) -> list[np.ndarray]:
    """A frame by each marker that both scans have: those that were moved are a start like another.

    Each, (4, 4), brings the later scan's frame into the earlier one's.
    """
    return [
        fit_rigid(later[name], earlier[name], np.ones(4)) for name in sorted(earlier.keys() & later)
    ]


def moved_by(earlier: dict, later: dict) -> dict[str, float]:
    """How far each common marker lies from where it was, metres, by its id; both in one frame."""
    off = {
        name: (later[name] - earlier[name]).mean(axis=0) for name in sorted(earlier.keys() & later)
    }
    return {f"{kind} {id_}".strip(): float(np.linalg.norm(by)) for (kind, id_), by in off.items()}
