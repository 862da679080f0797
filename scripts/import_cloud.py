"""Import a ready point cloud: metres and z up, the same points in the same order.

Reads PLY, LAS, LAZ or text, writes metric.ply, or segmented.ply for a PLY that has labels. Example:

    python scripts/import_cloud.py --cloud scan.laz --unit m --imported metric.ply
"""

from cherrypicker.placement.late_cloud import import_cloud
from cherrypicker.pointcloud import write_cloud
from cherrypicker.runner import run, stage_parser


def main(cloud, imported, *, unit, up, scale):
    write_cloud(imported, import_cloud(cloud, unit=unit, up=up, scale=scale))


parser = stage_parser(__doc__)
parser.add_argument("--cloud", required=True, help="the ready cloud")
parser.add_argument("--imported", required=True, help="PLY to write")
parser.add_argument("--unit", default="m", help="m, cm, mm, ft or metres per unit")
parser.add_argument("--up", default="z", help="axis of the file that points up")
parser.add_argument("--scale", default="", help="metres per unit, or none")
run(main, parser, globals().get("snakemake"))
