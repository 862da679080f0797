"""Write the paper's systematic set of trees to files: fir, larch and pine in turn.

Per tree a folder with noise.ply and holes.ply (labelled trunk and branch, as segmented.ply),
skeleton.csv (the truth) and tree.json. Example:

    python scripts/lab/make_skeleton_set.py --n_trees 50 \\
        --index results/orchard/skeletons/index.json
"""

from pathlib import Path
from typing import Annotated

import numpy as np

import lab_path  # noqa: F401
from cherrypicker.files import write_json
from cherrypicker.pointcloud import write_cloud
from cherrypicker.progress import Progress
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.orchard.skeleton_set import (
    DENSITY,
    HOLE_RADIUS_M,
    NOISE_M,
    SIGMA_D_M,
    VOXEL_M,
    make_set_tree,
)
from cherrypicker_lab.orchard.truth import tree_traits, write_skeleton


def main(
    index: Annotated[str, "JSON to write, in the folder of the set"],
    seed: Annotated[int, "of the set"] = 0,
    n_trees: Annotated[int, "of the set"] = 50,
) -> None:
    """Write all trees, then the index."""
    folder = Path(index).parent
    names = []
    with Progress(n_trees, "trees of the set") as bar:
        for number in range(n_trees):
            made = make_set_tree(seed, number)
            here = folder / made.name
            here.mkdir(parents=True, exist_ok=True)
            for kind, cloud in (("noise", made.noise), ("holes", made.holes)):
                confidence = np.ones(len(cloud), np.float32)
                write_cloud(here / f"{kind}.ply", cloud.with_fields(confidence=confidence))
            write_skeleton(here / "skeleton.csv", made.skeleton)
            traits = tree_traits(made.tree)
            write_json(
                here / "tree.json",
                {"template": made.template, "hole_centres": made.hole_centres, "traits": traits},
            )
            names.append(made.name)
            bar.step()
    write_json(
        index,
        {
            "seed": seed, "trees": names, "samples_per_m2": DENSITY, "sigma_d_m": SIGMA_D_M,
            "noise_m": NOISE_M, "voxel_m": VOXEL_M, "hole_radius_m": HOLE_RADIUS_M,
        },
    )  # fmt: skip


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
