"""Contract a tree of the paper's set with a trunk of a given radius by LBC and S-LBC.

Makes the tree itself; writes the Chamfer distances as JSON. Example:

    python scripts/lab/measure_trunk_ratio.py --number 0 --trunk_radius 0.12 --scores scores.json
"""

import lab_path  # noqa: F401
from cherrypicker.contraction.contract_points import ATTRACTION_RULES
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.orchard.skeleton_set import make_set_tree
from cherrypicker_lab.skeletons.trunk_ratio import measure_trunk


def main(scores, *, number, trunk_radius, rules=ATTRACTION_RULES, seed=0):
    """Make the tree, measure both settings, save."""
    tree = make_set_tree(seed, number, trunk_radius=trunk_radius)
    clouds = {"noise": tree.noise, "holes": tree.holes}
    report = {
        setting: measure_trunk(cloud, tree.skeleton, rules) for setting, cloud in clouds.items()
    }
    write_json(scores, {"tree": tree.name, "trunk_radius": trunk_radius, "settings": report})


parser = stage_parser(__doc__)
parser.add_argument("--number", type=int, required=True, help="of the tree in the set")
parser.add_argument("--trunk_radius", type=float, required=True, help="above the root flare, m")
parser.add_argument("--rules", nargs="*", choices=ATTRACTION_RULES, default=ATTRACTION_RULES)
parser.add_argument("--seed", type=int, default=0, help="of the set")
parser.add_argument("--scores", required=True, help="JSON to write")
run(main, parser, globals().get("snakemake"))
