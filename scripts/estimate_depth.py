"""Estimate depth and normal maps of the undistorted photos.

Reads the dense workspace (its manifest undistorted.json), writes photometric and geometric maps in
COLMAP's layout and the manifest depth.json. Whole maps of the same settings are kept. Example:

    python scripts/estimate_depth.py --undistorted dense/undistorted.json --depth dense/depth.json
"""

from pathlib import Path

from cherrypicker.files import write_json
from cherrypicker.mvs.backend import estimate_workspace
from cherrypicker.mvs.estimate import StereoOptions
from cherrypicker.runner import run, stage_parser


def main(undistorted, depth, *, backend, threads, **options):
    """Estimate the maps, then write the manifest."""
    manifest = estimate_workspace(
        Path(undistorted).parent, StereoOptions(**options), backend=backend, threads=threads
    )
    write_json(depth, manifest)


defaults = StereoOptions()
parser = stage_parser(__doc__)
parser.add_argument("--undistorted", required=True, help="manifest of the dense workspace")
parser.add_argument("--depth", required=True, help="manifest of the depth maps to write")
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
