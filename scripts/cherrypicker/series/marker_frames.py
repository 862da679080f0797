"""What markers that stayed say of the frame of a later scan: a start for `frame.find_frame`."""

from __future__ import annotations

import numpy as np

from cherrypicker.geometry.similarity import fit_rigid, moved
from cherrypicker.poses import Poses


def marker_corners(scale: dict, poses: Poses, metric_poses: Poses) -> dict[tuple, np.ndarray]:
    """Corners of a scan's markers in the metric frame.

    Parameters
    ----------
    scale : dict
        ``scale.json``, whose corners are in the frame of `poses`.
    poses, metric_poses : Poses
        The same photos in that frame and in the metric one; what lies between is a turn, a shift
        and a factor.

    Returns
    -------
    dict of tuple to ndarray of shape (4, 3)
        By dictionary and id; only markers that the scan's scale rests on and that stand in one
        place.
    """
    common, one, other = np.intersect1d(poses.names, metric_poses.names, return_indices=True)
    if len(common) < 3:
        return {}
    here, there = poses.centers[one], metric_poses.centers[other]
    factor = np.std(there - there.mean(axis=0)) / np.std(here - here.mean(axis=0))
    matrix = fit_rigid(factor * here, there, np.ones(len(common)))
    return {
        (marker.get("dictionary", scale.get("dictionary", "")), marker["id"]): moved(
            factor * np.asarray(marker["corners"]), matrix
        )
        for marker in scale.get("markers", ())
        if marker.get("used") and marker.get("corners") and marker.get("n_places", 1) == 1
    }


def marker_starts(earlier: dict, later: dict) -> list[np.ndarray]:
    """A frame by each marker that both scans have: those that were moved are a start like another.

    Returns
    -------
    list of ndarray of shape (4, 4)
        Each brings the later scan's frame into the earlier one's.
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
