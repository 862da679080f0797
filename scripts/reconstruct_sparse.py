"""Reconstruct camera poses and a sparse cloud from matched photos.

Reads sfm/database.db, sfm/photos.json and the photos; writes sfm/model (COLMAP), sfm/report.json
and poses.npz (undistorted pinholes). Example:

    python scripts/reconstruct_sparse.py --database database.db --listing photos.json \\
        --photos photos/*.jpg --images model/images.bin --report report.json --poses poses.npz
"""

from pathlib import Path

from cherrypicker.runner import run, stage_parser
from cherrypicker.sfm.mapping import MappingOptions
from cherrypicker.sfm.sparse import reconstruct_sparse


def main(
    database,
    listing,
    photos,
    images,
    report,
    poses,
    *,
    min_registered_fraction,
    seed,
    threads,
    **options,
):
    reconstruct_sparse(
        database,
        photos,
        listing,
        Path(images).parent,
        report,
        poses,
        MappingOptions(**options),
        min_registered_fraction=min_registered_fraction,
        seed=seed,
        threads=threads,
    )


parser = stage_parser(__doc__)
parser.add_argument("--database", required=True, help="COLMAP database with matches")
parser.add_argument("--listing", required=True, help="JSON of extract_features")
parser.add_argument("--photos", required=True, nargs="*", help="photos of one folder")
parser.add_argument("--images", required=True, help="images.bin; its folder takes the model")
parser.add_argument("--report", required=True, help="JSON report to write")
parser.add_argument("--poses", required=True, help="NPZ of undistorted poses to write")
parser.add_argument("--mapper", default="incremental", choices=("incremental", "global"))
parser.add_argument("--min_registered_fraction", type=float, default=0.5, help="else an error")
parser.add_argument("--wanted_fraction", type=float, default=0.95, help="else other attempts")
parser.add_argument("--wanted_agreement", type=float, default=0.9, help="else other attempts")
parser.add_argument("--max_attempts", type=int, default=5)
parser.add_argument("--max_ratio", type=float, default=0.8, help="ratio test of guided matching")
parser.add_argument("--max_error_px", type=float, default=4.0, help="epipolar error, px")
parser.add_argument("--min_inliers", type=int, default=15, help="matches of a verified pair")
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--threads", type=int, default=2)
run(main, parser, globals().get("snakemake"))
