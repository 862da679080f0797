"""Grow the limbs of the trees of a cloud that came with labels.

Reads segmented.ply, writes limbs.npz: which wood hangs on which stem, and each stem's limbs. For
other clouds `segment_cloud` does this, since limbs tell it trunk from branch. Example:

    python scripts/grow_limbs.py --segmented segmented.ply --limbs limbs.npz
"""

from typing import Annotated

from cherrypicker.limbs.files import write_orchard
from cherrypicker.limbs.orchard import grow_orchard
from cherrypicker.pointcloud import read_cloud
from cherrypicker.runner import run, stage_parser
from cherrypicker.wood.thinned import GrowthOptions


def main(
    segmented: Annotated[str, "labelled cloud"],
    limbs: Annotated[str, "limbs.npz to write"],
    is_row: Annotated[bool, "the scan is of several trees"] = False,
    *,
    growth: GrowthOptions,
) -> None:
    cloud = read_cloud(segmented, required=("label",))
    write_orchard(limbs, grow_orchard(cloud, growth, is_row=is_row))


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
