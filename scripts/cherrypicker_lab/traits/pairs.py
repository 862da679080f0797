"""Traits of generated trees beside their truth: true and found values, and the intervals given.

A tree is grown, seen by simulated photos, contracted, made a graph and measured by the functions
that the workflow's stages call. Labels are the true ones and neighbours are left out, so what the
segmentation and the crop cost is not in it (the error budget has that).
"""

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from cherrypicker.skeleton import axes, axis_polyline
from cherrypicker.traits.branches import branch_rows
from cherrypicker.traits.measure import measure_traits
from cherrypicker.traits.reports import Reports
from cherrypicker_lab.orchard.grow.growth import HABITS
from cherrypicker_lab.orchard.grow.templates import BEARING
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.scene.mesh import NO_TREE
from cherrypicker_lab.orchard.seen.sampling import sample_scene
from cherrypicker_lab.skeletons.methods import find_skeleton
from cherrypicker_lab.traits.table import JUDGED, SCALARS, true_scaffold

LEAST_LENGTH_M = 0.10  # shorter axes are not asked for
LEAST_DIAMETER_M = 0.010  # thinner bases do not count for the diameter
NEAR_M, NEAR_SHARE = 0.02, 0.7  # an axis is found where this share of it has a match this near
NEAR_BASE_M = 0.05
NEAR_LIMB_M = 0.03  # and its diameter more: how far off a limb may be measured
N_TOP, SAME_M = 3, 0.002  # limbs that count, and what a calliper cannot tell of their diameters
STEM_M, RELIEF = (0.10, 0.20), (0.5, 1.0)  # diameter, and depth of the bark, of bearing trees
_STEP_M = 0.005


def make_tree(seed, n_points, *, bearing=False):
    """Grow a tree of one of the orchard's forms and see it.

    Parameters
    ----------
    seed : int
        Decides all; the forms take turns.
    n_points : int
        Of the cloud, 45 % of them ground.
    bearing : bool, default False
        A bearing tree, of a stem of 10 to 20 cm and bark with relief.

    Returns
    -------
    tree : growth.Tree
    cloud : PointCloud
        With true labels, metres; the target's wood and whatever is no tree.
    """
    habits, options = sorted(HABITS), {}
    if bearing:
        habits, rng = BEARING, np.random.default_rng([int(seed), 87])
        options = {"trunk_radius": rng.uniform(*STEM_M) / 2, "relief": rng.uniform(*RELIEF)}
    scene = generate_scene(seed, habit=habits[seed % len(habits)], **options)
    cloud = sample_scene(scene, n_points)
    cloud = cloud.select(np.isin(cloud["tree"], (0, NO_TREE)))
    del cloud.fields["tree"]
    return scene.target, cloud


def skeleton_of(cloud):
    """Contract a labelled cloud and make its graph, with the default options.

    Returns
    -------
    skeleton : Skeleton
    target : dict
        Of ``target.json``, the ``loose`` pieces.
    """
    skeleton, report = find_skeleton(cloud, target_xy=np.zeros(2))
    return skeleton, {"loose": report["wood"]["loose"]}


def measure_tree(seed, n_points, *, bearing=False):
    """Make a tree, measure it, and put the truth beside it; parameters as of `make_tree`.

    Returns
    -------
    dict
        `seed`, `habit`, `bearing`, `n_points`, `traits` (name to a list of pairs, see
        `tree_pairs`), `n_axes` and `n_matched` (true axes of 10 cm and more, and those found).
    """
    tree, cloud = make_tree(seed, n_points, bearing=bearing)
    skeleton, target = skeleton_of(cloud)
    traits, tables = measure_traits(skeleton, cloud, reports=Reports(target=target))
    pairs = tree_pairs(tree, traits)
    branches, n_axes, n_matched = branch_pairs(tree, skeleton, tables["branches"])
    return {
        "seed": int(seed),
        "habit": tree.habit,
        "bearing": bearing,
        "n_points": len(cloud),
        "traits": pairs | branches,
        "n_axes": n_axes,
        "n_matched": n_matched,
        "limbs": judge_limbs(tree, skeleton, tables["limbs"]),
    }


def judge_limbs(tree, skeleton, rows):
    """Whether the three thickest limbs are the true three, and how many limbs there are.

    A limb is the true one whose place of measure lies nearest, one to one: two measure the same
    wood there, whatever way a skeleton makes to it from the stem.

    Parameters
    ----------
    tree : growth.Tree
    skeleton : Skeleton
        As found.
    rows : list of dict
        Of ``limbs.csv``, the thickest first.

    Returns
    -------
    dict
        `n_true`, `n_found`; `are_three` whether the three thickest found are the three thickest
        true ones, `are_three_to_2mm` whether they are three that no true limb outdoes by more than
        2 mm; `diameters`, a list of the pairs of the limbs that were matched.
    """
    limbs = true_scaffold(tree.skeleton()).limbs
    limbs = sorted(limbs, key=lambda limb: -limb.diameter)
    place_of = {limb.axis: limb.place for limb in true_scaffold(skeleton).limbs}
    places = [place_of.get(row["branch_id"], np.full(3, np.inf)) for row in rows]
    matched = _match_limbs(limbs, places)
    true_of = {j: i for i, j in matched}
    top = [true_of.get(j) for j in range(min(N_TOP, len(rows)))]
    n_top = min(N_TOP, len(limbs))
    least = limbs[n_top - 1].diameter - SAME_M if n_top else 0.0
    low_high = ("diameter_m", "diameter_low_m", "diameter_high_m")
    return {
        "n_true": len(limbs),
        "n_found": len(rows),
        "are_three": sorted(top, key=str) == sorted(range(n_top), key=str),
        "are_three_to_2mm": len(top) == n_top
        and all(i is not None and limbs[i].diameter >= least for i in top),
        "diameters": [
            as_pair(limbs[i].diameter, *(rows[j][name] for name in low_high)) for i, j in matched
        ],
    }


