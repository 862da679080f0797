"""Tell the bearing wood of a tree: shoots, spurs, two-year and older wood, by axis and by limb.

Reads skeleton.graphml with branches.csv and, from photos, photo_check.json beside it, limbs.csv and
traits.json; of a tree from photos also these and their sparse model, the undistorted photos'
cameras, what each shows (evidence) and metric_poses.npz, which tell its buds. Writes bearing.csv, a
row a piece of an axis, buds.csv, a row a bud, and bearing.json, the tree and its limbs. Example:

    python scripts/measure_bearing.py --skeleton results/TREE/skeleton.graphml \\
        --limbs results/TREE/limbs.csv --traits results/TREE/traits.json \\
        --pieces bearing.csv --buds buds.csv --bearing bearing.json
"""

from pathlib import Path
from typing import Annotated

from cherrypicker.bearing.buds import BUD_COLUMNS, find_buds
from cherrypicker.bearing.measure import COLUMNS, HELD_COLUMNS, measure_bearing
from cherrypicker.errors import StageError
from cherrypicker.files import csv_text, read_json, write_json, write_text
from cherrypicker.formats.measured import read_measured_tree
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.mvs.undistort import UndistortedPhotos
from cherrypicker.photos import photo_files
from cherrypicker.poses import read_poses
from cherrypicker.runner import run, stage_parser
from cherrypicker.traits.branches import read_branches
from cherrypicker.traits.table import LIMB_COLUMNS


def main(
    skeleton: Annotated[str, "skeleton.graphml, with branches.csv and photo_check.json beside it"],
    limbs: Annotated[str, "limbs.csv"],
    traits: Annotated[str, "traits.json"],
    pieces: Annotated[str, "bearing.csv to write"],
    buds: Annotated[str, "buds.csv to write"],
    bearing: Annotated[str, "bearing.json to write"],
    photos: Annotated[list[str] | None, "the photos of the scan"] = None,
    model: Annotated[str | None, "images.bin of their sparse model"] = None,
    cameras: Annotated[str | None, "poses.npz of the undistorted photos"] = None,
    metric_poses: Annotated[str | None, "poses in the skeleton's frame"] = None,
    evidence: Annotated[str | None, "folder of what each photo shows"] = None,
) -> None:
    tree = read_measured_tree(Path(skeleton).parent)
    trunk_area = read_json(traits).get("tcsa_cm2")
    seen = None
    if photos and tree.skeleton.unit == "m":
        if not (model and cameras and metric_poses and evidence):
            raise StageError("photos tell buds by their model, cameras, metric poses and evidence")
        read_photo = UndistortedPhotos(Path(model).parent, photo_files(photos)).read
        poses = read_poses(cameras), evidence, read_poses(metric_poses)
        seen = find_buds(tree.skeleton, tree.axis_list, ScanPhotos(*poses, read_photo=read_photo))
    totals, rows = measure_bearing(tree, read_branches(limbs, LIMB_COLUMNS), trunk_area, buds=seen)
    write_text(pieces, csv_text(rows, (*COLUMNS, *HELD_COLUMNS)))
    write_text(buds, csv_text(seen.found if seen else [], BUD_COLUMNS))
    write_json(bearing, totals)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
