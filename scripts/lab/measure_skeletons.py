"""Contract a tree of the paper's set in every setting, extract graphs, and score them.

Makes the tree itself; writes the scores as JSON.
With --peer_python it runs pc-skeletor instead of our methods, with --pytlidar_python PyTLidar.
Example:

    python scripts/lab/measure_skeletons.py --number 0 --methods lbc_paper slbc_default \\
        --scores scores.json
"""

from collections.abc import Sequence
from typing import Annotated

import lab_path  # noqa: F401
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.orchard.skeleton_set import make_set_tree
from cherrypicker_lab.skeletons.methods import OURS, SETTINGS, measure_cloud, start_up
from cherrypicker_lab.skeletons.peer import measure_peer, measure_pytlidar
from cherrypicker_lab.skeletons.true_tree import TrueTree


def main(
    scores: Annotated[str, "JSON to write"],
    number: Annotated[int, "of the tree in the set"],
    methods: Annotated[Sequence[str], ", ".join(OURS)] = OURS,
    peer_python: Annotated[str, "Python that has pc-skeletor"] = "",
    pytlidar_python: Annotated[str, "Python that has PyTLidar"] = "",
    seed: Annotated[int, "of the set"] = 0,
) -> None:
    """Make the tree, measure it in every setting, save."""
    tree = make_set_tree(seed, number)
    clouds, truth = {"noise": tree.noise, "holes": tree.holes}, TrueTree(tree.skeleton)
    report = {}
    if not peer_python and not pytlidar_python:
        start_up(clouds["noise"])
    for setting in SETTINGS:
        if peer_python:
            report[setting] = measure_peer(peer_python, clouds[setting], truth)
        elif pytlidar_python:
            report[setting] = measure_pytlidar(pytlidar_python, clouds[setting], truth)
        else:
            report[setting] = measure_cloud(clouds[setting], truth, methods)
    write_json(scores, {"tree": tree.name, "template": tree.template, "settings": report})


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
