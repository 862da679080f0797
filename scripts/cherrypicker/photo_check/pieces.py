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
    """Join places, points (n, 3) a step apart along wood, to pieces as long as a run or longer.

    Each stands for a length (n,), and is wood with a probability (n,). A piece has a ``length``,
    ``p_exists``, the mean over it, ``at``, the middle of its points, and ``low`` and ``high``, the
    corners of their box.
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
