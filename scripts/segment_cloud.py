"""Label every point of a metric cloud with the trained network, and grow the limbs of its trees.

Reads metric.ply and the weights of the network (the shipped ones unless others are given), and for
a tree from photos scale.json and align.json, which say where its markers stand, and metric.json,
which says where the cameras looked and how large a pixel is there; writes segmented.ply: the same
points in the same order with a label and a confidence, and limbs.npz: which wood hangs on which
stem, and each stem's limbs.
Example:

    python scripts/segment_cloud.py --cloud metric.ply --segmented segmented.ply --limbs limbs.npz
"""

from pathlib import Path
from typing import Annotated

from cherrypicker.files import read_json
from cherrypicker.limbs.files import write_orchard
from cherrypicker.placement.footprint import read_region
from cherrypicker.pointcloud import read_cloud, write_cloud
from cherrypicker.runner import run, stage_parser
from cherrypicker.segmentation.dgcnn import choose_device
from cherrypicker.segmentation.inference import Sampling, segment_cloud
from cherrypicker.segmentation.known_markers import known_markers
from cherrypicker.wood.thinned import GrowthOptions

SHIPPED = Path(__file__).resolve().parents[1] / "resources/weights/dgcnn.pt"


def main(
    cloud: Annotated[str, "metric.ply"],
    segmented: Annotated[str, "segmented.ply to write"],
    limbs: Annotated[str, "limbs.npz to write"],
    scale: Annotated[str | None, "scale.json, which knows where the markers stand"] = None,
    align: Annotated[str | None, "align.json, from the markers' frame to the cloud's"] = None,
    metric: Annotated[str | None, "metric.json, which knows the region of interest"] = None,
    is_row: Annotated[bool, "the scan is of several trees"] = False,
    *,
    weights: str | None = None,
    smooth_k: int = 12,
    labels: str = "limbs",
    growth: GrowthOptions,
    seed: int = 0,
    threads: int = 2,
    gpu: int = 0,
) -> None:
    result, orchard = segment_cloud(
        read_cloud(cloud),
        weights or SHIPPED,
        sampling=Sampling(smooth_k),
        growth=growth,
        region=read_region(metric),
        is_row=is_row,
        pixel=read_json(metric).get("pixel") if metric else None,
        markers=known_markers(read_json(scale), read_json(align)) if scale and align else None,
        by=labels,
        seed=seed,
        device=choose_device(threads, gpu),
    )
    write_cloud(segmented, result)
    write_orchard(limbs, orchard)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
