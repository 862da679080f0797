"""Contracted points against the true skeleton."""

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker_lab.skeletons.distances import chamfer_cm2, sample_edges, within_rates
from cherrypicker_lab.skeletons.graph_scores import TOLERANCES_M, graph_of

CHAMFER_STEP_M = 0.005
SAMPLE_M = 0.001


def chamfer_samples(skeleton):
    """Points every 5 mm of a true skeleton, (n, 3), each once, and the edge that each lies on."""
    true = graph_of(skeleton)
    truth, edge, share = sample_edges(true.points, true.edges, CHAMFER_STEP_M)
    once = share > 0  # an edge's first sample is the last one of the edge below
    once[0] = True  # the root
    return truth[once], edge[once]


def score_points(points, skeleton):
    """Compare contracted points with a true skeleton.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
        Metres.
    skeleton : Skeleton
        The truth, with ``fields["order"]``.

    Returns
    -------
    dict
        ``chamfer_cm2`` against the true skeleton every 5 mm, its halves ``to_truth_cm2`` and
        ``to_points_cm2`` (mean squared distances), ``samples`` (`within_rates` of the points and
        of the truth every millimetre), and ``by_order``: the same halves for the wood of each order
        (points count for the order of the nearest true wood).
    """
    true = graph_of(skeleton)
    truth, edge = chamfer_samples(skeleton)
    dense, _, _ = sample_edges(true.points, true.edges, SAMPLE_M)
    there, nearest = cKDTree(truth).query(points)
    back = cKDTree(points).query(truth)[0]
    order = skeleton.fields["order"][edge + 1]
    by_order = {}
    for value in np.unique(order):
        mine, asked = order[nearest] == value, order == value
        by_order[str(value)] = {
            "to_truth_cm2": float(1e4 * np.square(there[mine]).mean()) if mine.any() else None,
            "to_points_cm2": float(1e4 * np.square(back[asked]).mean()),
            "point_share": float(mine.mean()),
            "truth_share": float(asked.mean()),
        }
    return {
        "n_points": len(points),
        "chamfer_cm2": chamfer_cm2(points, truth),
        "to_truth_cm2": float(1e4 * np.square(there).mean()),
        "to_points_cm2": float(1e4 * np.square(back).mean()),
        "samples": within_rates(points, dense, TOLERANCES_M),
        "by_order": by_order,
    }
