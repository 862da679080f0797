"""Score a cloud on disk: place it in the scene's frame, score it, put the scores into words."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.pointcloud import read_cloud
from cherrypicker.poses import read_poses
from cherrypicker_lab.dense.surface import CLASSES, refine_similarity, score_cloud
from cherrypicker_lab.dense.truth import TrueSurface, load_true_surface
from cherrypicker_lab.evaluation import camera_similarity, pair_cameras

FITS = ("none", "cameras", "surface")


def score_file(
    cloud: str | os.PathLike,
    poses: str | os.PathLike,
    truth: str | os.PathLike,
    *,
    fit: str,
) -> dict:
    """Score a PLY against ``{scene}/truth``.

    Parameters
    ----------
    cloud : path-like
    poses : path-like
        Poses NPZ of the cloud's frame; not read for ``fit="none"``.
    truth : path-like
    fit : {"none", "cameras", "surface"}
        How the cloud is placed, see :mod:`cherrypicker_lab.dense.surface`.

    Returns
    -------
    dict
        As :func:`cherrypicker_lab.dense.surface.score_cloud`, with ``fit`` and the
        similarity's ``scale``, ``rotation`` and ``translation``.

    Raises
    ------
    StageError
        If a file is missing or broken, or the cloud is nowhere near the tree.
    """
    surface = load_true_surface(truth)
    points = read_cloud(cloud).points
    placed, similarity = place(points, poses, truth, surface, fit)
    placement = dict(zip(("scale", "rotation", "translation"), similarity, strict=True))
    return score_cloud(placed, surface) | {"fit": fit} | placement


def place(points, poses, truth, surface: TrueSurface, fit: str):
    """Move points into the scene's frame; returns them and (scale, rotation, translation)."""
    if fit not in FITS:
        raise StageError(f"unknown fit {fit!r}, one of {', '.join(FITS)}")
    if fit == "none":
        return points, (1.0, np.eye(3), np.zeros(3))
    pairs = pair_cameras(read_poses(poses), read_poses(Path(truth) / "poses.npz"))
    scale, rotation, translation, _ = camera_similarity(*pairs)
    placed = scale * points @ rotation.T + translation
    if fit == "surface":
        s, r, t = refine_similarity(placed, surface)
        placed = s * placed @ r.T + t
        scale, rotation, translation = s * scale, r @ rotation, s * r @ translation + t
    return placed, (scale, rotation, translation)


def describe(report: dict) -> str:
    """Return the scores as a small table of text."""
    lines = [
        f"{report['n_judged']:,} of {report['n_points']:,} points judged, "
        f"{100 * report['visible_share']:.1f} % of the surface seen by three photos, "
        f"median error {1000 * report['median_error_m']:.2f} mm",
        f"{'':18s}" + "".join(f"{f'{t}: P     R     F1':26s}" for t in ("5mm", "10mm", "20mm")),
    ]
    for name in ("all", "thinned", "wood_30mm", *CLASSES):
        cells = []
        for rates in report[name].values():
            values = [rates[k] for k in ("accuracy", "completeness", "f1")]
            cells.append(" ".join("  -  " if v is None else f"{v:.3f}" for v in values))
        lines.append(f"{name:18s}" + "".join(f"    {cell:22s}" for cell in cells))
    all10 = report["all"]["10mm"]["completeness_all"]
    lines.append(f"completeness at 10 mm over all surface, seen or not: {all10:.3f}")
    return "\n".join(lines)
