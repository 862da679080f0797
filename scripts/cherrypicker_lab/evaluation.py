"""A tree's results against the ground truth of its scene.

Frames: the result lives in a frame of its own (z up, stem near the origin), so it is moved onto the
truth before positions are compared. The motion is a rotation and a translation fitted to the camera
centres of the photos that both have, with the result's scale kept: a wrong scale stays visible in
every distance. A full rotation is allowed, since the tilt has a bar of its own. Clouds that came in
ready have no cameras and are compared in the frame they came in.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import CLASS_NAMES, wood_mask
from cherrypicker.errors import StageError
from cherrypicker.files import read_json
from cherrypicker.geometry.similarity import fit_rigid, fit_similarity, moved
from cherrypicker.pointcloud import read_cloud
from cherrypicker.poses import read_poses
from cherrypicker.skeleton import read_skeleton, read_skeleton_csv
from cherrypicker.skeleton.model import densify
from cherrypicker_lab.skeletons.distances import match_rates

_SAMPLE_M, _THICK_M = 0.002, 0.005
REACH_M = 0.03  # a point farther from all true surface has no true class
_TIP_REACH_M = 0.03


@dataclass(frozen=True)
class Bar:
    """A number that a result must reach."""

    name: str  # key of the evaluation
    limit: float
    is_least: bool  # the value must be at least the limit, else at most
    what: str

    def is_met(self, value):
        """Whether a value reaches the bar; a missing one does not."""
        if value is None or not np.isfinite(value):
            return False
        return value >= self.limit if self.is_least else value <= self.limit


BARS = (
    Bar("registered_fraction", 0.95, True, "photos registered"),
    Bar("scale_error", 0.005, False, "relative scale error"),
    Bar("up_error_deg", 1.0, False, "up direction, degrees"),
    Bar("skeleton_recall", 0.80, True, "skeleton recall at 2 cm, wood of 5 mm radius and more"),
    Bar("skeleton_precision", 0.80, True, "skeleton precision at 2 cm, same wood"),
    Bar("trunk_diameter_error_m", 0.006, False, "trunk diameter error, m"),
    Bar("height_error", 0.03, False, "relative height error"),
    Bar("total_length_error", 0.03, False, "relative error of the total length"),
    Bar("tips_f1", 0.80, True, "F1 of tips, one to one within 3 cm"),
    Bar("wood_f1", 0.99, True, "F1 of wood points against all else"),
    Bar("trunk_f1", 0.95, True, "F1 of trunk points"),
    Bar("branch_f1", 0.98, True, "F1 of branch points"),
)
_CAMERA_BARS = ("registered_fraction", "scale_error", "up_error_deg")


def evaluate(results, truth):
    """Compare the results of one tree, ``results/{tree}``, with ``{scene}/truth`` of its scene.

    Returns plain numbers by name; those of `BARS` are compared by `missed_bars`. Camera numbers are
    missing for a tree from a ready cloud. Raises a `StageError` if a file is missing or broken.
    """
    results, truth = Path(results), Path(truth)
    report, frame = {}, np.eye(4)
    if (results / "metric_poses.npz").is_file():
        report |= cameras_beside_truth(results, truth)
        frame = report.pop("frame")
    skeleton = read_skeleton(results / "skeleton.graphml")
    skeleton.points = moved(skeleton.points, frame)
    report |= compare_skeletons(skeleton, read_skeleton_csv(truth / "skeleton.csv"))
    report |= _compare_traits(read_json(results / "traits.json"), read_json(truth / "traits.json"))
    if (truth / "cloud.ply").is_file() and (results / "segmented.ply").is_file():
        cloud = read_cloud(results / "segmented.ply", required=("label",))
        exact = read_cloud(truth / "cloud.ply", required=("label",))
        points = moved(cloud.points, frame)
        report |= compare_labels(points, cloud["label"], exact.points, exact["label"])
    return report


def missed_bars(report):
    """Bars that an evaluation misses, with those of the cameras only for a scan from photos."""
    is_photo_scan = "registered_fraction" in report
    return [
        bar
        for bar in BARS
        if (is_photo_scan or bar.name not in _CAMERA_BARS) and not bar.is_met(report.get(bar.name))
    ]


def pair_cameras(found, truth):
    """Centres of the cameras of `Poses` that bear the names of true ones, and those, (n, 3) each.

    Raises a `StageError` if fewer than three names are common.
    """
    index = {str(name): i for i, name in enumerate(truth.names)}
    here = [i for i, name in enumerate(found.names) if str(name) in index]
    if len(here) < 3:
        raise StageError(f"{len(here)} photos of the result are in the truth, three are needed")
    there = [index[str(found.names[i])] for i in here]
    return found.centers[here], truth.centers[there]


def camera_similarity(a, b):
    """Similarity ``b = s R a + t`` of camera centres (n, 3) and the true ones: s, R (3, 3), t (3,).

    Cameras further off than four times the median are left out once, as a photo with a wrong pose
    would bend the fit. The fourth value, (n,) bool, tells the cameras that stay in the end.
    """
    keep = np.ones(len(a), dtype=bool)
    for _ in range(2):
        scale, rotation, *_ = fit_similarity(a[keep], b[keep])
        translation = b[keep].mean(axis=0) - scale * rotation @ a[keep].mean(axis=0)
        off = np.linalg.norm(scale * a @ rotation.T + translation - b, axis=1)
        keep = off <= max(4.0 * np.median(off), 1e-6)
    return scale, rotation, translation, keep


def compare_cameras(found, truth):
    """Photos registered, scale and up direction of metric `Poses` against true ones of equal names.

    Cameras that :func:`camera_similarity` leaves out do not count. Returns ``registered_fraction``,
    ``scale_error`` (relative), ``up_error_deg``, ``camera_rms_m`` (after the rigid fit), and
    ``frame`` (4, 4), which moves the result onto the truth. Raises a `StageError` if fewer than
    three photos are common.
    """
    a, b = pair_cameras(found, truth)
    scale, _, _, keep = camera_similarity(a, b)
    frame = fit_rigid(a[keep], b[keep], np.ones(keep.sum()))
    off = np.linalg.norm(moved(a, frame) - b, axis=1)
    return {
        "n_photos": len(truth.names),
        "n_registered": len(a),
        "registered_fraction": len(a) / len(truth.names),
        "scale_error": abs(1.0 / scale - 1.0),
        "up_error_deg": float(np.degrees(np.arccos(np.clip(frame[2, 2], -1, 1)))),
        "camera_rms_m": float(np.sqrt((off[keep] ** 2).mean())),
        "frame": frame,
    }


def cameras_beside_truth(results, truth):
    """`compare_cameras` of a tree's results, ``results/{tree}``, and ``{scene}/truth``, Paths."""
    return compare_cameras(
        read_poses(results / "metric_poses.npz"), read_poses(truth / "poses.npz")
    )


