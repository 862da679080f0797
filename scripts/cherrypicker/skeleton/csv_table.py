"""Skeletons as a CSV of nodes: the form that truths and other tools' skeletons come in."""

from __future__ import annotations

import os

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.files import cell_number, read_table
from cherrypicker.skeleton.model import Skeleton, rooted_order

__all__ = ["read_skeleton_csv"]

COLUMNS = ("id", "parent", "x", "y", "z", "radius")


def read_skeleton_csv(path: str | os.PathLike, unit_m: float = 1.0) -> Skeleton:
    """Read a skeleton from a CSV of nodes in any order.

    Parameters
    ----------
    path : path-like
        Columns ``id``, ``parent`` (of the root: -1, or any id that no node has), ``x``, ``y``,
        ``z``, ``radius``, and where there are such ``order`` and ``label`` (0 and trunk without
        them). A radius left open is the parent's, the root's that of the first node with one.
    unit_m : float, default 1
        Metres per unit of the file.

    Returns
    -------
    Skeleton
        In metres, with a field ``order``.

    Raises
    ------
    StageError
        If the file is missing or its nodes are not one rooted tree.
    """
    rows = read_table(path, required=COLUMNS)

    def column(name: str, missing: float | None = None) -> np.ndarray:
        return np.array([cell_number(row.get(name), path, at, missing) for at, row in rows])

    ids = column("id").astype(np.int64)
    place = {node: row for row, node in enumerate(ids.tolist())}
    if len(place) != len(ids):
        raise StageError(f"{len(ids) - len(place)} ids stand there twice", file=path)
    parent = np.array([place.get(node, -1) for node in column("parent").astype(np.int64).tolist()])
    roots = np.flatnonzero(parent < 0)
    if len(roots) != 1:
        raise StageError(f"{len(roots)} nodes without a parent, 1 expected", file=path)
    edges = np.stack([np.flatnonzero(parent >= 0), parent[parent >= 0]], axis=1)
    try:
        sequence, new_parent = rooted_order(len(ids), edges, int(roots[0]))
    except ValueError as error:
        raise StageError(f"the nodes are not one tree ({error})", file=path) from error
    points = np.stack([column(axis) for axis in "xyz"], axis=1)
    return Skeleton(
        unit_m * points[sequence],
        new_parent,
        unit_m * _closed(column("radius", missing=np.nan)[sequence], new_parent),
        column("label", missing=1)[sequence].astype(np.int64),
        {"order": column("order", missing=0)[sequence].astype(np.int64)},
    )


def _closed(radius: np.ndarray, parent: np.ndarray) -> np.ndarray:
    """Radii with those left open filled from the parents; 0 where there are none at all."""
    known = radius[np.isfinite(radius)]
    for node in np.flatnonzero(~np.isfinite(radius)):
        radius[node] = radius[parent[node]] if node else np.append(known, 0.0)[0]
    return radius
