"""Distances between point sets: Chamfer, one-to-one matches."""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import maximum_bipartite_matching
from scipy.spatial import cKDTree

CM2_PER_M2 = 1e4


def chamfer_cm2(found, truth):
    """Chamfer distance as the paper defines it (its Eq. of d_CD), in square centimetres.

    The mean squared distance from each found point to its nearest true one, plus the mean squared
    distance from each true point to its nearest found one.

    Parameters
    ----------
    found, truth : ndarray of shape (n, 3), float64
        Metres.

    Examples
    --------
    A point 2 cm beside each of two true points is 4 cm2 away, both ways:

    >>> chamfer_cm2([[0.02, 0, 0], [1.02, 0, 0]], [[0, 0, 0], [1, 0, 0]])
    8.0
    """
    there = cKDTree(truth).query(found)[0]
    back = cKDTree(found).query(truth)[0]
    return round(float(CM2_PER_M2 * (np.square(there).mean() + np.square(back).mean())), 9)


def matched_pairs(found, truth, tolerance):
    """The most one-to-one matches between two point sets within a tolerance.

    Returns rows in `found` and in `truth`, sorted, (n_matches, 2) int64.
    """
    if not len(found) or not len(truth):
        return np.empty((0, 2), dtype=np.int64)
    near = cKDTree(found).sparse_distance_matrix(
        cKDTree(truth), tolerance, output_type="coo_matrix"
    )
    # coincident points have the distance 0, which a sparse matrix would drop
    graph = coo_matrix((np.ones(near.nnz), (near.row, near.col)), shape=near.shape).tocsr()
    partner = maximum_bipartite_matching(graph, perm_type="column")
    rows = np.flatnonzero(partner >= 0)
    return np.stack([rows, partner[rows]], axis=1).astype(np.int64)


def match_rates(found, truth, tolerance):
    """Rates of nodes, (n, 3) each, under one-to-one matches.

    They are ``precision``, ``recall``, ``f1``, ``n_found``, ``n_true``.
    """
    n_matched = len(matched_pairs(found, truth, tolerance))
    precision, recall = n_matched / max(len(found), 1), n_matched / max(len(truth), 1)
    f1 = 2 * precision * recall / max(precision + recall, 1e-12)
    rates = {"precision": precision, "recall": recall, "f1": f1}
    return rates | {"n_found": len(found), "n_true": len(truth)}
