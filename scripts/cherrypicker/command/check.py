"""Look at the table and the photos of a work folder before the run: go, or what to do again.

Tells unreadable and blurred photos, exposure, markers, photos that do not overlap and gaps in the
walk round the tree, with a picture of where: check/TREE.jpg; of a video the frames are judged that
the run would take. Takes a minute or two a tree; nothing else is written. The exit status is 1
where a tree has to be photographed again. Examples:

    cherrypicker check
    cherrypicker check -d WORK row3_tree07
"""

import argparse
import os
from pathlib import Path

import numpy as np

from cherrypicker.batch.batch import Batch
from cherrypicker.batch.trees import Tree
from cherrypicker.capture.contact_sheet import write_contact_sheet
from cherrypicker.capture.look import LOOK_PX, look_at
from cherrypicker.capture.verdict import judge
from cherrypicker.command.work_folder import batch_here, folder_parser
from cherrypicker.errors import StageError
from cherrypicker.files import temporary_folder
from cherrypicker.intake.clouds import HeightOptions, import_cloud
from cherrypicker.intake.kinds import are_plain, list_captures
from cherrypicker.intake.prepare import PrepareOptions, prepare_photos
from cherrypicker.markers.detection import marker_dictionary
from cherrypicker.markers.references import check_scale

parser = folder_parser(__doc__)
parser.add_argument("trees", nargs="*", metavar="TREE", help="default all trees of the table")
parser.add_argument(
    "--cores", type=int, default=os.cpu_count() or 1, help="photos at a time, default all cores"
)


def main(args: argparse.Namespace) -> int:
    """Check each tree; return 0 where all can go."""
    batch = batch_here()
    unknown = [tree for tree in args.trees if tree not in batch.trees]
    if unknown:
        raise StageError(f"no tree {unknown[0]!r} in the table", file=batch.settings["trees"])
    if not batch.trees:
        raise StageError("the table has no tree: nothing to check", file=batch.settings["trees"])
    all_go = True
    for tree in args.trees or batch.trees:
        try:
            all_go &= _check(batch, tree, args.cores)
        except StageError as error:
            print(f"{tree}: cannot run\n  - {error.describe()}", flush=True)
            all_go = False
    return 0 if all_go else 1


def _check(batch: Batch, tree: str, cores: int) -> bool:
    """Check one tree and tell of it; return whether it can go."""
    row, scale = batch.trees[tree], batch.settings_of[tree]["scale"]
    if not row.is_photo_scan:
        heights = HeightOptions(scale["height_range_m"])
        cloud = import_cloud(row.cloud, row.cloud_unit, row.cloud_up, row.scale, heights)
        height = f"{np.ptp(cloud.points[:, 2]):.3g} {cloud.unit.replace('arbitrary', 'units')}"
        print(f"{tree}: go, a ready cloud of {len(cloud):,} points, {height} high", flush=True)
        return True
    columns = row.marker_dictionary, row.marker_sides_m
    sides, _ = check_scale(row.scale, scale["mode"], *columns, scale["references"])
    names = [row.marker_dictionary] if sides else []
    dictionaries = {name: marker_dictionary(name) for name in names}
    video_step = batch.settings_of[tree]["photos"]["video_step"]
    # Prepared photos are small, and go afterwards
    with temporary_folder(Path("check"), ".prepared") as folder:
        looks = list(look_at(_photos(row, folder, video_step, cores), dictionaries, cores))
    verdict = judge(looks, list(sides), cores)
    sheet = Path("check") / f"{tree}.jpg"
    write_contact_sheet(sheet, tree, verdict)
    title = "go" if verdict.is_go else "photograph again"
    lines = [f"{tree}: {title}, {len(verdict.looks)} photos, {sheet}"]
    lines += [f"  {'-' if one.is_stop else 'note:'} {one.text}" for one in verdict.findings]
    print("\n".join(lines), flush=True)
    return verdict.is_go


def _photos(row: Tree, folder: Path, video_step: float, cores: int) -> list[Path]:
    """Return the photos that the run will read; those that it prepares are made in a folder."""
    captures = list_captures(row.photos)
    if are_plain(captures) and not row.masks:
        return captures
    photos, masks = folder / "photos", folder / "masks"
    # Nothing is looked at in more pixels; a photo that cannot be read is told of as any other
    options = PrepareOptions(LOOK_PX, video_step, skip_unreadable=True)
    made = prepare_photos(captures, photos, masks, options, user_masks=row.masks, threads=cores)
    for name, reason in sorted(made["left_out"].items()):
        print(f"{name} is left out: {reason}", flush=True)
    return [photos / name for name in sorted(made["photos"])]
