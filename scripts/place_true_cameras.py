"""Triangulate the photos' own features with the true cameras of a rendered scene.

Reads sfm/database.db (matches), the photos and SCENE/truth/poses.npz; writes a COLMAP model that
undistort_photos takes. Example:

    python scripts/place_true_cameras.py --database sfm/database.db --folder scenes/tree/photos \\
        --poses scenes/tree/truth/poses.npz --images true/images.bin
"""

from pathlib import Path

from cherrypicker.runner import run, stage_parser
from cherrypicker.stereo_benchmark.true_cameras import triangulate_true_cameras


def main(database, folder, poses, images, *, seed, threads):
    """Triangulate and save."""
    triangulate_true_cameras(
        database, folder, poses, Path(images).parent, seed=seed, threads=threads
    )


parser = stage_parser(__doc__)
parser.add_argument("--database", required=True, help="COLMAP database with matches")
parser.add_argument("--folder", required=True, help="folder of the photos")
parser.add_argument("--poses", required=True, help="SCENE/truth/poses.npz")
parser.add_argument("--images", required=True, help="images.bin to write; its folder is the model")
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--threads", type=int, default=2)
run(main, parser, globals().get("snakemake"))
