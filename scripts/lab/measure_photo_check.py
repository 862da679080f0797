"""Measure whether the photos' verdict follows the truth, on finished scans spoilt on purpose.

Reads results/TREE of a scan from photos and SCENE/truth (poses.npz, skeleton.csv). The scan as it
is and spoilt in the ways and sizes of `cherrypicker_lab.spoilt_skeletons` is judged by its photos;
beside it stand true precision and recall at a centimetre, the flags that tell, and precision and
recall after what the photos refute is dropped. Example, about half a minute of a core each:

    python scripts/lab/measure_photo_check.py --results results/cherry_vase \\
        --truth resources/demo/cherry_vase/truth --output verdicts.json

    python scripts/lab/measure_photo_check.py --tables verdicts.json others.json
"""

import logging
import sys
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import spearmanr

import lab_path  # noqa: F401
from cherrypicker.classes import wood_mask
from cherrypicker.errors import StageError
from cherrypicker.files import read_json, write_json
from cherrypicker.mvs.clear_sky import SkyMasks
from cherrypicker.photo_check.check import CheckOptions, check_photos
from cherrypicker.photo_check.drop import drop_refuted
from cherrypicker.photo_check.places import MetricWorkspace
from cherrypicker.pointcloud import read_cloud
from cherrypicker.poses import read_poses
from cherrypicker.runner import stage_parser
from cherrypicker.skeleton import read_skeleton, read_skeleton_csv
from cherrypicker.traits.flags import scan_flags
from cherrypicker.traits.missing_top import find_missing_top
from cherrypicker.traits.support import densify
from cherrypicker_lab.evaluation import compare_cameras
from cherrypicker_lab.spoilt_skeletons import SIZES, Spoilt, spoil

TOLERANCE_M, SAMPLE_M = 0.01, 0.002
COLUMNS = ("precision", "photo_precision", "recall", "photo_recall", "told")
COLUMNS += ("precision_after", "recall_after", "dropped_m")
logger = logging.getLogger("cherrypicker")


def main(results, truth, output, tables, *, kinds, seed, threads):
    if tables:
        print_tables([read_json(path) for path in tables])
        return
    scan = Scan(Path(results), Path(truth), threads)
    rows = []
    if "as it is" in kinds:
        rows.append({"kind": "as it is", "size": 0.0, **scan.judge(scan.as_it_is)})
    for kind in kinds:
        for size in SIZES.get(kind, ()):
            try:
                spoilt = spoil(scan.skeleton, scan.cloud, kind, size, seed)
            except ValueError as error:
                logger.warning("%s", error)
                continue
            rows.append({"kind": kind, "size": size, **scan.judge(spoilt)})
            logger.info("%s", rows[-1])
    report = {"tree": Path(results).name, "rows": rows}
    if output:
        write_json(output, report)
    print_tables([report])


class Scan:
    """A finished scan from photos beside its truth."""

    def __init__(self, results, truth, threads):
        self.threads = threads
        self.poses = read_poses(results / "metric_poses.npz")
        self.workspace = MetricWorkspace(results / "dense", self.poses)
        names = self.workspace.poses.names
        self.masks = SkyMasks(results / "sky", results / "sfm/model", names)
        self.skeleton = read_skeleton(results / "skeleton.graphml")
        self.cloud = read_cloud(results / "segmented.ply", required=("label",))
        self.others = np.array(read_json(results / "target.json")["other_stems_xy"]).reshape(-1, 2)
        moved = compare_cameras(self.poses, read_poses(truth / "poses.npz"))
        true = read_skeleton_csv(truth / "skeleton.csv")
        true.points = (true.points - moved["translation"]) @ moved["rotation"]
        self.true_places, _, _, self.true_length = densify(true, SAMPLE_M)

    @property
    def as_it_is(self):
        """The scan itself, as one of which nothing was spoilt."""
        none = np.empty((0, 3))
        return Spoilt(self.skeleton, self.cloud, none, none, 0.0)

    def judge(self, spoilt):
        """Numbers of a spoilt scan: by the truth, by its photos, and after what they refute."""
        report, _ = check_photos(
            spoilt.skeleton,
            spoilt.cloud,
            self.workspace,
            self.masks,
            CheckOptions(),
            other_stems=self.others,
            threads=self.threads,
        )
        left, dropped = drop_refuted(
            spoilt.skeleton, self.workspace, self.masks, CheckOptions().least_photos
        )
        precision, recall = self.true_shares(spoilt.skeleton)
        after = self.true_shares(left)
        wood = spoilt.cloud.points[wood_mask(spoilt.cloud["label"])]
        top = find_missing_top(self.poses, self.masks, wood, spoilt.skeleton.points[0])
        flags = scan_flags("m", photo_check=report, missing_top=top)
        return {
            "length": spoilt.length,
            "precision": precision,
            "photo_precision": report["photo_precision"],
            "recall": recall,
            "photo_recall": report["photo_recall"],
            "told": [flag.partition(":")[0] for flag in flags],
            "precision_after": after[0],
            "recall_after": after[1],
            "dropped_m": dropped["dropped_length"],
            "left_m": _still_there(spoilt, left),
            "sky_share": report["photo_sky_share"],
            "missing_length": report["missing_length"],
            "missing_from_cloud_length": report["missing_from_cloud_length"],
        }

    def true_shares(self, skeleton):
        """Precision and recall at `TOLERANCE_M`, shares of length."""
        places, _, _, length = densify(skeleton, SAMPLE_M)
        right = cKDTree(self.true_places).query(places)[0] <= TOLERANCE_M
        found = cKDTree(places).query(self.true_places)[0] <= TOLERANCE_M
        return (
            float(length @ right / length.sum()),
            float(self.true_length @ found / self.true_length.sum()),
        )


def _still_there(spoilt, left):
    """Length of an added strand that is still in a skeleton."""
    if not len(spoilt.added):
        return 0.0
    places = densify(left, SAMPLE_M)[0]
    return float(spoilt.length * (cKDTree(places).query(spoilt.added)[0] < SAMPLE_M).mean())


def print_tables(reports):
    """Print every scan's rows, and how well the photos' numbers follow the truth over all."""
    for report in reports:
        print(f"\n{report['tree']}\n| scan | {' | '.join(COLUMNS)} |")
        for row in report["rows"]:
            name = row["kind"] + (f" {row['size']:g}" if row["size"] else "")
            print(f"| {name} | {' | '.join(_text(row[column]) for column in COLUMNS)} |")
    rows = [row for report in reports for row in report["rows"]]
    for name in ("precision", "recall"):
        pairs = [(row[name], row[f"photo_{name}"]) for row in rows if row[f"photo_{name}"]]
        if len(pairs) > 2:
            rank = spearmanr(*zip(*pairs, strict=True)).statistic
            print(f"\nrank correlation of {name} over {len(pairs)} scans: {rank:.2f}")


def _text(value):
    if isinstance(value, list):
        return " ".join(value) or "-"
    return "-" if value is None else f"{value:.3f}"


parser = stage_parser(__doc__)
parser.add_argument("--results", help="results/TREE")
parser.add_argument("--truth", help="SCENE/truth")
parser.add_argument("--output", default="", help="JSON to write")
parser.add_argument("--tables", nargs="*", default=[], help="such JSONs, to print together")
parser.add_argument("--kinds", nargs="*", default=["as it is", *SIZES], help="what to do")
parser.add_argument("--seed", type=int, default=0, help="which limb and which strand")
parser.add_argument("--threads", type=int, default=1)

if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    try:
        main(**vars(parser.parse_args()))
    except StageError as error:
        sys.exit(f"error: {error.describe()}")
