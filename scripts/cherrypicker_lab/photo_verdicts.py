"""What photos say of a scan beside its truth, as it is and spoilt on purpose."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cherrypicker.classes import wood_mask
from cherrypicker.files import read_json
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.mvs.undistort import UndistortedPhotos
from cherrypicker.photo_check.check import check_photos
from cherrypicker.photo_check.drop import drop_refuted
from cherrypicker.photos import list_photos
from cherrypicker.pointcloud import read_cloud
from cherrypicker.poses import read_poses
from cherrypicker.skeleton import axes, axis_of_node
from cherrypicker.skeleton.model import Skeleton, densify
from cherrypicker_lab.evaluation import compare_skeletons
from cherrypicker_lab.spoilt_skeletons import Spoilt
from cherrypicker_lab.tables import markdown_table
from cherrypicker_lab.traits.cases import scan_and_truth

TOLERANCE_M, SAMPLE_M = 0.01, 0.002
# Bins of probability in which what is told is held against what is true
N_BINS = 5
COLUMNS = ("precision", "photo_precision", "recall", "photo_recall", "precision_after")
COLUMNS += ("recall_after", "dropped_m", "length", "left_m")


class FinishedScan:
    """A finished scan from photos, ``results/{tree}``, beside its scene's ``truth``."""

    def __init__(self, results: Path, truth: Path, threads: int) -> None:
        self.threads = threads
        poses = read_poses(results / "metric_poses.npz")
        photos = UndistortedPhotos(results / "sfm/model", list_photos(truth.parent / "photos"))
        self.photos = ScanPhotos(
            read_poses(results / "dense/poses.npz"),
            results / "evidence",
            poses,
            depth=results / "depth",
            read_photo=photos.read,
        )
        self.fused = self.photos.placed(read_cloud(results / "cloud.ply").points)
        self.skeleton, self.true = scan_and_truth(results, truth)
        self.cloud = read_cloud(results / "segmented.ply", required=("label",))
        self.others = np.array(read_json(results / "target.json")["other_stems_xy"]).reshape(-1, 2)

    @property
    def as_it_is(self) -> Spoilt:
        """The scan itself, as one of which nothing was spoilt."""
        none = np.empty((0, 3))
        return Spoilt(self.skeleton, self.cloud, none, none, 0.0)

    def judge(self, spoilt: Spoilt) -> dict[str, Any]:
        """Numbers of a spoilt scan: by the truth, by its photos, and after what they refute."""
        report, _ = check_photos(
            spoilt.skeleton,
            spoilt.cloud,
            self.photos,
            self.fused,
            other_stems=self.others,
            threads=self.threads,
        )
        wood = spoilt.cloud.points[wood_mask(spoilt.cloud["label"])]
        left, dropped = drop_refuted(spoilt.skeleton, self.photos, wood)
        before, after = (
            compare_skeletons(each, self.true, tolerance=TOLERANCE_M)
            for each in (spoilt.skeleton, left)
        )
        left_length = 0.0  # of an added strand that is still there
        if len(spoilt.added):
            away = densify(left, SAMPLE_M).nearest(spoilt.added)[0]
            left_length = float(spoilt.length * (away < SAMPLE_M).mean())
        return {
            "length": spoilt.length,
            "precision": before["skeleton_precision_all"],
            "photo_precision": report["photo_precision"],
            "recall": before["skeleton_recall_all"],
            "photo_recall": report["photo_recall"],
            "precision_after": after["skeleton_precision_all"],
            "recall_after": after["skeleton_recall_all"],
            "dropped_m": dropped["dropped_length"],
            "left_m": left_length,
            "axes": self._axes(spoilt.skeleton, report["axes"]),
        }

    def _axes(self, skeleton: Skeleton, told: list[dict]) -> list[tuple[float, float, float]]:
        """Of each axis how probable it is told, the share of it that is true, and its length.

        True is what lies within `TOLERANCE_M` of a true axis or inside of its wood.
        """
        places, true = densify(skeleton, SAMPLE_M), densify(self.true, SAMPLE_M)
        distance, nearest = true.nearest(places.points)
        is_true = distance <= np.maximum(TOLERANCE_M, true.radius[nearest])
        axis = axis_of_node(skeleton, axes(skeleton))[places.node]
        whole = np.bincount(axis, places.length)
        right = np.bincount(axis, places.length * is_true)
        rows = [each["branch_id"] for each in told]
        return [
            (each["p_exists"], float(right[row] / whole[row]), float(whole[row]))
            for each, row in zip(told, rows, strict=True)
        ]


def reliability(axes: list[tuple[float, float, float]]) -> list[tuple[int, float, float]]:
    """Number of axes, and the means over their length of what is told and true, in each bin."""
    table = np.array(axes).reshape(-1, 3)
    row = np.minimum((table[:, 0] * N_BINS).astype(int), N_BINS - 1)
    bins = []
    for one in range(N_BINS):
        told, true, length = table[row == one].T
        whole = max(float(length.sum()), 1e-12)
        bins.append((len(told), float(told @ length) / whole, float(true @ length) / whole))
    return bins


def markdown(reports: list[dict[str, Any]]) -> str:
    """Return every scan's rows, and how often of all axes is true what is told of them."""
    parts = []
    for report in reports:
        rows = []
        for row in report["rows"]:
            kind = row["kind"] + (f" {row['size']:g}" if row["size"] else "")
            cells = ("-" if row[name] is None else f"{row[name]:.3f}" for name in COLUMNS)
            rows.append([kind, *cells])
        parts.append(f"{report['tree']}\n\n{markdown_table(['scan', *COLUMNS], rows)}")
    told = [axis for report in reports for row in report["rows"] for axis in row["axes"]]
    rows = []
    for k, (n, said, true) in enumerate(reliability(told)):
        shares = [f"{said:.3f}", f"{true:.3f}"] if n else ["", ""]
        rows.append([f"{k / N_BINS:.1f} to {(k + 1) / N_BINS:.1f}", str(n), *shares])
    parts.append(markdown_table(["axes told", "number", "told", "true"], rows))
    return "\n".join(parts)
