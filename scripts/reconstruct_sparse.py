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
    options: MappingOptions,
    seed: int = 0,
    threads: int = 2,
):
    reconstruct_sparse(
        database,
        photos,
        listing,
        Path(images).parent,
        report,
        poses,
        options,
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
run(main, parser, globals().get("snakemake"))
