"""Make a dense workspace of a benchmark's scan, with its true cameras or with those from SfM.

Reads the photos and their matches (match_benchmark_photos.py) and, for true cameras, the scene's
truth/poses.npz; writes the sparse model beside the workspace and the cameras of the undistorted
photos. Example:

    python scripts/lab/place_benchmark_cameras.py --cameras true --folder scenes/tree/photos \\
        --poses scenes/tree/truth/poses.npz --database database.db --listing photos.json \\
        --images model/images.bin --undistorted dense/poses.npz
"""

from pathlib import Path

import lab_path  # noqa: F401
from cherrypicker.mvs.undistort import undistort
from cherrypicker.photos import list_photos
from cherrypicker.poses import write_poses
from cherrypicker.runner import run, stage_parser
from cherrypicker.sfm.sparse import reconstruct_sparse
from cherrypicker_lab.dense.true_cameras import triangulate_true_cameras


def main(
    folder,
    database,
    listing,
    images,
    undistorted,
    cameras,
    poses,
    *,
    max_image_size_px: int = 1600,
    seed: int = 0,
    threads: int = 2,
):
    """Place the cameras, then undistort."""
    photos, model = list_photos(folder), Path(images).parent
    if cameras == "true":
        triangulate_true_cameras(database, folder, poses, model, seed=seed, threads=threads)
    else:
        report, sparse_poses = model.parent / "report.json", model.parent / "poses.npz"
        reconstruct_sparse(
            database, photos, listing, model, report, sparse_poses, seed=seed, threads=threads
        )
    workspace = Path(undistorted).parent
    write_poses(
        undistorted, undistort(model, photos, workspace, max_image_size_px, threads=threads)
    )


parser = stage_parser(__doc__)
parser.add_argument("--cameras", required=True, choices=("true", "sfm"))
parser.add_argument("--folder", required=True, help="folder of the photos")
parser.add_argument("--database", required=True, help="COLMAP database with matches")
parser.add_argument("--listing", required=True, help="JSON of the photos")
parser.add_argument("--poses", default="", help="SCENE/truth/poses.npz, for true cameras")
parser.add_argument("--images", required=True, help="images.bin to write; its folder is the model")
parser.add_argument(
    "--undistorted",
    required=True,
    help="poses.npz of the undistorted photos to write, in the workspace",
)
run(main, parser, globals().get("snakemake"))
