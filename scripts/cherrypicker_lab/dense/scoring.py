"""Score a cloud on disk: place it in the scene's frame, score it, put the scores into words."""

from __future__ import annotations

import os
from pathlib import Path

from cherrypicker.pointcloud import read_cloud
from cherrypicker.poses import read_poses
from cherrypicker_lab.dense.surface import CLASSES, refine_similarity, score_cloud
from cherrypicker_lab.dense.truth import load_true_surface
from cherrypicker_lab.evaluation import camera_similarity, pair_cameras


def score_file(
    cloud: str | os.PathLike, truth: str | os.PathLike, poses: str | os.PathLike | None = None
) -> dict:
    """Score a PLY against ``{scene}/truth``.

    Parameters
    ----------
    cloud, truth : path-like
    poses : path-like, optional
        Poses NPZ of the cloud's frame, which brings the cloud to the scene's; without, it is in
        that already.

    Returns
    -------
    dict
        As :func:`cherrypicker_lab.dense.surface.score_cloud`.

    Raises
    ------
    StageError
        If a file is missing or broken, or the cloud is nowhere near the tree.
    """
    surface = load_true_surface(truth)
    points = read_cloud(cloud).points
    if poses:
        pairs = pair_cameras(read_poses(poses), read_poses(Path(truth) / "poses.npz"))
        scale, rotation, translation, _ = camera_similarity(*pairs)
        points = scale * points @ rotation.T + translation
        scale, rotation, translation = refine_similarity(points, surface)
        points = scale * points @ rotation.T + translation
    return score_cloud(points, surface)


def describe(report: dict) -> str:
    """Return the scores as a small table of text."""
    lines = [
        f"{report['n_judged']:,} of {report['n_points']:,} points judged, "
        f"{100 * report['visible_share']:.1f} % of the surface seen by three photos, "
        f"median error {1000 * report['median_error_m']:.2f} mm",
        f"{'':18s}" + "".join(f"{f'{t}: P     R     F1':26s}" for t in ("5mm", "10mm", "20mm")),
    ]
    for name in ("all", *CLASSES):
        cells = []
        for rates in report[name].values():
            values = [rates[k] for k in ("accuracy", "completeness", "f1")]
            cells.append(" ".join("  -  " if v is None else f"{v:.3f}" for v in values))
        lines.append(f"{name:18s}" + "".join(f"    {cell:22s}" for cell in cells))
    return "\n".join(lines)
