"""Contract a tree of the paper's set in every setting, extract graphs, and score them.

Makes the tree itself; writes the scores as JSON.
With --peer_python it runs pc-skeletor instead of our methods, with --pytlidar_python PyTLidar.
Example:

    python scripts/lab/measure_skeletons.py --number 0 --methods lbc_paper slbc_default \\
        --scores scores.json
"""

import lab_path  # noqa: F401
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.orchard.skeleton_set import make_set_tree
from cherrypicker_lab.skeletons.methods import OURS, SETTINGS, measure_cloud, start_up
from cherrypicker_lab.skeletons.peer import measure_peer, measure_pytlidar
from cherrypicker_lab.skeletons.true_tree import TrueTree


def main(
    scores,
    *,
    number,
    methods=(),
    settings=SETTINGS,
    peer_python="",
    pytlidar_python="",
    seed=0,
):
    """Make the tree, measure it in every setting, save."""
    tree = make_set_tree(seed, number)
    clouds, truth = {"noise": tree.noise, "holes": tree.holes}, TrueTree(tree.skeleton)
    report = {}
    if not peer_python and not pytlidar_python:
        start_up(clouds["noise"])
    for setting in settings:
        if peer_python:
            report[setting] = measure_peer(peer_python, clouds[setting], truth)
        elif pytlidar_python:
            report[setting] = measure_pytlidar(pytlidar_python, clouds[setting], truth)
        else:
            report[setting] = measure_cloud(clouds[setting], truth, methods)
    write_json(scores, {"tree": tree.name, "template": tree.template, "settings": report})


parser = stage_parser(__doc__)
parser.add_argument("--number", type=int, required=True, help="of the tree in the set")
parser.add_argument("--methods", nargs="*", choices=OURS, default=OURS)
parser.add_argument("--settings", nargs="+", choices=SETTINGS, default=SETTINGS)
parser.add_argument("--peer_python", default="", help="Python that has pc-skeletor")
parser.add_argument("--pytlidar_python", default="", help="Python that has PyTLidar")
parser.add_argument("--seed", type=int, default=0, help="of the set")
parser.add_argument("--scores", required=True, help="JSON to write")
run(main, parser, globals().get("snakemake"))
