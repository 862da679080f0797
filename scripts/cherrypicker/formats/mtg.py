"""A Multiscale Tree Graph in its text form, for OpenAlea's and other readers, and from them.

What is written has three scales: the plant P, its axes A, and an axis's segments S, one a node of
the skeleton. A line is a vertex: ``<`` goes on along the axis, ``+`` bears a lateral, ``/`` goes
down a scale, ``^`` goes on from the column's last vertex; a lateral stands a column to the right of
what bears it.
References: Godin and Caraglio, J. Theor. Biol. 191, 1998; Pradal and Godin, OpenAlea.MTG, "File
syntax".
"""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.files import cell_number, write_text
from cherrypicker.formats.measured import MeasuredTree
from cherrypicker.skeleton import axis_of_node

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
_PLACE = ("XX", "YY", "ZZ")
_DIAMETERS = ("TopDiameter", "TopDia", "Diameter")  # what readers look for, in this order
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
    skeleton, owner = tree.skeleton, axis_of_node(tree.skeleton, tree.axis_list)
    numbers = np.column_stack([skeleton.edge_length, 2.0 * skeleton.radius, skeleton.points])
    values = [
        [*(f"{value:.9f}" for value in row), str(label), str(branch)]
        for row, label, branch in zip(numbers.tolist(), skeleton.label.tolist(), owner.tolist())
    ]
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


def read_mtg_nodes(path: str | os.PathLike) -> dict[str, np.ndarray]:
    """Read the vertices of an MTG that have coordinates, whatever its scales.

    A line is taken as one place, that of its last vertex: it hangs on the nearest one before it, by
    the columns, that has coordinates. The arrays are as
    `cherrypicker.skeleton.csv_table.rooted_skeleton` takes them; ids are lines.

    Raises
    ------
    StageError
        If the file is missing, is no MTG, or lacks coordinates or diameters.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8", errors="replace").split("\n")
    except OSError as error:
        raise StageError(f"cannot be read: {error}", file=path) from error
    heads = [at for at, line in enumerate(lines) if line.startswith(("TOPO", "ENTITY-CODE"))]
    if not heads:
        raise StageError("no line begins with TOPO or ENTITY-CODE, so it is no MTG", file=path)
    names = [name.strip() for name in lines[heads[0]].split("\t")]
    thick = [name for name in _DIAMETERS if name in names]
    missing = [name for name in _PLACE if name not in names]
    missing += [] if thick else [" or ".join(_DIAMETERS)]
    if missing:
        cause = f"line {heads[0] + 1}: the MTG has no feature {', '.join(missing)}"
        raise StageError(f"{cause}; add a column of that name", file=path)
    n_columns = next(place for place, name in enumerate(names) if place and name)
    wanted = [names.index(name) for name in (*_PLACE, thick[0])]
    rows = []
    # Of a column: the line with coordinates that its vertex leads back to
    last: dict[int, int] = {}
    for number, line in enumerate(lines[heads[0] + 1 :], heads[0] + 2):
        cells = [cell.strip() for cell in line.split("\t")] + [""] * len(names)
        column = next((place for place in range(n_columns) if cells[place]), n_columns)
        if column == n_columns or cells[column].startswith("#"):
            continue
        is_same = cells[column].startswith("^")
        before = [place for place in last if place < column + is_same]
        bearer = last[max(before)] if before else -1
        x, y, z, diameter = (cell_number(cells[at], path, number, np.nan) for at in wanted)
        if not np.isnan(x + y + z):
            rows.append((number, bearer, x, y, z, diameter / 2))
            bearer = number
        last = {place: own for place, own in last.items() if place < column} | {column: bearer}
    if not rows:
        raise StageError("no vertex has XX, YY and ZZ", file=path)
    table = np.array(rows)
    ids, none = table[:, 0].astype(np.int64), np.zeros(len(table), dtype=np.int64)
    return {
        "line": ids,
        "id": ids,
        "parent": table[:, 1].astype(np.int64),
        "points": table[:, 2:5],
        "radius": table[:, 5],
        "order": none,
        "label": none + 1,
    }
