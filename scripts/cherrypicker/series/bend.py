"""The earlier wood bent onto the later: a limb sinks, rises or is tied, and its twigs go along.

Every sample of the earlier wood moves by an offset that changes little from one sample to the next
along the wood. Offsets follow the later wood that runs nearby in the same direction, in rounds:
look up, weigh by a Gaussian of the distance, solve, with a Gaussian that narrows down to the noise
of both scans (as the coherent point drift of Myronenko and Song 2010, whose motion is coherent in
space; here it is along the wood).
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from cherrypicker.series.wood import PIECE_M, Wood

TURN_M = 0.06  # a right angle between two directions counts like so far away (guess)
BEND_M = 0.04  # by which offsets differ over a metre of wood, standard deviation (guess)
WIDTHS_M = (0.06, 0.05, 0.04, 0.03, 0.025, 0.02, 0.015, 0.015)


def bend_onto(earlier: Wood, later: Wood) -> np.ndarray:
    """Bend the earlier wood onto the later, both in one frame.

    Returns
    -------
    ndarray of shape (n, 3), float64
        Places of the earlier wood's samples.
    """
    n = len(earlier)
    rows = np.arange(1, n)
    stiff = 1.0 / (BEND_M**2 * np.maximum(earlier.length[1:], 1e-4))
    ends = np.concatenate([rows, earlier.parent[1:]])
    other = np.concatenate([earlier.parent[1:], rows])
    links = coo_matrix((np.tile(stiff, 2), (ends, other)), shape=(n, n)).tocsc()
    laplacian = diags(np.asarray(links.sum(axis=1)).ravel()) - links
    tree = directed_tree(later.points, later.tangent)
    offset = np.zeros((n, 3))
    for width in WIDTHS_M:
        query = np.hstack([earlier.points + offset, TURN_M * earlier.tangent])
        distance, row = tree.query(query)
        near = np.exp(-0.5 * (distance / width) ** 2)
        weight = near * earlier.length / PIECE_M / width**2
        wanted = later.points[row] - earlier.points
        system = (laplacian + diags(weight + 1e-9)).tocsc()
        offset = splu(system).solve(weight[:, None] * wanted)
    return earlier.points + offset


def directed_tree(points: np.ndarray, tangent: np.ndarray) -> cKDTree:
    """A look-up of the nearest wood that runs in the same direction, places and tangents as one."""
    return cKDTree(np.hstack([points, TURN_M * tangent]))
