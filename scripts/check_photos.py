"""Let the photos judge a skeleton: what is not there, what is missing, how thick it is.

Reads skeleton.graphml, graph.json, segmented.ply, target.json, the fused cloud.ply, the photos and
their sparse model, the undistorted photos' cameras, what each shows (evidence) and how far that is
(depth), and metric_poses.npz; writes photo_check.json and two pictures. Example:

    python scripts/check_photos.py --skeleton skeleton.graphml --segmented segmented.ply \\
        --graph_report graph.json --target target.json --cloud cloud.ply --evidence evidence \\
        --photos photos/*.jpg --model sfm/model/images.bin --cameras dense/poses.npz \\
        --depth depth --metric_poses metric_poses.npz \\
        --report photo_check.json --worst photo_check/worst.jpg --best photo_check/best.jpg
"""

from pathlib import Path
from typing import Annotated

import numpy as np

from cherrypicker.files import read_json, write_json
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.mvs.undistort import UndistortedPhotos
from cherrypicker.photo_check.check import check_photos
from cherrypicker.photo_check.pictures import write_picture
from cherrypicker.photos import photo_files
from cherrypicker.pointcloud import read_cloud
from cherrypicker.poses import read_poses
from cherrypicker.runner import run, stage_parser
from cherrypicker.skeleton import read_skeleton


def main(
    skeleton: Annotated[str, "skeleton.graphml"],
    segmented: Annotated[str, "labelled cloud"],
    target: Annotated[str, "target.json: where other trees stand"],
    cloud: Annotated[str, "fused cloud in COLMAP's frame"],
    photos: Annotated[list[str], "the photos of the scan"],
    model: Annotated[str, "images.bin of their sparse model"],
    cameras: Annotated[str, "poses.npz of the undistorted photos"],
    metric_poses: Annotated[str, "poses in the skeleton's frame"],
    evidence: Annotated[str, "folder of what each photo shows"],
    report: Annotated[str, "JSON to write"],
    worst: Annotated[str, "picture of the worst photo to write"],
    best: Annotated[str, "picture of the best photo to write"],
    graph_report: Annotated[str | None, "graph.json: what the photos refuted before"] = None,
    depth: Annotated[str | None, "folder of the depths of each photo"] = None,
    *,
    seed: int = 0,
    threads: int = 2,
) -> None:
    found = read_json(target)
    others = found["other_stems_xy"] + found.get("neighbours_xy", [])
    scan = ScanPhotos(
        read_poses(cameras),
        evidence,
        read_poses(metric_poses),
        depth=depth,
        read_photo=UndistortedPhotos(Path(model).parent, photo_files(photos)).read,
    )
    content, pictures = check_photos(
        read_skeleton(skeleton),
        read_cloud(segmented, required=("label",)),
        scan,
        scan.placed(read_cloud(cloud).points),
        other_stems=np.array(others).reshape(-1, 2),
        refuted=read_json(graph_report)["refuted"] if graph_report else None,
        seed=seed,
        threads=threads,
    )
    write_picture(worst, pictures["worst"])
    write_picture(best, pictures["best"])
    write_json(report, content)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
