"""Contract a tree of the paper's set with a trunk of a given radius by LBC and S-LBC.

Makes the tree itself; writes the Chamfer distances as JSON. Example:

    python scripts/lab/measure_trunk_ratio.py --number 0 --trunk_radius 0.12 --scores scores.json
"""

from collections.abc import Sequence
from typing import Annotated

import lab_path  # noqa: F401
from cherrypicker.contraction.contract_points import ATTRACTION_RULES
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.orchard.skeleton_set import make_set_tree
from cherrypicker_lab.skeletons.trunk_ratio import measure_trunk


def main(
    scores: Annotated[str, "JSON to write"],
    number: Annotated[int, "of the tree in the set"],
    trunk_radius: Annotated[float, "above the root flare, m"],
    rules: Annotated[Sequence[str], ", ".join(ATTRACTION_RULES)] = ATTRACTION_RULES,
    seed: Annotated[int, "of the set"] = 0,
) -> None:
    """Make the tree, measure both settings, save."""
    tree = make_set_tree(seed, number, trunk_radius=trunk_radius)
    clouds = {"noise": tree.noise, "holes": tree.holes}
    report = {
        setting: measure_trunk(cloud, tree.skeleton, rules) for setting, cloud in clouds.items()
    }
    write_json(scores, {"tree": tree.name, "trunk_radius": trunk_radius, "settings": report})


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
