"""Run dense stereo on a workspace with one backend and measure it.

Reads a dense workspace (poses.npz in it), makes a copy beside the measurement to
work in, writes measurement.json and the fused cloud.ply. Example:

    python scripts/lab/measure_stereo.py --undistorted dense/poses.npz --backend sgbm \\
        --measurement benchmark/measurement.json --cloud benchmark/cloud.ply
"""

from pathlib import Path

import lab_path  # noqa: F401
from cherrypicker.files import write_json
from cherrypicker.mvs.estimate import StereoOptions
from cherrypicker.mvs.fusion import FusionOptions
from cherrypicker.pointcloud import write_cloud
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.dense.backends import ALL_BACKENDS
from cherrypicker_lab.dense.measure import measure_stereo


def main(
    undistorted,
    measurement,
    cloud,
    backend,
    megapixels,
    sky_masks,
    images,
    scan,
    cameras,
    *,
    stereo: StereoOptions,
    fusion: FusionOptions,
    max_photos: int | None = None,
    threads: int = 2,
):
    """Measure and save."""
    report, fused = measure_stereo(
        Path(undistorted).parent,
        Path(measurement).parent / "dense",
        backend,
        stereo,
        fusion,
        megapixels=megapixels or None,
        max_photos=max_photos or None,
        sky=(sky_masks, Path(images).parent) if sky_masks else None,
        threads=threads,
    )
    write_cloud(cloud, fused)
    write_json(measurement, {"scan": scan, "cameras": cameras, **report})


parser = stage_parser(__doc__)
parser.add_argument("--undistorted", required=True, help="poses.npz in the dense workspace")
parser.add_argument("--measurement", required=True, help="JSON to write; its folder takes the copy")
parser.add_argument("--cloud", required=True, help="fused cloud to write, PLY")
parser.add_argument("--backend", default="cpu", choices=ALL_BACKENDS)
parser.add_argument("--megapixels", type=float, default=0.0, help="of each photo; 0: as they are")
parser.add_argument("--sky_masks", default="", help="folder of sky masks")
parser.add_argument("--images", default="", help="images.bin of the photos as stored, for these")
parser.add_argument("--scan", default="", help="name for the table")
parser.add_argument("--cameras", default="", help="true or sfm, for the table")
run(main, parser, globals().get("snakemake"))
