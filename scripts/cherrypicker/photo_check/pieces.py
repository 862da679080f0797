"""Single pieces of what is not there and of what is missing, the longest first."""

from __future__ import annotations

import numpy as np

from cherrypicker.geometry.neighbors import components, knn_edges

# Places this many steps apart are one piece, and how many neighbours of each are asked
JOINED_STEPS = 8.0
N_NEIGHBOURS = 8
# Pieces shorter than so many steps are not listed one by one
LEAST_STEPS = 10.0


def pieces_of(points: np.ndarray, length: np.ndarray, step: float) -> list[dict]:
    """Join places to pieces.

    Parameters
    ----------
    points : ndarray of shape (n, 3), float64
    length : ndarray of shape (n,), float64
        That each stands for.
    step : float
        How far such places lie apart along wood.

    Returns
    -------
    list of dict
        ``length`` and ``at``, the middle of the place's points, of pieces long enough to be listed.
    """
    if len(points) < 2:
        return []
    edges = knn_edges(points, N_NEIGHBOURS, JOINED_STEPS * step)
    member = components(len(points), edges)[0]
    total = np.bincount(member, length)
    order = [one for one in np.argsort(-total, kind="stable") if total[one] >= LEAST_STEPS * step]
    return [
        {
            "length": round(float(total[one]), 6),
            "at": [round(float(value), 6) for value in np.median(points[member == one], axis=0)],
        }
        for one in order
    ]
