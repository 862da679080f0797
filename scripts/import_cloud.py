"""Import a ready point cloud: metres and z up, the same points in the same order.

Reads PLY, LAS, LAZ or text, writes metric.ply, or segmented.ply for a PLY that has labels. Example:

    python scripts/import_cloud.py --cloud scan.laz --unit m --imported metric.ply
"""

from typing import Annotated

from cherrypicker.intake.clouds import HeightOptions, import_cloud
from cherrypicker.pointcloud import write_cloud
from cherrypicker.runner import run, stage_parser


def main(
    cloud: Annotated[str, "the ready cloud"],
    imported: Annotated[str, "PLY to write"],
    unit: Annotated[str, "m, cm, mm, ft or metres per unit"] = "m",
    up: Annotated[str, "axis of the file that points up"] = "z",
    scale: Annotated[str, "metres per unit, or none"] = "",
    *,
    heights: HeightOptions,
) -> None:
    write_cloud(imported, import_cloud(cloud, unit=unit, up=up, scale=scale, heights=heights))


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
