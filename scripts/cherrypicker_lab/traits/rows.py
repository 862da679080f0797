"""Rows of trees with touching crowns beside their truth: whose wood is whose, and what is measured.

A row is grown, seen from both alleys by simulated photos, shared out among its trees, and each tree
measured by the functions that the workflow's stages call. Labels are the true ones.

Of a row that was rendered as photos (`scripts/lab/render_scene.py --row`) the workflow's results
are held against the truth: there labels, cameras and scale are the workflow's too.
"""

from pathlib import Path

import numpy as np

from cherrypicker.classes import wood_mask
from cherrypicker.errors import StageError
from cherrypicker.files import read_json, read_npz
from cherrypicker.limbs.orchard import MOST_POINTS, GrowthOptions
from cherrypicker.pointcloud import PointCloud, read_cloud
from cherrypicker.skeleton import read_skeleton, read_skeleton_csv
from cherrypicker.traits.measure import measure_traits
from cherrypicker.wood.row import FoundTrees, find_trees, rows_of_tree
from cherrypicker.wood.target_wood import share_cloud
from cherrypicker_lab.evaluation import at_surface, cameras_beside_truth, compare_skeletons
from cherrypicker_lab.orchard.rows import row_cloud, row_scene
from cherrypicker_lab.orchard.scene.mesh import NO_TREE
from cherrypicker_lab.orchard.truth import tree_traits
from cherrypicker_lab.skeletons.methods import find_skeleton

MEASURED = ("height_m", "trunk_diameter_m", "total_length_m")


def measure_row(seed, n_points):
    """Share a row out among its trees and measure each.

    Parameters
    ----------
    seed : int
        Decides all; the forms take turns.
    n_points : int

    Returns
    -------
    dict
        ``seed``, ``habit``, ``spacing_m``, ``n_left_out``, ``trees``: a row a true tree, that of
        `share_scores` with ``{trait}`` and ``{trait}_true`` where it was found.
    """
    scene = row_scene(seed)
    cloud = row_cloud(scene, n_points)
    found = find_trees(cloud, share_cloud(cloud, GrowthOptions(), MOST_POINTS))
    wood = wood_mask(cloud["label"])
    stands = np.array([tree.base for tree in found.trees])
    rows = share_scores(found.owner[wood], cloud["tree"][wood], stands, scene.offsets)
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


def measure_scanned_row(results, scan, truth):
    """Compare the workflow's results of a row of photos with its truth.

    Parameters
    ----------
    results : path-like
        The batch's ``results``.
    scan : str
        Name of the scan, whose trees are ``{scan}_1`` and so on.
    truth : path-like
        As `orchard.rows.write_row_truth` leaves it.

    Returns
    -------
    dict
        ``cameras`` (of `evaluation.compare_cameras`), ``n_trees``, ``n_found``, ``n_left_out``,
        ``trees``: a row a true tree, that of `share_scores` over all points of the cloud, with
        ``{trait}``, ``{trait}_true``, ``skeleton_recall`` and ``skeleton_precision`` where it was
        found; ``totals`` of `totals_of`.

    Raises
    ------
    StageError
        If a file is missing or broken, or no tree was found.
    """
    results, truth = Path(results), Path(truth)
    folder, true_trees = results / scan, read_json(truth / "trees.json")["trees"]
    cameras = cameras_beside_truth(folder, truth)
    rotation, shift = cameras.pop("rotation"), cameras.pop("translation")
    cloud = read_cloud(folder / "segmented.ply", required=("label",))
    exact = read_cloud(truth / "cloud.ply", required=("tree",))
    tree = at_surface(cloud.points @ rotation.T + shift, exact.points, exact["tree"], NO_TREE)
    found = read_json(folder / "trees.json")
    if not found["trees"]:
        raise StageError("no tree was found", file=folder / "trees.json")
    stands = np.array([one["foot"] for one in found["trees"]]) @ rotation.T + shift
    feet = np.array([each["foot"] for each in true_trees])
    rows = share_scores(read_npz(folder / "owners.npz")["owner"], tree, stands, feet)
    for row in rows:
        if row["number"]:
            own = results / f"{scan}_{row['number']}"
            true = true_trees[row["tree"]]["traits"]
            row.update(_beside(read_json(own / "traits.json"), true))
            skeleton = read_skeleton(own / "skeleton.graphml")
            skeleton.points = skeleton.points @ rotation.T + shift
            true_skeleton = read_skeleton_csv(truth / f"skeleton_tree{row['tree']}.csv")
            scores = compare_skeletons(skeleton, true_skeleton)
            row.update({n: scores[n] for n in ("skeleton_recall", "skeleton_precision")})
    return {
        "cameras": cameras,
        "n_trees": len(rows),
        "n_found": sum(row["number"] > 0 for row in rows),
        "n_left_out": len(found["left_out"]),
        "trees": rows,
        "totals": totals_of(rows),
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

    Parameters
    ----------
    owner : ndarray of shape (n,), int
        Number of the tree that each point was given to, from 1; 0 and less: none.
    tree : ndarray of shape (n,), int
        True tree of each, from 0; `NO_TREE` for none.
    stands : ndarray of shape (n_found, 2 or 3)
        Feet of the trees that were found, in the order of their numbers.
    feet : ndarray of shape (n_trees, 2 or 3)
        True feet.

    Returns
    -------
    list of dict
        For each true tree ``tree``, ``number`` (of the tree found nearest to its foot; 0 where that
        is nearer to another), ``iou`` of points, ``wrong``: the share of its points that are
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


def _traits(cloud: PointCloud, found: FoundTrees, number: int, tree) -> dict:
    """What is measured of a tree, and its truth."""
    foot = found.trees[number - 1].base
    own = cloud.select(rows_of_tree(cloud.points, found.owner, number, foot))
    skeleton, _ = find_skeleton(own, target_xy=foot[:2])
    return _beside(measure_traits(skeleton, own)[0], tree_traits(tree))


def _beside(traits, true):
    """What is measured of a tree beside its truth, by the names of `MEASURED`."""
    return {name: traits[name] for name in MEASURED} | {f"{n}_true": true[n] for n in MEASURED}
