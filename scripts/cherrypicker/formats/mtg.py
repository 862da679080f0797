"""A Multiscale Tree Graph in its text form, for OpenAlea's and other readers.

Three scales: the plant P, its axes A, and an axis's segments S, one a node of the skeleton. A line
is a vertex: ``<`` goes on along the axis, ``+`` bears a lateral, ``/`` goes down a scale, ``^``
goes on from the column's last vertex; a lateral stands a column to the right of what bears it.
References: Godin and Caraglio, J. Theor. Biol. 191, 1998; Pradal and Godin, OpenAlea.MTG, "File
syntax".
"""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np

from cherrypicker.files import write_text
from cherrypicker.formats.measured import MeasuredTree

# Those of upper case are the format's own: the length of a segment, its diameter at the top
FEATURES = {
    "Length": "REAL",
    "TopDiameter": "REAL",
    "XX": "REAL",
    "YY": "REAL",
    "ZZ": "REAL",
    "label": "INT",
    "branch_id": "INT",
}
_HEADER = """\
CODE:\tFORM-A

CLASSES:
SYMBOL\tSCALE\tDECOMPOSITION\tINDEXATION\tDEFINITION
$\t0\tFREE\tFREE\tIMPLICIT
P\t1\tFREE\tFREE\tIMPLICIT
A\t2\tFREE\tFREE\tIMPLICIT
S\t3\tFREE\tFREE\tIMPLICIT

DESCRIPTION:
LEFT\tRIGHT\tRELTYPE\tMAX
A\tA\t+\t?
S\tS\t<\t1
S\tS\t+\t?

FEATURES:
NAME\tTYPE
"""


def write_mtg(path: str | os.PathLike, tree: MeasuredTree) -> None:
    """Write a tree, nanometres and better, so that lengths add up."""
    n_columns = 2 + max(axis.order for axis in tree.axis_list)
    lines = [f"{name}\t{kind}" for name, kind in FEATURES.items()]
    lines += ["", "MTG:", "\t".join(["TOPO", *[""] * (n_columns - 1), *FEATURES])]
    for column, code, values in _vertices(tree):
        cells = [*[""] * column, code, *[""] * (n_columns - column - 1), *values]
        lines.append("\t".join(cells).rstrip("\t"))
    write_text(path, _HEADER + "\n".join(lines) + "\n")


def _vertices(tree: MeasuredTree) -> Iterator[tuple[int, str, list[str]]]:
    """Yield column, code and features of every vertex, a lateral right after what bears it."""
    borne: dict[int, list[int]] = {}
    for index, axis in enumerate(tree.axis_list):
        borne.setdefault(axis.attach, []).append(index)
    values = _features(tree)
    yield 0, "/P1", []
    places = [(0, 0)]  # axis, and how many of its nodes are written: what is left to go on with
    while places:
        index, done = places.pop()
        axis = tree.axis_list[index]
        for place in range(done, len(axis.nodes)):
            node = int(axis.nodes[place])
            if place == 0:
                yield axis.order, f"{'^/' if index == 0 else '+'}A{index + 1}", []
            yield axis.order, f"^{'<' if place else '/'}S{node + 1}", values[node]
            if node in borne:
                places.append((index, place + 1))
                places += [(lateral, 0) for lateral in reversed(borne[node])]
                break


def _features(tree: MeasuredTree) -> list[list[str]]:
    """Cells of the features of every node, in the order of the nodes."""
    skeleton = tree.skeleton
    owner = np.zeros(len(skeleton), dtype=np.int64)
    for index, axis in enumerate(tree.axis_list):
        owner[axis.nodes] = index
    numbers = np.column_stack(
        [skeleton.edge_length, 2.0 * tree.scale[owner] * skeleton.radius, skeleton.points]
    )
    whole = zip(skeleton.label.tolist(), owner.tolist())
    return [
        [*(f"{value:.9f}" for value in row), str(label), str(branch)]
        for row, (label, branch) in zip(numbers.tolist(), whole)
    ]
