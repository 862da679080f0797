"""Make the skeleton and the topology graph from the contracted points.

Reads contracted.ply, contract.json, limbs.npz and segmented.ply, and for a scan from photos the
undistorted photos' cameras, metric_poses.npz, what each photo shows (evidence) and how far that is
(depth), which refute what is not there; writes skeleton.graphml, skeleton.ply, skeleton.swc,
topology.graphml and graph.json (the last four where a path is given). With the method limbs the
points are taken where they were before they moved, with slbc and lbc where the contraction put
them. Example:

    python scripts/extract_graph.py --contracted contracted.ply --contract_report contract.json \
        --limbs limbs.npz --segmented segmented.ply --skeleton_graph skeleton.graphml \
        --skeleton_ply skeleton.ply --skeleton_swc skeleton.swc --topology topology.graphml
"""

from typing import Annotated

from cherrypicker.classes import wood_mask
from cherrypicker.files import read_json, write_json
from cherrypicker.formats.swc import write_skeleton_swc
from cherrypicker.graph.extract import GraphOptions, extract_skeleton
from cherrypicker.limbs.files import read_orchard
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.photo_check.drop import drop_refuted as drop
from cherrypicker.pointcloud import read_cloud
from cherrypicker.poses import read_poses
from cherrypicker.runner import run, stage_parser
from cherrypicker.skeleton import (
    write_skeleton_graphml,
    write_skeleton_ply,
    write_topology_graphml,
)


def main(
    contracted: Annotated[str, "contracted points, PLY"],
    contract_report: Annotated[str, "contract.json: which stem, and its base"],
    limbs: Annotated[str, "limbs.npz of the cloud's trees"],
    segmented: Annotated[str, "labelled cloud that they come from"],
    skeleton_graph: Annotated[str, "skeleton.graphml"],
    skeleton_ply: Annotated[str | None, "skeleton.ply"] = None,
    skeleton_swc: Annotated[str | None, "skeleton.swc"] = None,
    topology: Annotated[str | None, "topology.graphml"] = None,
    cameras: Annotated[str | None, "poses.npz of the undistorted photos"] = None,
    metric_poses: Annotated[str | None, "poses in the labelled cloud's frame"] = None,
    evidence: Annotated[str | None, "folder of what each photo shows"] = None,
    depth: Annotated[str | None, "folder of the depths of each photo"] = None,
    report: Annotated[str | None, "graph.json: what the photos refuted"] = None,
    *,
    options: GraphOptions,
    drop_refuted: bool = True,
    seed: int = 0,
) -> None:
    points = read_cloud(contracted, required=("label", "source"))
    contraction, grown = read_json(contract_report), None
    if options.method == "limbs":
        grown = read_orchard(limbs).limbs_of(contraction["stem"], points["source"])
    cloud = read_cloud(segmented, required=("label",))
    skeleton = extract_skeleton(points, cloud, options, base=contraction["base"], limbs=grown)
    refuted = None
    if drop_refuted and cameras and metric_poses and evidence:
        poses = read_poses(metric_poses)
        photos = ScanPhotos(read_poses(cameras), evidence, poses, depth=depth)
        wood = cloud.points[wood_mask(cloud["label"])]
        skeleton, refuted = drop(skeleton, photos, wood, seed=seed)
    if skeleton_ply:
        write_skeleton_ply(skeleton_ply, skeleton)
    if skeleton_swc:
        write_skeleton_swc(skeleton_swc, skeleton)
    if report:
        write_json(report, {"unit": skeleton.unit, "refuted": refuted})
    write_skeleton_graphml(skeleton_graph, skeleton)
    if topology:
        write_topology_graphml(topology, skeleton)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
