"""A tree file of RayCloudTools: one line a tree, its segments one after the other.

A segment is its tip with radius and the number of its parent in the line; the first is the root's
own place, without a length, and its parent -1. Further attributes of a segment follow. Reference:
Lowe and Stepanas, RayCloudTools, IEEE Access 9, 2021; ``raylib/rayforeststructure.cpp``.
"""

import os

from cherrypicker.files import write_text
from cherrypicker.formats.measured import MeasuredTree

HEADER = (
    "# Tree file: per segment its tip x,y,z, radius and parent, then branch and its order",
    "x,y,z,radius,parent_id,branch_id,order",
)


def write_treefile(path: str | os.PathLike, tree: MeasuredTree) -> None:
    """Write a tree's cylinders as segments."""
    rows = tree.cylinders
    segments = [(rows.start[0], rows.radius[0], -1, 0, 0)]
    # The root stands before the cylinders, and those that start at it hang on it
    starts_at_root = tree.skeleton.parent[rows.node] == 0
    parents = [0 if at_root else row + 1 for at_root, row in zip(starts_at_root, rows.parent)]
    segments += zip(rows.end, rows.radius, parents, rows.branch, rows.order)
    line = ", ".join(
        f"{x:.6f},{y:.6f},{z:.6f},{radius:.6f},{parent},{branch},{order}"
        for (x, y, z), radius, parent, branch, order in segments
    )
    write_text(path, "\n".join([*HEADER, line]) + "\n")
