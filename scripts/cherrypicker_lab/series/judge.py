"""A comparison of two dates beside the truth, which knows each node of the wood by its number."""

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from cherrypicker.geometry.similarity import moved
from cherrypicker.series.tables import cut_table
from cherrypicker_lab.orchard.grow.seasons import NEW

GHOST = -2  # number of found wood that stands for no true wood
NEAR_M = 0.03  # found wood stands for true wood so near
AXIS_SHARE = 0.5  # of the old wood of the shorter of two axes, that are the same
LEAST_LENGTH_M = 0.10  # shorter axes are not counted, as in the benchmark of traits
NEAR_CUT_M = 0.06  # a found cut is a true one so near


def numbers_of(wood, dated, frame):
    """Number of the true node that each sample of found wood stands for, (n,) int64.

    The wood is in the scan's own frame, to which `frame` (4, 4) brings the tree's.
    """
    places = moved(wood.points, np.linalg.inv(frame))
    distance, row = cKDTree(dated.tree.skeleton().points).query(places)
    return np.where(distance <= NEAR_M, dated.node_numbers[row], GHOST)


def judge_step(comparison, first, second, later_wood, frame):
    """Judge a comparison of two scans of generated dates.

    The first scan is in the tree's own frame, which `frame` (4, 4) brings to the second's, and
    `later_wood` is the second scan's in its own. Returns `axes_10cm` and `cuts` (n_true, n_found,
    n_right), lengths in m, volumes in m3.
    """
    (step,) = comparison.steps
    wood, later = step.earlier.wood, step.later.wood
    one = numbers_of(wood, first, np.eye(4))
    two = numbers_of(later_wood, second, frame)
    old = one >= 0
    is_gone = old & ~np.isin(one, second.node_numbers)
    found_gone, found_new = step.gone.piece >= 0, step.new.piece >= 0
    true_new = second.tree.skeleton().edge_length[second.node_numbers == NEW].sum()
    true = true_pairs(wood.axis, one, later.axis, two)
    lengths = np.bincount(wood.axis, wood.length), np.bincount(later.axis, later.length)
    cuts = second.cuts
    return {
        "axes_10cm": _counts(true, step.match.axes, lengths),
        "cuts": _cut_counts(cuts, cut_table(comparison)),
        "length_m": float(wood.length.sum()),
        "removed_length_m": float(wood.length[found_gone].sum()),
        "true_removed_length_m": float(sum(cut["length_m"] for cut in cuts)),
        "removed_volume_m3": float(wood.volume[found_gone].sum()),
        "true_removed_volume_m3": float(sum(cut["volume_m3"] for cut in cuts)),
        # of what is truly gone, by the radii that the first scan tells
        "seen_removed_volume_m3": float(wood.volume[is_gone].sum()),
        "false_removed_length_m": float(wood.length[found_gone & ~is_gone].sum()),
        "new_length_m": float(later.length[found_new].sum()),
        "true_new_length_m": float(true_new),
        "false_new_length_m": float(later.length[found_new & (two != NEW)].sum()),
    }


def true_pairs(axis, numbers, later_axis, later_numbers):
    """Pairs of found axes that stand for the same true wood.

    Each true node counts once; the pairs are one to one and have the most nodes in common, and at
    least half of the old wood of the shorter.
    """
    shared = np.zeros((axis.max() + 1, later_axis.max() + 1))
    by_number = {}
    for number, each in set(zip(numbers.tolist(), axis.tolist())):
        if number >= 0:
            by_number.setdefault(number, []).append(each)
    for number, each in set(zip(later_numbers.tolist(), later_axis.tolist())):
        for other in by_number.get(number, ()):
            shared[other, each] += 1
    rows, columns = linear_sum_assignment(-shared)
    least = AXIS_SHARE * np.minimum(shared.sum(axis=1)[rows], shared.sum(axis=0)[columns])
    good = (shared[rows, columns] > 0) & (shared[rows, columns] >= least)
    return set(zip(rows[good].tolist(), columns[good].tolist()))


def _counts(true, found, lengths):
    """How many pairs there are of axes that are long enough at both dates."""
    kept = [
        {(a, b) for a, b in pairs if min(lengths[0][a], lengths[1][b]) >= LEAST_LENGTH_M}
        for pairs in (true, set(found.items()))
    ]
    return {"n_true": len(kept[0]), "n_found": len(kept[1]), "n_right": len(kept[0] & kept[1])}


def _cut_counts(cuts, found):
    n_right = 0
    if cuts and found:
        places = [[cut["x_m"], cut["y_m"], cut["z_m"]] for cut in found]
        true = np.array([cut["place"] for cut in cuts])
        apart = np.linalg.norm(true[:, None] - np.array(places)[None], axis=2)
        rows, columns = linear_sum_assignment(apart)
        n_right = int((apart[rows, columns] <= NEAR_CUT_M).sum())
    return {"n_true": len(cuts), "n_found": len(found), "n_right": n_right}
