"""Measure a tree's traits on its skeleton and its labelled cloud.

Reads skeleton.graphml, segmented.ply and target.json, and for a scan from photos scale.json,
metric_poses.npz, sfm/report.json, photo_check.json, the undistorted photos' cameras and what each
photo shows (evidence) (with hand corrections edits.json); writes traits.json, branches.csv and,
where a path is given, limbs.csv and branches.ply, the wood with the branch of each point. Example:

    python scripts/measure_traits.py --skeleton skeleton.graphml --segmented segmented.ply \\
        --traits traits.json --branches branches.csv --limbs limbs.csv
"""

from typing import Annotated

from cherrypicker.files import read_json, write_json, write_text
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.pointcloud import read_cloud, write_cloud
from cherrypicker.poses import read_poses
from cherrypicker.runner import run, stage_parser
from cherrypicker.skeleton import axes, read_skeleton
from cherrypicker.traits.branches import branches_csv
from cherrypicker.traits.measure import TraitOptions, measure_traits
from cherrypicker.traits.reports import Reports
from cherrypicker.traits.support import branch_cloud
from cherrypicker.traits.table import LIMB_COLUMNS


def main(
    skeleton: Annotated[str, "skeleton.graphml"],
    segmented: Annotated[str, "labelled cloud"],
    traits: Annotated[str, "JSON to write"],
    branches: Annotated[str, "CSV of all axes to write"],
    limbs: Annotated[str | None, "limbs.csv: the limbs on the stem"] = None,
    branch_points: Annotated[str | None, "branches.ply: the wood, with a branch_id a point"] = None,
    scale: Annotated[str | None, "scale.json of a scan from photos"] = None,
    sparse: Annotated[str | None, "sfm/report.json of a scan from photos"] = None,
    target: Annotated[str | None, "target.json: which tree it is, and the others"] = None,
    edits: Annotated[str | None, "edits.json of a tree with hand corrections"] = None,
    photo_check: Annotated[str | None, "photo_check.json of a scan from photos"] = None,
    metric_poses: Annotated[str | None, "poses in the segmented cloud's frame"] = None,
    cameras: Annotated[str | None, "poses.npz of the undistorted photos"] = None,
    evidence: Annotated[str | None, "folder of what each photo shows"] = None,
    *,
    options: TraitOptions,
    seed: int = 0,
) -> None:
    cloud = read_cloud(segmented, required=("label",))
    poses = read_poses(metric_poses) if metric_poses else None
    photos = None
    if cameras and evidence and poses:
        photos = ScanPhotos(read_poses(cameras), evidence, poses)
    tree = read_skeleton(skeleton)
    files = {"scale": scale, "sparse": sparse, "target": target, "edits": edits}
    files |= {"photo_check": photo_check}
    told = {name: read_json(path) for name, path in files.items() if path}
    reports = Reports(**told, poses=poses, photos=photos)
    numbers, tables = measure_traits(tree, cloud, reports, options=options, seed=seed)
    if branch_points:
        write_cloud(branch_points, branch_cloud(cloud, tree, axes(tree)))
    write_text(branches, branches_csv(tables["branches"]))
    if limbs:
        write_text(limbs, branches_csv(tables["limbs"], LIMB_COLUMNS))
    write_json(traits, numbers)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
