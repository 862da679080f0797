"""Label every point of a metric cloud with the trained network.

Reads metric.ply and the network's weights, writes segmented.ply: the same points in the same order
with a label and a confidence. Example:

    python scripts/segment_cloud.py --cloud metric.ply --weights resources/weights/dgcnn.pt \
        --segmented segmented.ply
"""

from cherrypicker.pointcloud import read_cloud, write_cloud
from cherrypicker.runner import run, stage_parser
from cherrypicker.segmentation.dgcnn import choose_device
from cherrypicker.segmentation.inference import Sampling, segment_cloud
from cherrypicker.segmentation.refine import Smoothing
from cherrypicker.segmentation.stem_axis import StemModel
from cherrypicker.segmentation.support_post import PostModel


def main(
    cloud,
    weights,
    segmented,
    *,
    voxel_size_m,
    max_points,
    reference_height_m,
    sphere_radius_m,
    sphere_points,
    min_visits,
    batch_spheres,
    smooth_k,
    trunk_gap_m,
    trunk_base_height_m,
    split_post,
    post_min_height_m,
    post_max_tilt_deg,
    trace_stems,
    stem_gap_m,
    seed,
    threads,
    gpu,
):
    sampling = Sampling(
        voxel_size_m,
        max_points,
        reference_height_m,
        sphere_radius_m,
        sphere_points,
        min_visits,
        batch_spheres,
    )
    result = segment_cloud(
        read_cloud(cloud),
        weights,
        sampling=sampling,
        smoothing=Smoothing(smooth_k, trunk_gap_m, trunk_base_height_m),
        post=PostModel(post_min_height_m, max_tilt_deg=post_max_tilt_deg) if split_post else None,
        stems=StemModel(stem_gap_m=stem_gap_m) if trace_stems else None,
        seed=seed,
        device=choose_device(threads, gpu),
    )
    write_cloud(segmented, result)


parser = stage_parser(__doc__)
parser.add_argument("--cloud", required=True, help="metric.ply")
parser.add_argument("--weights", required=True, help="weights of train_segmentation")
parser.add_argument("--segmented", required=True, help="segmented.ply to write")
parser.add_argument("--voxel-size-m", type=float, help="as trained by default")
parser.add_argument("--max-points", type=int, default=4_000_000)
parser.add_argument("--reference-height-m", type=float, help="as trained by default")
parser.add_argument("--sphere-radius-m", type=float, help="as trained by default")
parser.add_argument("--sphere-points", type=int, help="as trained by default")
parser.add_argument("--min-visits", type=int, default=2)
parser.add_argument("--batch-spheres", type=int, default=16)
parser.add_argument("--smooth-k", type=int, default=12)
parser.add_argument("--trunk-gap-m", type=float, default=0.25)
parser.add_argument("--trunk-base-height-m", type=float, default=0.5)
parser.add_argument("--no-split-post", dest="split_post", action="store_false")
parser.add_argument("--post-min-height-m", type=float, default=0.6)
parser.add_argument("--post-max-tilt-deg", type=float, default=8.0)
parser.add_argument("--no-trace-stems", dest="trace_stems", action="store_false")
parser.add_argument("--stem-gap-m", type=float, default=0.6)
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--threads", type=int, default=2)
parser.add_argument("--gpu", type=int, default=0, help="1 to use an NVIDIA GPU")
run(main, parser, globals().get("snakemake"))
