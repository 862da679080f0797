"""Label every point of a metric cloud with the trained network.

Reads metric.ply and the weights of the network (the shipped ones unless others are given), and for
a tree from photos scale.json and align.json, which say where its markers stand; writes
segmented.ply: the same points in the same order with a label and a confidence. Example:

    python scripts/segment_cloud.py --cloud metric.ply --segmented segmented.ply
"""

from pathlib import Path
from typing import Annotated

from cherrypicker.files import read_json
from cherrypicker.pointcloud import read_cloud, write_cloud
from cherrypicker.runner import run, stage_parser
from cherrypicker.segmentation.dgcnn import choose_device
from cherrypicker.segmentation.inference import Sampling, segment_cloud
from cherrypicker.segmentation.refine import Smoothing
from cherrypicker.segmentation.stems import StemModel
from cherrypicker.segmentation.support_post import PostModel
from cherrypicker.segmentation.things import solved_squares

SHIPPED = Path(__file__).resolve().parents[1] / "resources/weights/dgcnn.pt"


def main(
    cloud: Annotated[str, "metric.ply"],
    segmented: Annotated[str, "segmented.ply to write"],
    scale: Annotated[str | None, "scale.json, which knows where the markers stand"] = None,
    align: Annotated[str | None, "align.json, from the markers' frame to the cloud's"] = None,
    *,
    weights: str | None = None,
    sampling: Sampling,
    smoothing: Smoothing,
    split_post: bool = True,
    post: PostModel,
    trace_stems: bool = True,
    stems: StemModel,
    seed: int = 0,
    threads: int = 2,
    gpu: int = 0,
) -> None:
    result = segment_cloud(
        read_cloud(cloud),
        weights or SHIPPED,
        sampling=sampling,
        smoothing=smoothing,
        post=post if split_post else None,
        stems=stems if trace_stems else None,
        squares=solved_squares(read_json(scale), read_json(align)) if scale and align else None,
        seed=seed,
        device=choose_device(threads, gpu),
    )
    write_cloud(segmented, result)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
