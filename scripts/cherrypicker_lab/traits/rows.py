"""Rows of trees with touching crowns beside their truth: whose wood is whose, and what is measured.

A row is grown, seen from both alleys by simulated photos, shared out among its trees, and each tree
measured by the functions that the workflow's stages call. Labels are the true ones.
"""

import numpy as np

from cherrypicker.classes import wood_mask
from cherrypicker.contraction.contract_points import ContractionOptions
from cherrypicker.contraction.contract_wood import contract_wood
from cherrypicker.graph.extract import extract_skeleton
from cherrypicker.pointcloud import PointCloud
from cherrypicker.traits.measure import measure_traits
from cherrypicker.wood.row import FoundTrees, find_trees, tree_cloud
from cherrypicker_lab.orchard.rows import row_cloud, row_scene
from cherrypicker_lab.orchard.truth import tree_traits

MEASURED = ("height_m", "trunk_diameter_m", "total_length_m")


def measure_row(seed, n_points=300_000, *, spacing=None):
    """Share a row out among its trees and measure each.

    Parameters
    ----------
    seed : int
        Decides all; the forms take turns.
    n_points : int
    spacing : float, optional
        As of `orchard.rows.row_scene`.

    Returns
    -------
    dict
        ``seed``, ``habit``, ``spacing_m``, ``n_left_out``, ``trees``: a row a true tree, that of
        `share_scores` with ``{trait}`` and ``{trait}_true`` where it was found.
    """
    scene = row_scene(seed, spacing=spacing)
    cloud = row_cloud(scene, n_points)
    found = find_trees(cloud)
    rows = share_scores(cloud, found, scene.offsets)
    for row in rows:
        if row["number"]:
            row.update(_traits(cloud, found, row["number"], scene.trees[row["tree"]]))
    return {
        "seed": int(seed),
        "habit": scene.target.habit,
        "spacing_m": float(np.diff(np.sort(scene.offsets[:, 0])).mean()),
        "n_left_out": len(found.left_out),
        "trees": rows,
    }


def share_scores(cloud, found, feet):
    """How well the wood is shared out.

    Parameters
    ----------
    cloud : PointCloud
        With the fields ``label`` and ``tree``.
    found : FoundTrees
    feet : ndarray of shape (n_trees, 3)
        True feet.

    Returns
    -------
    list of dict
        For each true tree ``tree``, ``number`` (of the tree found nearest to its foot; 0 where that
        is nearer to another), ``iou`` of wood points, ``wrong``: the share of its points that are
        another tree's.
    """
    wood = wood_mask(cloud["label"])
    owner, truth = found.owner[wood], cloud["tree"][wood]
    stands = np.array([tree.base[:2] for tree in found.trees])
    apart = np.linalg.norm(feet[:, None, :2] - stands[None], axis=2)
    rows = []
    for tree in range(len(feet)):
        number = int(apart[tree].argmin()) + 1
        if apart[:, number - 1].argmin() != tree:
            rows.append({"tree": tree, "number": 0, "iou": 0.0, "wrong": 0.0})
            continue
        own, true = owner == number, truth == tree
        iou = np.count_nonzero(own & true) / np.count_nonzero(own | true)
        wrong = np.count_nonzero(own & ~true) / np.count_nonzero(own)
        rows.append({"tree": tree, "number": number, "iou": float(iou), "wrong": float(wrong)})
    return rows


def _traits(cloud: PointCloud, found: FoundTrees, number: int, tree) -> dict:
    """What is measured of a tree, and its truth."""
    foot = found.trees[number - 1].base
    own = tree_cloud(cloud, found.owner, number, foot)
    contracted, report = contract_wood(own, options=ContractionOptions(), target_xy=foot[:2])
    skeleton = extract_skeleton(contracted, own, base=report["base"], limbs=report["limbs"])
    traits, true = measure_traits(skeleton, own)[0], tree_traits(tree)
    return {name: traits[name] for name in MEASURED} | {f"{n}_true": true[n] for n in MEASURED}
