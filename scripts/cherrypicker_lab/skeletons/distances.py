"""Distances between point sets: Chamfer, one-to-one matches."""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import maximum_bipartite_matching
from scipy.spatial import cKDTree

CM2_PER_M2 = 1e4


def sample_edges(points, edges, step):
    """Points along the edges of a graph, at most `step` apart, both ends included.

    Parameters
    ----------
    points : ndarray of shape (n_nodes, 3), float64
    edges : ndarray of shape (n_edges, 2), int
    step : float
        In the unit of `points`.

    Returns
    -------
    samples : ndarray of shape (n_samples, 3), float64
        Nodes without any edge are left out.
    edge : ndarray of shape (n_samples,), int64
        Edge that each sample lies on.
    share : ndarray of shape (n_samples,), float64
        Where on it, 0 at ``edges[:, 0]``, 1 at ``edges[:, 1]``.
    """
    points, edges = np.asarray(points, dtype=np.float64), np.asarray(edges, dtype=np.int64)
    start, way = points[edges[:, 0]], points[edges[:, 1]] - points[edges[:, 0]]
    count = np.maximum(np.ceil(np.linalg.norm(way, axis=1) / step - 1e-9).astype(np.int64), 1) + 1
    edge = np.repeat(np.arange(len(edges)), count)
    position = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    share = position / np.maximum(np.repeat(count, count) - 1, 1)
    return start[edge] + share[:, None] * way[edge], edge, share


def chamfer_cm2(found, truth):
    """Chamfer distance as the paper defines it (its Eq. of d_CD), in square centimetres.

    The mean squared distance from each found point to its nearest true one, plus the mean squared
    distance from each true point to its nearest found one.

    Parameters
    ----------
    found, truth : ndarray of shape (n, 3), float64
        Metres.

    Returns
    -------
    float

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

    Returns
    -------
    pairs : ndarray of shape (n_matches, 2), int64
        Rows in `found` and in `truth`, sorted.
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
    """Precision, recall and F1 of nodes under one-to-one matches.

    Parameters
    ----------
    found, truth : ndarray of shape (n, 3), float64
    tolerance : float

    Returns
    -------
    dict
        ``precision``, ``recall``, ``f1``, ``n_found``, ``n_true``.
    """
    n_matched = len(matched_pairs(found, truth, tolerance))
    precision, recall = n_matched / max(len(found), 1), n_matched / max(len(truth), 1)
    f1 = 2 * precision * recall / max(precision + recall, 1e-12)
    rates = {"precision": precision, "recall": recall, "f1": f1}
    return rates | {"n_found": len(found), "n_true": len(truth)}
