"""Which wood of two dates is the same, and so which axes.

The earlier wood is bent onto the later first: a limb sinks, rises or is tied, and its twigs go
along, so that children are looked for where their parents went. Every sample of the earlier wood
moves by an offset that changes little from one sample to the next along the wood. Offsets follow
the nearest later wood, in rounds: look up, weigh by a Gaussian of the distance, solve, with a
Gaussian that narrows down to the noise of both scans (as the coherent point drift of Myronenko and
Song 2010, whose motion is coherent in space; here it is along the wood).

Wood is then matched sample by sample. Two samples are the same wood where they lie within a
tolerance, which follows from how far matched wood lies apart: the noise of both scans together.
Axes are matched last, one to one, so that as much length as possible is the same.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import diags
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from cherrypicker.geometry.neighbors import sparse_graph
from cherrypicker.series.wood import PIECE_M, STEP_M, Wood

BEND_M = 0.04  # by which offsets differ over a metre of wood, standard deviation (guess)
WIDTHS_M = (0.06, 0.05, 0.04, 0.03, 0.025, 0.02, 0.015, 0.015)
NOISE_REACH_M = 0.045  # wood farther apart than this says nothing of the noise (of `WIDTHS_M`)
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
    bent = _bend_onto(earlier, later)
    apart, to_later = cKDTree(later.points).query(bent)
    near = apart[apart < NOISE_REACH_M]
    # between samples nothing is told
    tolerance = max(TAIL * float(np.median(near)) if len(near) else 0.0, STEP_M)
    apart_back, to_earlier = cKDTree(bent).query(later.points)
    to_later[apart > tolerance] = -1
    to_earlier[apart_back > tolerance] = -1
    # By the length of wood that axes share
    shared = np.zeros((earlier.axis.max() + 1, later.axis.max() + 1))
    here, there = to_later >= 0, to_earlier >= 0
    ahead = earlier.axis[here], later.axis[to_later[here]]
    back = earlier.axis[to_earlier[there]], later.axis[there]
    np.add.at(shared, ahead, 0.5 * earlier.length[here])
    np.add.at(shared, back, 0.5 * later.length[there])
    pairs = np.transpose(linear_sum_assignment(-shared)).tolist()
    matched = {before: after for before, after in pairs if shared[before, after] > 0}
    return Match(tolerance, bent, to_later, to_earlier, matched)


def _bend_onto(earlier: Wood, later: Wood) -> np.ndarray:
    """Places of the earlier wood's samples, (n, 3) float64, where it is bent onto the later."""
    n = len(earlier)
    stiff = 1.0 / (BEND_M**2 * np.maximum(earlier.length[1:], 1e-4))
    links = sparse_graph(n, np.column_stack([np.arange(1, n), earlier.parent[1:]]), stiff).tocsc()
    laplacian = diags(np.asarray(links.sum(axis=1)).ravel()) - links
    tree = cKDTree(later.points)
    offset = np.zeros((n, 3))
    for width in WIDTHS_M:
        distance, row = tree.query(earlier.points + offset)
        near = np.exp(-0.5 * (distance / width) ** 2)
        weight = near * earlier.length / PIECE_M / width**2
        wanted = later.points[row] - earlier.points
        system = (laplacian + diags(weight + 1e-9)).tocsc()
        offset = splu(system).solve(weight[:, None] * wanted)
    return earlier.points + offset
