"""Cylinders of a quantitative structure model, as TreeQSM makes them, as a graph in space."""

import numpy as np

from cherrypicker_lab.skeletons.graph_scores import Graph


def graph_of_cylinders(cylinders):
    """Join cylinders to a graph: a branch leaves its parent where its start is nearest to its axis.

    TreeQSM starts a branch on its parent's surface, somewhere along a cylinder; a cylinder that
    continues its own branch starts where the one before it ends. They have ``start``, ``end`` (n,
    3), ``parent`` (-1 for the first) and ``branch`` (n,). The root is the start of the first
    cylinder without a parent.
    """
    start, end = np.asarray(cylinders["start"]), np.asarray(cylinders["end"])
    parent, branch = np.asarray(cylinders["parent"]), np.asarray(cylinders["branch"])
    n = len(start)
    goes_on = (parent >= 0) & (branch == branch[parent])
    # of two that continue one branch from one cylinder, the second leaves it as a branch does
    first = np.zeros(n, bool)
    first[np.unique(np.where(goes_on, parent, -1), return_index=True)[1]] = True
    goes_on &= first
    share = np.zeros(n)
    side = np.flatnonzero((parent >= 0) & ~goes_on)
    axis = end[parent[side]] - start[parent[side]]
    along = ((start[side] - start[parent[side]]) * axis).sum(axis=1)
    share[side] = np.clip(along / np.maximum((axis * axis).sum(axis=1), 1e-12), 0, 1)

    # nodes: ends, then starts (those that go on have their parent's end), then feet on parents
    first_node = np.where(goes_on, parent, n + np.arange(n))
    inside = side[(share[side] > 0) & (share[side] < 1)]
    foot = np.full(n, -1)
    foot[inside] = 2 * n + np.arange(len(inside))
    foot[side[share[side] == 1]] = parent[side[share[side] == 1]]
    foot[side[share[side] == 0]] = first_node[parent[side[share[side] == 0]]]
    feet = start[parent[inside]] + share[inside, None] * (
        end[parent[inside]] - start[parent[inside]]
    )
    edges = [np.stack([foot[side], first_node[side]], axis=1)]
    for row in range(n):
        on_it = inside[parent[inside] == row]
        chain = [first_node[row], *foot[on_it[np.argsort(share[on_it])]], row]
        edges.append(np.stack([chain[:-1], chain[1:]], axis=1))
    edges = np.concatenate(edges)
    used, edges = np.unique(edges, return_inverse=True)
    root = int(np.searchsorted(used, first_node[np.flatnonzero(parent < 0)[0]]))
    return Graph(np.concatenate([end, start, feet])[used], edges.reshape(-1, 2), root)


def places_on_cylinders(cylinders, step):
    """Places on the axes at most `step` apart, (m, 3), and the radius there, (m,)."""
    start, end = cylinders["start"], cylinders["end"]
    count = np.maximum(np.ceil(np.linalg.norm(end - start, axis=1) / step), 1).astype(int) + 1
    places = [np.linspace(*axis) for axis in zip(start, end, count, strict=True)]
    return np.concatenate(places), np.repeat(cylinders["radius"], count)
