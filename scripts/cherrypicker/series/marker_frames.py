"""What markers that stayed say of the frame of a later scan: a start for `frame.find_frame`."""

from __future__ import annotations

import numpy as np

from cherrypicker.geometry.similarity import fit_rigid, moved


def marker_corners(scale: dict, align: dict) -> dict[tuple, np.ndarray]:
    """Corners of a scan's markers in the metric frame, by its ``scale.json`` and ``align.json``.

    Returns
    -------
    dict of tuple to ndarray of shape (4, 3)
        By dictionary and id; only markers that the scan's scale rests on and that stand in one
        place.
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
