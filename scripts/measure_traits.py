"""Measure a tree's traits on its skeleton and its labelled cloud.

Reads skeleton.graphml, topology.graphml and segmented.ply, and for a scan from photos scale.json,
metric_poses.npz, sfm/report.json and crop.json (with hand corrections edits.json); writes
traits.json and branches.csv. Example:

    python scripts/measure_traits.py --skeleton skeleton.graphml --topology topology.graphml \\
        --segmented segmented.ply --traits traits.json --branches branches.csv
"""

from cherrypicker.files import read_json, write_json, write_text
from cherrypicker.pointcloud import read_cloud
from cherrypicker.poses import read_poses
from cherrypicker.runner import run, stage_parser
from cherrypicker.skeleton import read_skeleton, read_topology
from cherrypicker.traits import branches_csv, measure_traits
from cherrypicker.traits.other_stems import only_trees


def main(
    skeleton,
    topology,
    segmented,
    traits,
    branches,
    *,
    scale=None,
    sparse=None,
    crop=None,
    edits=None,
    metric_poses=None,
    **options,
):
    cloud = read_cloud(segmented, required=("label",))
    scale = read_json(scale) if scale else None
    numbers, rows = measure_traits(
        read_skeleton(skeleton),
        cloud,
        read_topology(topology),
        scale=scale,
        sparse=read_json(sparse) if sparse else None,
        crop=only_trees(read_json(crop), cloud, (scale or {}).get("scale")) if crop else None,
        edits=read_json(edits) if edits else None,
        poses=read_poses(metric_poses) if metric_poses else None,
        **options,
    )
    write_text(branches, branches_csv(rows))
    write_json(traits, numbers)


parser = stage_parser(__doc__)
parser.add_argument("--skeleton", required=True, help="skeleton.graphml")
parser.add_argument("--topology", required=True, help="topology.graphml")
parser.add_argument("--segmented", required=True, help="labelled cloud")
parser.add_argument("--scale", help="scale.json of a scan from photos")
parser.add_argument("--sparse", help="sfm/report.json of a scan from photos")
parser.add_argument("--crop", help="crop.json of a scan from photos")
parser.add_argument("--metric_poses", help="poses in the segmented cloud's frame")
parser.add_argument("--edits", help="edits.json of a tree with hand corrections")
parser.add_argument("--traits", required=True, help="JSON to write")
parser.add_argument("--branches", required=True, help="CSV to write")
parser.add_argument("--trunk_height", type=float, default=0.30, help="m over the foot")
parser.add_argument("--trunk_heights", type=float, nargs="*", default=[0.5, 1.0, 1.3], help="m")
parser.add_argument("--slab_half_height", type=float, default=0.10, help="m")
parser.add_argument("--min_points", type=int, default=60)
parser.add_argument("--min_arc_deg", type=float, default=120.0)
parser.add_argument("--max_gap", type=float, default=0.10, help="m")
parser.add_argument("--min_stray", type=float, default=0.30, help="m")
parser.add_argument("--n_bootstrap", type=int, default=200)
parser.add_argument("--seed", type=int, default=0)
run(main, parser, globals().get("snakemake"))
