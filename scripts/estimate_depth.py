"""Estimate depth and normal maps of the undistorted photos.

Reads the dense workspace (its manifest undistorted.json), writes photometric and geometric maps in
COLMAP's layout and the manifest depth.json. Whole maps of the same settings are kept. Example:

    python scripts/estimate_depth.py --undistorted dense/undistorted.json --depth dense/depth.json
"""

from pathlib import Path

from cherrypicker.files import read_json, write_json
from cherrypicker.mvs.backends.choice import estimate_workspace
from cherrypicker.mvs.clear_sky import SkyMasks
from cherrypicker.mvs.estimate import StereoOptions
from cherrypicker.runner import run, stage_parser


def main(undistorted, depth, *, backend, threads, cameras=None, sky_masks=None, **options):
    """Estimate the maps, then write the manifest."""
    masks = None
    if sky_masks:
        names = [photo["name"] for photo in read_json(undistorted)["photos"]]
        masks = SkyMasks(sky_masks, Path(cameras).parent, names)
    manifest = estimate_workspace(
        Path(undistorted).parent,
        StereoOptions(**options),
        backend=backend,
        threads=threads,
        sky_masks=masks,
    )
    write_json(depth, manifest)


defaults = StereoOptions()
parser = stage_parser(__doc__)
parser.add_argument("--undistorted", required=True, help="manifest of the dense workspace")
parser.add_argument("--depth", required=True, help="manifest of the depth maps to write")
parser.add_argument("--sky_masks", help="folder of sky masks; what they cover is left out")
parser.add_argument("--cameras", help="cameras.bin of the photos as stored, for the sky masks")
parser.add_argument("--backend", default="auto", help="auto, cuda or cpu")
parser.add_argument("--n_sources", type=int, default=defaults.n_sources)
parser.add_argument("--n_best", type=int, default=defaults.n_best)
parser.add_argument("--n_iterations", type=int, default=defaults.n_iterations)
parser.add_argument("--window_radius", type=int, default=defaults.window_radius)
parser.add_argument("--color_spread", type=float, default=defaults.color_spread)
parser.add_argument("--min_texture", type=float, default=defaults.min_texture)
parser.add_argument("--max_cost", type=float, default=defaults.max_cost)
parser.add_argument("--geometric_weight", type=float, default=defaults.geometric_weight)
parser.add_argument("--max_error_px", type=float, default=defaults.max_error_px)
parser.add_argument("--min_consistent", type=int, default=defaults.min_consistent)
parser.add_argument("--seed", type=int, default=defaults.seed)
parser.add_argument("--threads", type=int, default=2)
run(main, parser, globals().get("snakemake"))
