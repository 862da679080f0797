"""Write a tree's report: one page with numbers, figures and a 3D view, and the figures as PNG.

Reads the tree's traits, graphs and clouds and, for a scan from photos, what its stages reported;
writes report.html and PNG figures. Example (a ready cloud; a scan from photos adds --sparse etc.):

    python scripts/report_tree.py --tree cherry --traits traits.json --branches branches.csv \\
        --skeleton skeleton.graphml --segmented segmented.ply --contracted contracted.ply \\
        --report report.html --cloud_figure figures/cloud.png \\
        --label_figure figures/labels.png --skeleton_figure figures/skeleton.png \\
        --topology_figure figures/topology.png --trunk_figure figures/trunk.png \\
        --thumbnail_figure figures/thumbnail.png
"""

from collections.abc import Sequence
from typing import Annotated

from cherrypicker.photos import photo_files
from cherrypicker.report.tree import CAPTIONS, FILES, ReportOptions, report_tree
from cherrypicker.runner import run, stage_parser


def main(
    tree: Annotated[str, "the tree's id"],
    report: Annotated[str, "page to write"],
    photos: Annotated[Sequence[str], "the photos"] = (),
    date: Annotated[str, "of the scan, as in the table of trees"] = "",
    series: Annotated[str, "of the scan, as in the table of trees"] = "",
    lacking: Annotated[Sequence[str], "parts that failed and why, a line each"] = (),
    *,
    options: ReportOptions,
    **files: str,
) -> None:
    about = {"tree": tree, "date": date, "series": series}
    report_tree(about, report, files, options, photos=photo_files(photos or []), lacking=lacking)


parser = stage_parser(__doc__, main)
for name, file in FILES.items():
    parser.add_argument(f"--{name}", required=file.is_needed, help=file.text)
for name in (*CAPTIONS, "thumbnail"):
    parser.add_argument(f"--{name}_figure", required=True, help="PNG to write")
run(main, parser, globals().get("snakemake"))
