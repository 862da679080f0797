"""Traits and limbs of generated trees beside their truth: what the benchmark measures of a tree."""

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from cherrypicker.traits.measure import measure_traits
from cherrypicker.traits.reports import Reports
from cherrypicker_lab.orchard.skeleton_set import make_set_tree
from cherrypicker_lab.orchard.truth import tree_traits
from cherrypicker_lab.traits.cases import tree_cases, true_scaffold, whole_truth
from cherrypicker_lab.traits.pairs import as_pair, make_tree, skeleton_of

NEAR_LIMB_M = 0.03  # and its diameter more: how far off a limb may be measured
N_TOP, SAME_M = 3, 0.002  # limbs that count, and what a calliper cannot tell of their diameters


def measure_grown(source, number, n_points):
    """Grow a tree, measure it as the workflow's stages do, and put the truth beside it.

    The source is ``thin`` or ``bearing``, trees of the orchard as cameras see them, or ``conifer``:
    a fir, larch or pine of the paper's set, its points noisy and one a voxel, with holes in the
    stem where `number` is odd. The number is the seed of a tree of the orchard, whose cloud has
    `n_points`, or that of a conifer.

    Returns `source`, `seed`, `cases` of `tree_cases` and of the limbs' ratio, as a share of the
    truth, to which no factor is fitted, and `limbs` of `judge_limbs`.
    """
    if source == "conifer":
        made = make_set_tree(0, number)
        tree, cloud = made.tree, made.holes if number % 2 else made.noise
    else:
        tree, cloud = make_tree(number, n_points, bearing=source == "bearing")
    skeleton, target = skeleton_of(cloud)
    traits, tables = measure_traits(skeleton, cloud, reports=Reports(target=target))
    true = tree.skeleton()
    cases = tree_cases(
        source, str(number), whole_truth(true), true, skeleton, traits, tables["branches"]
    )
    limbs = sorted(true_scaffold(true).limbs, key=lambda limb: -limb.diameter)
    ratio = sum(limb.diameter**2 for limb in limbs) / tree_traits(tree)["trunk_diameter_m"] ** 2
    found = traits["limb_trunk_ratio"], *traits.get("limb_trunk_ratio_ci90", (None, None))
    pair = {k: v and v / ratio for k, v in as_pair(ratio, *found).items()}
    cases.append({"trait": "limb_trunk_ratio", **pair})
    judged = judge_limbs(limbs, skeleton, tables["limbs"])
    return {"source": source, "seed": int(number), "cases": cases, "limbs": judged}


def judge_limbs(limbs, skeleton, rows):
    """Whether the three thickest limbs are the true three, and how many limbs there are.

    A limb is the true one whose place of measure lies nearest, one to one: two measure the same
    wood there, whatever way a skeleton makes to it from the stem. The true limbs and the rows of
    ``limbs.csv`` have the thickest first; the skeleton is as found.

    Returns `n_true`, `n_found`; `are_three` whether the three thickest found are the three thickest
    true ones, `are_three_to_2mm` whether they are three that no true limb outdoes by more than 2
    mm; `diameters`, a list of the pairs of the limbs that were matched.
    """
    place_of = {limb.axis: limb.place for limb in true_scaffold(skeleton).limbs}
    places = [place_of.get(row["branch_id"], np.full(3, np.inf)) for row in rows]
    diameters = np.array([limb.diameter for limb in limbs])
    far = cdist(np.reshape([limb.place for limb in limbs], (-1, 3)), np.reshape(places, (-1, 3)))
    far /= NEAR_LIMB_M + diameters[:, None]
    far[far > 1.0] = len(far) + 1.0  # no miss is worth a match
    matched = [(i, j) for i, j in zip(*linear_sum_assignment(far), strict=True) if far[i, j] <= 1.0]
    true_of = {j: i for i, j in matched}
    top = [true_of.get(j) for j in range(min(N_TOP, len(rows)))]
    n_top = min(N_TOP, len(limbs))
    least = diameters[n_top - 1] - SAME_M if n_top else 0.0
    low_high = ("diameter_m", "diameter_low_m", "diameter_high_m")
    return {
        "n_true": len(limbs),
        "n_found": len(rows),
        "are_three": sorted(top, key=str) == sorted(range(n_top), key=str),
        "are_three_to_2mm": len(top) == n_top
        and all(i is not None and bool(diameters[i] >= least) for i in top),
        "diameters": [
            as_pair(diameters[i], *(rows[j][name] for name in low_high)) for i, j in matched
        ],
    }
