"""Apply a tree's hand corrections to its solved skeleton.

Reads solved.graphml and the tree's edits, writes skeleton.graphml, skeleton.ply, skeleton.swc,
topology.graphml and edits.json, which names the edits that no longer find their place. Example:

    python scripts/edit_graph.py --solved solved.graphml --edits config/edits/tree.yaml \\
        --skeleton_graph skeleton.graphml --skeleton_ply skeleton.ply \\
        --skeleton_swc skeleton.swc --topology topology.graphml --report edits.json
"""

from typing import Annotated

from cherrypicker.files import write_json
from cherrypicker.formats.swc import write_skeleton_swc
from cherrypicker.runner import run, stage_parser
from cherrypicker.skeleton import (
    read_skeleton,
    write_skeleton_graphml,
    write_skeleton_ply,
    write_topology_graphml,
)
from cherrypicker.skeleton.edits import apply_edits, read_edits


def main(
    solved: Annotated[str, "the solver's skeleton, GraphML"],
    edits: Annotated[str, "the tree's hand corrections, YAML"],
    skeleton_graph: Annotated[str, "skeleton.graphml"],
    skeleton_ply: Annotated[str, "skeleton.ply"],
    skeleton_swc: Annotated[str, "skeleton.swc"],
    topology: Annotated[str, "topology.graphml"],
    report: Annotated[str, "what was applied and what was lost, JSON"],
) -> None:
    skeleton, details = apply_edits(read_skeleton(solved), read_edits(edits), edits)
    write_skeleton_ply(skeleton_ply, skeleton)
    write_skeleton_swc(skeleton_swc, skeleton)
    write_topology_graphml(topology, skeleton)
    write_skeleton_graphml(skeleton_graph, skeleton)
    write_json(report, details)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
