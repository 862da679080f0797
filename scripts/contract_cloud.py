"""Choose the target tree by its wood, and contract that to its skeleton points (LBC or S-LBC).

Reads segmented.ply (and, for a tree from photos, metric.json), writes target.json, contracted.ply
and contract.json. Example:

    python scripts/contract_cloud.py --segmented segmented.ply --contracted contracted.ply \
        --report contract.json --target target.json --method slbc
"""

import numpy as np

from cherrypicker.contraction.contract_points import preset_options
from cherrypicker.contraction.contract_wood import contract_wood
from cherrypicker.files import read_json, write_json
from cherrypicker.placement.footprint import Footprint
from cherrypicker.pointcloud import read_cloud, write_cloud
from cherrypicker.runner import run, stage_parser
from cherrypicker.wood.target import target_report


def main(
    segmented,
    contracted,
    report,
    target,
    *,
    metric=None,
    target_xy=None,
    classes=(1, 2),
    weights=None,
    method="slbc",
    preset="default",
    voxel_size_m=0.008,
    max_points=100_000,
    gap_m=0.25,
    stem_gap_m=0.6,
    min_density=0.05,
    **constants,
):
    """Load, choose, contract, save."""
    cloud = read_cloud(segmented, required=("label",))
    scan = {"unit": cloud.unit, "factor": 1.0, "region": None}
    if metric:
        scan |= read_json(metric)
        scan["region"] = Footprint.from_dict(scan["region"])
    points, details = contract_wood(
        cloud,
        classes=classes,
        weights=weights,
        method=method,
        options=preset_options(preset, **constants),
        voxel_size_m=voxel_size_m,
        max_points=max_points,
        target_xy=scan["factor"] * np.array(target_xy) if target_xy else None,
        region=scan["region"],
        gap_m=gap_m,
        stem_gap_m=stem_gap_m,
        min_density=min_density,
    )
    write_cloud(contracted, points)
    write_json(target, target_report(details.pop("choice"), **scan))
    write_json(report, {"preset": preset, **details})


def weight(text):
    """Parse one ``class:lambda``."""
    name, value = text.split(":")
    return name, float(value)


class Weights(dict):
    """The weights of the command line as one dict."""

    def __init__(self, text):
        super().__init__(weight(part) for part in text.split(","))


parser = stage_parser(__doc__)
parser.add_argument("--segmented", required=True, help="labelled cloud")
parser.add_argument("--metric", default=None, help="metric.json of a tree from photos")
parser.add_argument("--target", required=True, help="which tree it is, and the others, JSON")
parser.add_argument(
    "--target_xy", type=float, nargs=2, help="where the target stands, aligned frame"
)
parser.add_argument("--contracted", required=True, help="contracted points, PLY")
parser.add_argument("--report", required=True, help="what was cut, and how it went, JSON")
parser.add_argument("--classes", type=int, nargs="+", default=[1, 2], help="classes that enter")
parser.add_argument("--weights", type=Weights, default=None, help="as trunk:10,branch:1")
parser.add_argument("--method", choices=["lbc", "slbc"], default="slbc")
parser.add_argument("--preset", choices=["paper", "default"], default="default")
parser.add_argument("--voxel_size_m", type=float, default=0.008)
parser.add_argument("--max_points", type=int, default=100_000)
parser.add_argument("--gap_m", type=float, default=0.25)
parser.add_argument("--stem_gap_m", type=float, default=0.6)
parser.add_argument("--min_density", type=float, default=0.05)
for constant in (
    "initial_contraction",
    "initial_attraction",
    "amplification",
    "max_contraction",
    "max_attraction",
    "min_weight",
    "termination_ratio",
    "termination_move",
    "mollify_factor",
):
    parser.add_argument(f"--{constant}", type=float, default=None, help="the preset's if left out")
for constant in ("max_iterations", "n_neighbors"):
    parser.add_argument(f"--{constant}", type=int, default=None, help="the preset's if left out")
run(main, parser, globals().get("snakemake"))
