"""How well depth maps agree with the sparse model; needs no truth and works on real photos."""

from __future__ import annotations

import os

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.mvs.workspace import View, Workspace

TOLERANCE = 0.005


def sparse_agreement(
    folder: str | os.PathLike, *, kind: str = "geometric", tolerance: float = TOLERANCE
) -> dict:
    """Compare each view's depth map with the sparse points that the view observes.

    A point agrees where the map's depth at its pixel lies within `tolerance` of the point's own,
    relatively. Points without depth in the map disagree; ``share_where_known`` leaves them out.
    Views without a map count with all their points.

    Parameters
    ----------
    folder : path-like
        Dense workspace with maps.
    kind : str
        "geometric" or "photometric".

    Returns
    -------
    dict
        ``share``, ``share_where_known``, ``n_points`` over all views, ``by_photo`` (share).

    Raises
    ------
    StageError
        If no sparse point lies in any view.
    """
    workspace = Workspace(folder)
    points = workspace.model.points3D
    hits = known = total = 0
    by_photo = {}
    for view in workspace.views:
        image = workspace.image(view)
        ids = [p.point3D_id for p in image.points2D if p.has_point3D()]
        at, expected = _in_frame(view, np.array([points[i].xyz for i in ids]).reshape(-1, 3))
        if len(expected) == 0:
            continue
        found = np.zeros(len(expected))
        if workspace.has_maps(view, kind):
            found = workspace.read_depth(view, kind)[at[:, 1], at[:, 0]]
        agrees = np.abs(found - expected) < tolerance * expected
        hits, known, total = hits + agrees.sum(), known + (found > 0).sum(), total + len(found)
        by_photo[view.name] = float(agrees.mean())
    if total == 0:
        raise StageError("no photo observes a sparse point", file=workspace.folder / "sparse")
    return {
        "share": float(hits / total),
        "share_where_known": float(hits / known) if known else 0.0,
        "n_points": int(total),
        "by_photo": by_photo,
    }


def _in_frame(view: View, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixel indices (n, 2), column and row, and depths of the points that lie in the frame."""
    in_camera = points @ view.R.T + view.t
    in_camera = in_camera[in_camera[:, 2] > 0.0]
    uv = (in_camera @ view.K.T)[:, :2] / in_camera[:, 2:]
    at = np.floor(uv).astype(int)
    inside = ((at >= 0) & (at < [view.width, view.height])).all(axis=1)
    return at[inside], in_camera[inside, 2]
