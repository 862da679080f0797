"""Accuracy, completeness and F1 of a cloud against the true surface of a rendered tree.

Definitions, in metres and the scene's metric frame, after Knapitsch et al., "Tanks and Temples"
(ACM TOG 2017), section 4.

- Judged region: the tree's bounding box widened by 10 cm, above the lowest 12 cm, where tree, grass
  and ground meet.
- Accuracy (precision) at t: share of the cloud's points in the region that lie within t of the true
  surface, bark or not. Points that lie on something else (nearer to a sample of ground, board,
  marker or neighbour than to the tree, and within 30 mm of it) are neither right nor wrong.
  Everything else counts: a floater beside a branch is an error however far it is from it.
- Completeness (recall) at t: share of the true surface's area in the region that has a point of the
  cloud within t. Only surface that at least three photos see counts: in frame, turned to the camera
  by less than 80 degrees, not hidden by the tree's own wood.
- F1: harmonic mean of the two.
- Classes: each point of the cloud takes the class of its nearest true sample: trunk (the label of
  the truth), and branches by the radius of the wood.

A cloud in a frame of its own is first moved by the similarity between its camera centres and the
true ones, then by a similarity that aligns it with the surface (:func:`refine_similarity`).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from cherrypicker.errors import StageError
from cherrypicker.geometry.sampling import thin_randomly
from cherrypicker.pointcloud import read_cloud
from cherrypicker.poses import read_poses
from cherrypicker_lab.dense.truth import TrueSurface, load_true_surface
from cherrypicker_lab.evaluation import camera_similarity, pair_cameras

TOLERANCES_M = (0.005, 0.010, 0.020)
CLASSES = ("trunk", "branch_30mm", "branch_10_30mm", "branch_5_10mm", "branch_below_5mm")
RADIUS_EDGES_M = (0.005, 0.010, 0.030)
LOWEST_M = 0.12
MARGIN_M = 0.10
OTHER_REACH_M = 0.03
MIN_VIEWS = 3
_ICP_VOXEL_M = 0.0025
_ICP_POINTS = 60_000
_ICP_ITERATIONS = 30
_ICP_LIMITS_M = (0.05, 0.01)
_ICP_ADAPTIVE_M = 0.02
_ICP_LEAST_M = 0.002


def classes_of(surface: TrueSurface) -> np.ndarray:
    """Return the index into `CLASSES` of each true sample."""
    by_radius = len(CLASSES) - 1 - np.digitize(surface.radius, RADIUS_EDGES_M)
    return np.where(surface.is_trunk, 0, by_radius)


def score_cloud(points: np.ndarray, surface: TrueSurface) -> dict:
    """Score a cloud, (n, 3), m in the scene's metric frame; see the module for the definitions.

    Returns for ``all`` and every class of `CLASSES` per tolerance (``"5mm"``, ...) ``accuracy``,
    ``completeness`` and ``f1``, None where the scene has no such wood; and ``n_points``,
    ``n_judged``, ``visible_share``, ``median_error_m``. Raises a `StageError` if no point lies near
    the tree.
    """
    judged = judge_points(points, surface)
    if not judged.any():
        raise StageError(f"none of {len(points):,} points lies near the true tree")
    near = points[judged]
    gap, nearest = cKDTree(surface.points).query(near, workers=-1)
    true = surface.select(surface.points[:, 2] >= surface.points[:, 2].min() + LOWEST_M)
    reached = cKDTree(near).query(
        true.points, distance_upper_bound=2 * max(TOLERANCES_M), workers=-1
    )[0]
    seen = true.n_views >= MIN_VIEWS
    point_class, true_class = classes_of(surface)[nearest], classes_of(true)
    seen_area = true.area * seen
    report = {"all": _rates(gap, reached, seen_area)}
    for i, name in enumerate(CLASSES):
        mine, theirs = point_class == i, true_class == i
        report[name] = _rates(gap[mine], reached[theirs], seen_area[theirs])
    report["n_points"], report["n_judged"] = len(points), len(near)
    report["visible_share"] = float(seen_area.sum() / true.area.sum())
    report["median_error_m"] = float(np.median(gap))
    return report


def _rates(gap, reached, area) -> dict:
    report = {}
    for tolerance in TOLERANCES_M:
        accuracy = float((gap < tolerance).mean()) if len(gap) else None
        total = area.sum()
        completeness = float((area * (reached < tolerance)).sum() / total) if total > 0 else None
        report[f"{round(1000 * tolerance)}mm"] = {
            "accuracy": accuracy,
            "completeness": completeness,
            "f1": _f1(accuracy, completeness),
        }
    return report


def _f1(accuracy, completeness):
    if completeness is None:
        return None
    if accuracy is None or accuracy + completeness == 0:
        return 0.0
    return 2 * accuracy * completeness / (accuracy + completeness)


def judge_points(points: np.ndarray, surface: TrueSurface) -> np.ndarray:
    """Return which points (n, 3) of a cloud count for the accuracy, bool (n,)."""
    low, high = surface.points.min(axis=0) - MARGIN_M, surface.points.max(axis=0) + MARGIN_M
    low[2] = surface.points[:, 2].min() + LOWEST_M
    judged = ((points >= low) & (points <= high)).all(axis=1)
    if len(surface.others) and judged.any():
        at = np.flatnonzero(judged)
        other = cKDTree(surface.others).query(
            points[at], distance_upper_bound=OTHER_REACH_M, workers=-1
        )[0]
        near_other = np.isfinite(other)
        own = cKDTree(surface.points).query(points[at[near_other]], workers=-1)[0]
        judged[at[near_other]] = own <= other[near_other]
    return judged


def refine_similarity(points: np.ndarray, surface: TrueSurface):
    """Similarity that aligns a cloud, (n, 3), m, centimetres off its place, with the true surface.

    Trimmed ICP (Chetverikov et al. 2005) with the distance to the tangent plane: in each of 30
    rounds the points within a limit of the surface, falling from 50 to 10 mm and from 20 mm on at
    most three times the median distance, are paired with their nearest true sample, and the
    linearised seven-parameter similarity is solved. The cloud is thinned to one point a 2.5 mm
    voxel and at most 60000 points.

    Returns scale, rotation (3, 3) and translation (3,). Raises a `StageError` if fewer than 100
    points are near the surface.
    """
    cloud = points[judge_points(points, surface)]
    cells = np.floor(cloud / _ICP_VOXEL_M).astype(np.int64)
    cloud = cloud[np.sort(np.unique(cells, axis=0, return_index=True)[1])]
    cloud = thin_randomly(cloud, _ICP_POINTS)
    tree = cKDTree(surface.points)
    scale, rotation, translation = 1.0, np.eye(3), np.zeros(3)
    limits = np.geomspace(*_ICP_LIMITS_M, _ICP_ITERATIONS)
    for limit in limits:
        moved = scale * cloud @ rotation.T + translation
        gap, nearest = tree.query(moved, distance_upper_bound=limit, workers=-1)
        paired = np.isfinite(gap)
        if paired.sum() < 100:
            raise StageError(f"only {int(paired.sum())} points lie near the true surface")
        if limit < _ICP_ADAPTIVE_M:
            # floaters have more room outside the wood than inside and would shrink the cloud
            paired &= gap <= max(3.0 * float(np.median(gap[paired])), _ICP_LEAST_M)
        p, normal = moved[paired], surface.normals[nearest[paired]]
        d_scale, turn, shift = _similarity_step(p, surface.points[nearest[paired]], normal)
        scale = d_scale * scale
        rotation = turn @ rotation
        translation = d_scale * turn @ translation + shift
    return scale, rotation, translation


def _similarity_step(p, target, normal):
    """Least squares of ``normal . (s R p + t - target)``, small rotation and scale change."""
    middle = p.mean(axis=0)
    q = p - middle
    design = np.column_stack([np.cross(q, normal), normal, np.einsum("ij,ij->i", q, normal)])
    residual = np.einsum("ij,ij->i", normal, target - p)
    x = np.linalg.lstsq(design, residual, rcond=None)[0]
    rotation = Rotation.from_rotvec(x[:3]).as_matrix()
    scale = 1.0 + x[6]
    return scale, rotation, middle + x[3:6] - scale * rotation @ middle


def lay_over(
    points: np.ndarray, poses: str | os.PathLike, truth: str | os.PathLike, surface: TrueSurface
) -> Callable[[np.ndarray], np.ndarray]:
    """Return what brings points (n, 3) of the frame of a poses NPZ to that of ``{scene}/truth``."""
    pairs = pair_cameras(read_poses(poses), read_poses(Path(truth) / "poses.npz"))
    scale, rotation, translation, _ = camera_similarity(*pairs)
    finer = refine_similarity(scale * points @ rotation.T + translation, surface)

    def move(points: np.ndarray) -> np.ndarray:
        points = scale * points @ rotation.T + translation
        return finer[0] * points @ finer[1].T + finer[2]

    return move


def score_file(
    cloud: str | os.PathLike, truth: str | os.PathLike, poses: str | os.PathLike | None = None
) -> dict:
    """Score a PLY against ``{scene}/truth`` as :func:`score_cloud` does.

    The poses NPZ is that of the cloud's frame and brings the cloud to the scene's; without it, the
    cloud is in that already. Raises a `StageError` if a file is missing or broken, or the cloud is
    nowhere near the tree.
    """
    surface = load_true_surface(truth)
    points = read_cloud(cloud).points
    if poses:
        points = lay_over(points, poses, truth, surface)(points)
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
