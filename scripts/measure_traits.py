"""Measure a tree's traits on its skeleton and its labelled cloud.

Reads skeleton.graphml, topology.graphml, segmented.ply and target.json, and for a scan from photos
scale.json, metric_poses.npz, sfm/report.json, the sky masks and the sparse model's cameras (with
hand corrections edits.json); writes traits.json and branches.csv. Example:

    python scripts/measure_traits.py --skeleton skeleton.graphml --topology topology.graphml \\
        --segmented segmented.ply --traits traits.json --branches branches.csv
"""

from pathlib import Path

from cherrypicker.files import read_json, write_json, write_text
from cherrypicker.mvs.clear_sky import SkyMasks
from cherrypicker.pointcloud import read_cloud
from cherrypicker.poses import read_poses
from cherrypicker.runner import run, stage_parser
from cherrypicker.skeleton import read_skeleton, read_topology
from cherrypicker.traits.branches import branches_csv
from cherrypicker.traits.measure import TraitOptions, measure_traits


def main(
    skeleton,
    topology,
    segmented,
    traits,
    branches,
    scale=None,
    sparse=None,
    target=None,
    edits=None,
    metric_poses=None,
    sky_masks=None,
    cameras=None,
    *,
    options: TraitOptions,
    seed: int = 0,
):
    cloud = read_cloud(segmented, required=("label",))
    poses = read_poses(metric_poses) if metric_poses else None
    masks = SkyMasks(sky_masks, Path(cameras).parent, poses.names) if sky_masks else None
    numbers, rows = measure_traits(
        read_skeleton(skeleton),
        cloud,
        read_topology(topology),
        scale=read_json(scale) if scale else None,
        sparse=read_json(sparse) if sparse else None,
        target=read_json(target) if target else None,
        edits=read_json(edits) if edits else None,
        poses=poses,
        sky_masks=masks,
        seed=seed,
        **vars(options),
    )
    write_text(branches, branches_csv(rows))
    write_json(traits, numbers)


parser = stage_parser(__doc__)
parser.add_argument("--skeleton", required=True, help="skeleton.graphml")
parser.add_argument("--topology", required=True, help="topology.graphml")
parser.add_argument("--segmented", required=True, help="labelled cloud")
parser.add_argument("--scale", help="scale.json of a scan from photos")
parser.add_argument("--sparse", help="sfm/report.json of a scan from photos")
parser.add_argument("--target", help="target.json: which tree it is, and the others")
parser.add_argument("--metric_poses", help="poses in the segmented cloud's frame")
parser.add_argument("--sky_masks", help="folder of sky masks of a scan from photos")
parser.add_argument("--cameras", help="cameras.bin of the photos as stored, for the sky masks")
parser.add_argument("--edits", help="edits.json of a tree with hand corrections")
parser.add_argument("--traits", required=True, help="JSON to write")
parser.add_argument("--branches", required=True, help="CSV to write")
run(main, parser, globals().get("snakemake"))