def at_surface(points, surface, values, missing):
    """What the nearest of surface points (m, 3) has, (n,); `missing` where `REACH_M` has none."""
    _, nearest = cKDTree(surface).query(points, distance_upper_bound=REACH_M, workers=-1)
    return np.append(values, values.dtype.type(missing))[nearest]


def compare_skeletons(found, truth, *, tolerance=0.02):
    """Recall and precision of a skeleton, as lengths; both and `tolerance` in one frame, metres.

    Both are sampled every 2 mm, and tips matched one to one within 3 cm. Recall: the part of the
    true wood of 5 mm radius and more that has the found skeleton within `tolerance`. Precision: the
    part of the found wood that it gives 5 mm and more that has the true skeleton, of any radius,
    within `tolerance`.

    Returns ``skeleton_recall``, ``skeleton_precision``, the same over wood of any radius
    (``_all``), and ``tips_f1``.
    """
    samples, true = densify(found, _SAMPLE_M), densify(truth, _SAMPLE_M)
    weight, true_weight = samples.length, true.length
    is_hit = samples.nearest(true.points)[0] <= tolerance
    is_true = true.nearest(samples.points)[0] <= tolerance
    thick, true_thick = samples.radius >= _THICK_M, true.radius >= _THICK_M
    report = {
        "skeleton_recall": _share(is_hit, true_weight, true_thick),
        "skeleton_precision": _share(is_true, weight, thick),
        "skeleton_recall_all": _share(is_hit, true_weight),
        "skeleton_precision_all": _share(is_true, weight),
    }
    tips = (each.points[1:][each.degree[1:] == 1] for each in (found, truth))
    return report | {"tips_f1": match_rates(*tips, _TIP_REACH_M)["f1"]}


def _share(is_good, weight, among=True):
    total = float((weight * among).sum())
    return float((weight * is_good * among).sum() / total) if total > 0 else 0.0


def _compare_traits(found, truth):
    heights = [each["trunk_height_m"] for each in (found, truth)]
    if abs(heights[0] - heights[1]) > 1e-6:
        raise StageError(
            "the trunk's diameter was measured at {:g} m, its truth is that at {:g} m".format(
                *heights
            ),
            key="traits.trunk_height_m",
        )
    report = {
        "trunk_diameter_m": found["trunk_diameter_m"],
        "trunk_diameter_error_m": abs(found["trunk_diameter_m"] - truth["trunk_diameter_m"]),
        "height_m": found["height_m"],
        "height_error": abs(found["height_m"] / truth["height_m"] - 1.0),
    }
    for name in ("total_length_m", "n_tips", "n_junctions"):
        if name in truth:
            report[f"{name}_ratio"] = found[name] / max(truth[name], 1e-12)
    report["total_length_error"] = abs(report.get("total_length_m_ratio", np.nan) - 1.0)
    return report


def compare_labels(points, labels, true_points, true_labels):
    """F1 per class of a labelled cloud, each point against its nearest true surface point.

    Points further than 3 cm from any true surface have no true class and are left out. Returns
    ``label_f1`` by class name, ``wood_f1`` (trunk and branch as one), ``trunk_f1``, ``branch_f1``,
    and ``label_matched``, the share of points with a true class.
    """
    distance, nearest = cKDTree(true_points).query(points, distance_upper_bound=REACH_M)
    known = np.isfinite(distance)
    found, true = labels[known], true_labels[nearest[known]]
    scores = {
        CLASS_NAMES.get(int(label), str(label)): f1(found == label, true == label)
        for label in np.unique(true)
    }
    bars = {f"{name}_f1": scores[name] for name in ("trunk", "branch") if name in scores}
    bars["wood_f1"] = f1(wood_mask(found), wood_mask(true))
    return {"label_f1": scores, "label_matched": float(known.mean()), **bars}


def f1(found, true):
    """F1 of what was found, both bool (n,)."""
    n_both = np.count_nonzero(found & true)
    return float(2 * n_both / max(np.count_nonzero(found) + np.count_nonzero(true), 1))
