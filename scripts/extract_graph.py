"""Make the skeleton and the topology graph from the contracted points.

Reads contracted.ply, contract.json, limbs.npz and segmented.ply, writes skeleton.graphml,
skeleton.ply, skeleton.swc and topology.graphml (the last three where a path is given). Example:

    python scripts/extract_graph.py --contracted contracted.ply --contract_report contract.json \
        --limbs limbs.npz --segmented segmented.ply --skeleton_graph skeleton.graphml \
        --skeleton_ply skeleton.ply --skeleton_swc skeleton.swc --topology topology.graphml
"""

from typing import Annotated

from cherrypicker.files import read_json
from cherrypicker.graph.extract import GraphOptions, extract_skeleton
from cherrypicker.limbs.files import read_limbs
from cherrypicker.pointcloud import read_cloud
from cherrypicker.runner import run, stage_parser
from cherrypicker.skeleton import (
    axes,
    fold,
    node_order,
    write_skeleton_graphml,
    write_skeleton_ply,
    write_skeleton_swc,
    write_topology_graphml,
)


def main(
    contracted: Annotated[str, "contracted points, PLY"],
    segmented: Annotated[str, "labelled cloud that they come from"],
    skeleton_graph: Annotated[str, "skeleton.graphml"],
    skeleton_ply: Annotated[str | None, "skeleton.ply"] = None,
    skeleton_swc: Annotated[str | None, "skeleton.swc"] = None,
    topology: Annotated[str | None, "topology.graphml"] = None,
    contract_report: Annotated[str | None, "contract.json, for the stem's base"] = None,
    limbs: Annotated[str | None, "limbs.npz of the contraction; else they are grown"] = None,
    *,
    options: GraphOptions,
) -> None:
    """Load, extract, save."""
    skeleton = extract_skeleton(
        read_cloud(contracted, required=("label", "source")),
        read_cloud(segmented, required=("label",)),
        options,
        base=read_json(contract_report)["base"] if contract_report else None,
        limbs=read_limbs(limbs) if limbs else None,
    )
    axis_list = axes(skeleton)
    if skeleton_ply:
        write_skeleton_ply(skeleton_ply, skeleton, node_order(skeleton, axis_list))
    if skeleton_swc:
        write_skeleton_swc(skeleton_swc, skeleton)
    if topology:
        write_topology_graphml(topology, fold(skeleton, axis_list))
    write_skeleton_graphml(skeleton_graph, skeleton)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
