"""Skeletons as a table of nodes: what truths, digitisers and other tools' skeletons come in."""

import os
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.files import cell_number, read_table
from cherrypicker.skeleton.model import Skeleton, closed_radii, rooted_order

COLUMNS = ("id", "parent", "x", "y", "z")


def read_skeleton_csv(path: str | os.PathLike, unit_m: float = 1.0) -> Skeleton:
    """Read a skeleton from a CSV of nodes in any order, in metres, with a field ``order``.

    Its columns are ``id``, ``parent`` (of the root: -1, none, or any id that no node has), ``x``,
    ``y``, ``z``, ``radius`` or ``diameter``, and where there are such ``order`` and ``label`` (0
    and trunk without them), separated by commas, semicolons or tabs, in units of `unit_m` metres. A
    radius left open is the parent's, the root's that of the first node with one. A `StageError`
    where the file is missing or its nodes are not one rooted tree.
    """
    skeleton = rooted_skeleton(read_nodes(path), path)
    radius = closed_radii(skeleton.radius, skeleton.parent)
    return replace(skeleton, points=unit_m * skeleton.points, radius=unit_m * radius)


def read_nodes(path: str | os.PathLike) -> dict[str, np.ndarray]:
    """Read the table of `read_skeleton_csv` as `rooted_skeleton` takes it.

    A `StageError` where the file is missing, lacks a column, or a cell is no number.
    """
    rows = read_table(path, COLUMNS, ",;\t")
    named = [name for name in ("radius", "diameter") if name in rows[0][1]]
    if not named:
        raise StageError("no column radius or diameter in the table", file=path)

    def column(name: str, missing: float | None = None) -> np.ndarray:
        cells = [(at, (row.get(name) or "").replace(",", ".")) for at, row in rows]
        return np.array([cell_number(cell, path, at, missing) for at, cell in cells])

    return {
        "line": np.array([at for at, _ in rows]),
        "id": column("id").astype(np.int64),
        "parent": column("parent", missing=-1).astype(np.int64),
        "points": np.stack([column(axis) for axis in "xyz"], axis=1),
        "radius": column(named[0], missing=np.nan) / (1 if named[0] == "radius" else 2),
        "order": column("order", missing=0).astype(np.int64),
        "label": column("label", missing=1).astype(np.int64),
    }


def rooted_skeleton(nodes: Mapping[str, np.ndarray], path: str | os.PathLike) -> Skeleton:
    """Order the nodes of a file as a skeleton, in its unit; radii left open stay NaN.

    The nodes have ``id``, ``parent``, ``line`` of the file, ``radius``, ``order`` and ``label``
    (n_nodes,) and ``points`` (n_nodes, 3). The `StageError` where they are not one rooted tree
    names lines of the file.
    """
    ids, lines = nodes["id"].tolist(), nodes["line"]
    place = {node: row for row, node in enumerate(ids)}
    again = [node for row, node in enumerate(ids) if place[node] != row]
    if again:
        cause = f"line {lines[place[again[0]]]}: id {again[0]} stands there twice; give it another"
        raise StageError(cause, file=path)
    parent = np.array([place.get(node, -1) for node in nodes["parent"].tolist()])
    roots = np.flatnonzero(parent < 0)
    if len(roots) != 1:
        told = ", ".join(map(str, lines[roots[:5]].tolist())) or "none"
        raise StageError(
            f"{len(roots)} nodes without a parent, 1 expected (line {told}); the root alone has "
            "none, or -1; give every other node's parent an id of the file",
            file=path,
        )
    above = np.where(parent < 0, roots[0], parent)
    for _ in range(len(ids).bit_length()):  # twice as far each time
        above = above[above]
    astray = lines[above != roots[0]]
    if len(astray):
        cause = f"the nodes are not one tree: from line {astray[0]} on parents lead in a circle"
        raise StageError(f"{cause}; correct one of them", file=path)
    edges = np.stack([np.flatnonzero(parent >= 0), parent[parent >= 0]], axis=1)
    sequence, new_parent = rooted_order(len(ids), edges, int(roots[0]))
    own = {name: values[sequence] for name, values in nodes.items()}
    return Skeleton(own["points"], new_parent, own["radius"], own["label"], {"order": own["order"]})
