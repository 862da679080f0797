"""Rows of trees with touching crowns beside their truth: whose wood is whose, and what is measured.

A row is grown, seen from both alleys by simulated photos, shared out among its trees, and each tree
measured by the functions that the workflow's stages call. Labels are the true ones.
"""

import numpy as np

from cherrypicker.classes import wood_mask
from cherrypicker.limbs.orchard import MOST_POINTS
from cherrypicker.traits.measure import measure_traits
from cherrypicker.wood.row import find_trees, rows_of_tree
from cherrypicker.wood.target_wood import share_cloud
from cherrypicker.wood.thinned import GrowthOptions
from cherrypicker_lab.orchard.rows import row_cloud, row_scene
from cherrypicker_lab.orchard.scene.mesh import NO_TREE
from cherrypicker_lab.orchard.truth import tree_traits
from cherrypicker_lab.skeletons.methods import find_skeleton

MEASURED = ("height_m", "trunk_diameter_m", "total_length_m")


def measure_row(seed, n_points):
    """Share a row out among its trees and measure each; the seed decides all, the forms take turns.

    Returns ``seed``, ``habit``, ``spacing_m``, ``n_left_out``, and ``trees``: a row a true tree,
    that of `share_scores` with ``{trait}`` and ``{trait}_true`` where it was found.
    """
    scene = row_scene(seed)
    cloud = row_cloud(scene, n_points)
    found = find_trees(cloud, share_cloud(cloud, GrowthOptions(), MOST_POINTS))
    wood = wood_mask(cloud["label"])
    stands = np.array([tree.base for tree in found.trees])
    rows = share_scores(found.owner[wood], cloud["tree"][wood], stands, scene.offsets)
    for row in rows:
        if row["number"]:
            foot = found.trees[row["number"] - 1].base
            own = cloud.select(rows_of_tree(cloud.points, found.owner, row["number"], foot))
            skeleton, _ = find_skeleton(own, target_xy=foot[:2])
            traits, true = measure_traits(skeleton, own)[0], tree_traits(scene.trees[row["tree"]])
            row |= {name: traits[name] for name in MEASURED}
            row |= {f"{name}_true": true[name] for name in MEASURED}
    return {
        "seed": int(seed),
        "habit": scene.target.habit,
        "spacing_m": float(np.diff(np.sort(scene.offsets[:, 0])).mean()),
        "n_left_out": len(found.left_out),
        "trees": rows,
    }


def totals_of(trees):
    """``least_iou`` and ``most_wrong`` of rows of true trees, ``trunk_mae_m`` of those found."""
    off = [abs(t["trunk_diameter_m"] - t["trunk_diameter_m_true"]) for t in trees if t["number"]]
    return {
        "least_iou": min(tree["iou"] for tree in trees),
        "most_wrong": max(tree["wrong"] for tree in trees),
        "trunk_mae_m": float(np.mean(off)),
    }


def share_scores(owner, tree, stands, feet):
    """How well points are shared out among trees.

    `owner` (n,) is the number of the tree that each point was given to, from 1, 0 and less for
    none; `tree` (n,) is its true tree, from 0, `NO_TREE` for none. `stands` and `feet`, (k, 2 or
    3), are the feet of the trees that were found, in the order of their numbers, and the true ones.

    Returns for each true tree ``tree``, ``number`` (of the tree found nearest to its foot; 0 where
    that is nearer to another), ``iou`` of points, and ``wrong``: the share of its points that are
    another tree's.
    """
    apart = np.linalg.norm(feet[:, None, :2] - stands[None, :, :2], axis=2)
    rows = []
    for i in range(len(feet)):
        number = int(apart[i].argmin()) + 1
        if apart[:, number - 1].argmin() != i:
            rows.append({"tree": i, "number": 0, "iou": 0.0, "wrong": 0.0})
            continue
        own, true = owner == number, tree == i
        iou = np.count_nonzero(own & true) / np.count_nonzero(own | true)
        wrong = np.count_nonzero(own & ~true & (tree != NO_TREE)) / np.count_nonzero(own)
        rows.append({"tree": i, "number": number, "iou": float(iou), "wrong": float(wrong)})
    return rows
