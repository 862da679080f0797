"""Write a tree's report: one page with numbers, figures and a 3D view, and the figures as PNG.

Reads the tree's traits, graphs and clouds and, for a scan from photos, what its stages reported;
writes report.html and PNG figures. Example (a ready cloud; a scan from photos adds --sparse etc.):

    python scripts/report_tree.py --tree cherry --traits traits.json --branches branches.csv \\
        --skeleton skeleton.graphml --topology topology.graphml --segmented segmented.ply \\
        --contracted contracted.ply --report report.html --cloud_figure figures/cloud.png \\
        --label_figure figures/labels.png --skeleton_figure figures/skeleton.png \\
        --topology_figure figures/topology.png --trunk_figure figures/trunk.png \\
        --thumbnail_figure figures/thumbnail.png
"""

from cherrypicker.report.tree import report_tree
from cherrypicker.runner import run, stage_parser


def main(
    *,
    viewer_points: int = 150_000,
    figure_width_px: int = 1400,
    n_examples: int = 3,
    seed: int = 0,
    **files,
):
    report_tree(
        **files,
        viewer_points=viewer_points,
        figure_width_px=figure_width_px,
        n_examples=n_examples,
        seed=seed,
    )


parser = stage_parser(__doc__)
for name in ("tree", "traits", "branches", "skeleton", "topology", "segmented", "contracted"):
    parser.add_argument(f"--{name}", required=True, help="the tree's id or its result to read")
for name in ("report", "cloud", "label", "skeleton", "topology", "trunk", "thumbnail"):
    option = name if name == "report" else f"{name}_figure"
    parser.add_argument(f"--{option}", required=True, help="file to write")
parser.add_argument("--contract_report", help="contract.json")
parser.add_argument("--target", help="target.json")
parser.add_argument("--sparse", help="sfm/report.json of a scan from photos")
parser.add_argument("--align_report", help="align.json")
parser.add_argument("--crop_report", help="crop.json")
parser.add_argument("--denoise_report", help="denoise.json")
parser.add_argument("--scale", help="scale.json")
parser.add_argument("--poses", help="poses in COLMAP's frame")
parser.add_argument("--cameras", help="cameras.bin in the folder of the sparse model")
parser.add_argument("--metric_poses", help="poses in the segmented cloud's frame")
parser.add_argument("--aligned", help="aligned cloud")
parser.add_argument("--aligned_poses", help="poses in the aligned cloud's frame")
parser.add_argument("--cropped", help="cropped cloud")
parser.add_argument("--denoised", help="denoised cloud")
parser.add_argument("--sky_colors", help="sky_colors.npz, beside the folder sky/ of masks")
parser.add_argument("--depth", help="dense/depth.json, beside the depth maps")
parser.add_argument("--coverage", help="dense/coverage.json")
parser.add_argument("--photos", nargs="*", default=[], help="the photos")
parser.add_argument("--date", default="")
parser.add_argument("--series", default="")
run(main, parser, globals().get("snakemake"))