def _match_limbs(limbs, places):
    """Pairs of a true limb and a place of measure, by their rows."""
    if not limbs or not places:
        return []
    far = np.linalg.norm([[limb.place - place for place in places] for limb in limbs], axis=2)
    room = NEAR_LIMB_M + np.array([limb.diameter for limb in limbs])[:, None]
    far = np.where(far <= room, far / room, len(far) + 1.0)  # no miss is worth a match
    rows, columns = linear_sum_assignment(far)
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if far[i, j] <= 1.0]


def tree_pairs(tree, traits):
    """Pairs of the traits of a whole tree.

    Parameters
    ----------
    tree : growth.Tree
    traits : dict
        From `measure_traits`.

    Returns
    -------
    dict of str to list of dict
        Name to one pair: `true`, `found`, and `low`, `high` of the 90 % interval (None without).
    """
    pairs = {}
    for name in SCALARS:
        values = JUDGED[name].truth(tree), traits[name], *traits.get(f"{name}_ci90", (None, None))
        if JUDGED[name].is_share:
            values = [None if value is None else value / values[0] for value in values]
        pairs[name] = [as_pair(*values)]
    return pairs


def branch_pairs(tree, skeleton, rows):
    """Pairs of the axes that were found: base diameter and insertion angle.

    Both sides follow one definition, `branch_rows`, here on the true skeleton's own axes.

    Parameters
    ----------
    tree : growth.Tree
    skeleton : Skeleton
        As found.
    rows : list of dict
        From `measure_traits`, a row an axis of `skeleton`.

    Returns
    -------
    pairs : dict of str to list of dict
    n_axes, n_matched : int
    """
    matched, n_axes = matched_rows(tree.skeleton(), skeleton, rows)
    pairs = {"base_diameter_m": [], "insertion_angle_deg": []}
    for true, got in matched:
        if true["base_diameter_m"] >= LEAST_DIAMETER_M:
            pairs["base_diameter_m"].append(branch_pair(true, got, "base_diameter_m"))
        pairs["insertion_angle_deg"].append(branch_pair(true, got, "insertion_angle_deg"))
    return pairs, n_axes, len(matched)


def matched_rows(truth, skeleton, rows):
    """Rows of the true axes that were found, each with the row of its axis of `skeleton`.

    Parameters
    ----------
    truth, skeleton : Skeleton
        In one frame, metres.
    rows : list of dict
        A row an axis of `skeleton`.

    Returns
    -------
    list of tuple of dict
        A row of the truth and the found one.
    n_axes : int
        True axes of 10 cm and more.
    """
    true_axes = axes(truth)
    true_rows = branch_rows(truth, true_axes, 0.0)
    wanted = [i for i, row in enumerate(true_rows) if i and row["length_m"] >= LEAST_LENGTH_M]
    lines = [truth.points[axis_polyline(true_axes[i])] for i in wanted]
    found = [skeleton.points[axis_polyline(axis)] for axis in axes(skeleton)[1:]]
    matched = match_axes(lines, found)
    return [(true_rows[wanted[i]], rows[j + 1]) for i, j in matched], len(wanted)


def match_axes(true_lines, found_lines):
    """Match axes one to one by where they run.

    A found axis may stand for a true one where 70 % of the true one's length lies within 2 cm of
    it and both start within 5 cm; angles and radii play no part. Of all ways to match, the one
    with the most length near is taken.

    Parameters
    ----------
    true_lines, found_lines : list of ndarray of shape (n, 3), float64
        Polylines from base to tip, metres.

    Returns
    -------
    list of tuple of int
        Index of a true line, index of its found line.
    """
    if not true_lines or not found_lines:
        return []
    near = np.zeros((len(true_lines), len(found_lines)))
    bases = cKDTree([line[0] for line in found_lines])
    dense_found = [_dense(line) for line in found_lines]
    for i, line in enumerate(true_lines):
        dense = _dense(line)
        for j in bases.query_ball_point(line[0], NEAR_BASE_M):
            near[i, j] = (cKDTree(dense_found[j]).query(dense)[0] <= NEAR_M).mean()
    near[near < NEAR_SHARE] = 0.0
    rows, columns = linear_sum_assignment(-near)
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if near[i, j] > 0]


def _dense(line):
    steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.linspace(0.0, along[-1], max(int(along[-1] / _STEP_M), 1) + 1)
    return np.array([np.interp(at, along, axis) for axis in line.T]).T


def branch_pair(true, found, name):
    """Pair of one column; its interval's columns are named after it."""
    stem, unit = name.rsplit("_", 1)
    low, high = found.get(f"{stem}_low_{unit}"), found.get(f"{stem}_high_{unit}")
    return as_pair(true[name], found[name], low, high)


def as_pair(true, found, low, high):
    """A true and a found value and the ends of its interval, None where there is none."""
    values = {"true": true, "found": found, "low": low, "high": high}
    return {key: None if value is None else float(value) for key, value in values.items()}
