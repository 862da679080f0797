"""Single pieces of what is not there and of what is missing, the longest first."""

import numpy as np

from cherrypicker.evidence.existence import RUN_STEPS
from cherrypicker.files import rounded
from cherrypicker.geometry.neighbors import link_components

# Places this many steps apart are one piece
JOINED_STEPS = 8.0


def pieces_of(
    points: np.ndarray, length: np.ndarray, probability: np.ndarray, step: float
) -> list[dict]:
    """Join places to pieces.

    Parameters
    ----------
    points : ndarray of shape (n, 3), float64
    length : ndarray of shape (n,), float64
        That each stands for.
    probability : ndarray of shape (n,), float64
        That wood is there.
    step : float
        How far such places lie apart along wood.

    Returns
    -------
    list of dict
        ``length``, ``p_exists``, the mean over it, ``at``, the middle of the place's points, and
        ``low`` and ``high``, the corners of their box, of pieces as long as a run or longer.
    """
    if len(points) < 2:
        return []
    member = link_components(points, JOINED_STEPS * step)
    total = np.bincount(member, length)
    order = [one for one in np.argsort(-total, kind="stable") if total[one] >= RUN_STEPS * step]
    found = []
    for one in order:
        own = points[member == one]
        ways = {"at": np.median(own, axis=0), "low": own.min(axis=0), "high": own.max(axis=0)}
        there = np.average(probability[member == one], weights=length[member == one])
        told = {"length": rounded(total[one]), "p_exists": rounded(there)}
        found.append(told | {k: v.round(6).tolist() for k, v in ways.items()})
    return found
