"""Which wood of two dates is the same, and so which axes.

Wood is matched first, sample by sample: the earlier wood is bent onto the later
(`cherrypicker.series.bend`), so that children are looked for where their parents went. Two samples
are the same wood where they lie within a tolerance; of near ones that one counts which runs the
same way. The tolerance follows from how far matched wood lies apart, which is the noise of both
scans together. Axes are then matched one to one so that as much length as possible is the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from cherrypicker.series.bend import TURN_M, bend_onto, directed_tree
from cherrypicker.series.wood import STEP_M, Wood

NOISE_REACH_M = 0.045  # wood farther apart than this says nothing of the noise (of `bend.WIDTHS_M`)
# The tolerance in medians of the distances. These have heavy tails: 97 % of the wood that two
# scans of an unchanged tree share lies within it (measured on generated pairs, docs/lab/series.md)
TAIL = 6.0


@dataclass
class Match:
    """The wood that two dates share."""

    tolerance: float  # within which two samples are the same wood, metres
    bent: np.ndarray  # (n_earlier, 3) float64: places of the earlier samples at the later date
    to_later: np.ndarray  # (n_earlier,) int64: the later sample that each is, -1 for none
    to_earlier: np.ndarray  # (n_later,) int64: the same the other way
    axes: dict[int, int]  # earlier axis to later axis


def match_wood(earlier: Wood, later: Wood) -> Match:
    """Match the wood of two dates, both in one frame."""
    bent = bend_onto(earlier, later)
    to_later, apart = _nearest(bent, earlier.tangent, later.points, later.tangent)
    near = apart[apart < NOISE_REACH_M]
    # between samples nothing is told
    tolerance = max(TAIL * float(np.median(near)) if len(near) else 0.0, STEP_M)
    to_earlier, apart_back = _nearest(later.points, later.tangent, bent, earlier.tangent)
    to_later[apart > tolerance] = -1
    to_earlier[apart_back > tolerance] = -1
    found = _match_axes(earlier, later, to_later, to_earlier)
    return Match(tolerance, bent, to_later, to_earlier, found)


def _nearest(
    points: np.ndarray, tangent: np.ndarray, others: np.ndarray, other_tangent: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Nearest other wood that runs the same way, and how far it is."""
    _, row = directed_tree(others, other_tangent).query(np.hstack([points, TURN_M * tangent]))
    return row, np.linalg.norm(others[row] - points, axis=1)


def _match_axes(
    earlier: Wood, later: Wood, to_later: np.ndarray, to_earlier: np.ndarray
) -> dict[int, int]:
    """Match axes one to one by the length of wood that they share."""
    shape = earlier.axis.max() + 1, later.axis.max() + 1
    shared = np.zeros(shape)
    here, there = to_later >= 0, to_earlier >= 0
    ahead = earlier.axis[here], later.axis[to_later[here]]
    back = earlier.axis[to_earlier[there]], later.axis[there]
    np.add.at(shared, ahead, 0.5 * earlier.length[here])
    np.add.at(shared, back, 0.5 * later.length[there])
    pairs = np.transpose(linear_sum_assignment(-shared)).tolist()
    return {before: after for before, after in pairs if shared[before, after] > 0}
