"""Generated trees as the workflow's stages find them, and their axes beside the true ones.

A tree is grown, seen by simulated photos, contracted and made a graph by the functions that the
workflow's stages call. Labels are the true ones and neighbours are left out, so what the
segmentation and the crop cost is not in it (the error budget has that).
"""

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from cherrypicker.geometry.lines import Line
from cherrypicker.skeleton import axes
from cherrypicker.traits.branches import branch_rows
from cherrypicker_lab.orchard.grow.growth import HABITS
from cherrypicker_lab.orchard.grow.templates import BEARING
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.scene.mesh import NO_TREE
from cherrypicker_lab.orchard.seen.sampling import sample_scene
from cherrypicker_lab.skeletons.methods import find_skeleton

LEAST_LENGTH_M = 0.10  # shorter axes are not asked for
LEAST_DIAMETER_M = 0.010  # thinner bases do not count for the diameter
NEAR_M, NEAR_SHARE = 0.02, 0.7  # an axis is found where this share of it has a match this near
NEAR_BASE_M = 0.05
STEM_M, RELIEF = (0.10, 0.20), (0.5, 1.0)  # diameter, and depth of the bark, of bearing trees
_STEP_M = 0.005


def make_tree(seed, n_points, *, bearing=False):
    """Grow a tree of one of the orchard's forms, which take turns by the seed, and see it.

    The cloud has `n_points`, 45 % of them ground, true labels, metres, the target's wood and
    whatever is no tree. A `bearing` tree has a stem of 10 to 20 cm and bark with relief.
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

    Beside the skeleton stand the ``loose`` pieces of ``target.json``, as a dict.
    """
    skeleton, report = find_skeleton(cloud, target_xy=np.zeros(2))
    return skeleton, {"loose": report["wood"]["loose"]}


def matched_rows(truth, skeleton, rows):
    """Rows of the true axes that were found, each with the row of its axis of `skeleton`.

    Both skeletons are in one frame, metres; `rows` has one for each axis of `skeleton`.
    """
    true_axes = axes(truth)
    true_rows = branch_rows(truth, true_axes, 0.0)
    wanted = [i for i, row in enumerate(true_rows) if i and row["length_m"] >= LEAST_LENGTH_M]
    lines = [truth.points[true_axes[i].way] for i in wanted]
    found = [skeleton.points[axis.way] for axis in axes(skeleton)[1:]]
    matched = match_axes(lines, found)
    return [(true_rows[wanted[i]], rows[j + 1]) for i, j in matched]


def match_axes(true_lines, found_lines):
    """Match axes, polylines (n, 3) from base to tip, m, one to one by where they run.

    A found axis may stand for a true one where 70 % of the true one's length lies within 2 cm of it
    and both start within 5 cm; angles and radii play no part. Of all ways to match, the one with
    the most length near is taken. Returns pairs of the indices of a true line and its found one.
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


def _dense(points):
    line = Line(points)
    length = line.along[-1]
    return line.at(np.linspace(0.0, length, max(int(length / _STEP_M), 1) + 1))


def branch_pair(true, found, name):
    """Pair of one column; its interval's columns are named after it."""
    stem, unit = name.rsplit("_", 1)
    low, high = found.get(f"{stem}_low_{unit}"), found.get(f"{stem}_high_{unit}")
    return as_pair(true[name], found[name], low, high)


def as_pair(true, found, low, high):
    """A true and a found value and the ends of its interval, None where there is none."""
    values = {"true": true, "found": found, "low": low, "high": high}
    return {key: None if value is None else float(value) for key, value in values.items()}
