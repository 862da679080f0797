"""Light and bearing wood along the axes, as the view shows them."""

from __future__ import annotations

import os

import numpy as np

from cherrypicker.bearing.measure import KINDS
from cherrypicker.errors import StageError
from cherrypicker.files import cell_number, read_table
from cherrypicker.skeleton import Skeleton, axes

_COLUMNS = ("branch_id", "start_m", "end_m", "kind", "age_years")


def read_sky_shares(path: str | os.PathLike) -> dict[int, float]:
    """Read the share of the sky of each ``branch_id`` that has one from ``light.csv``.

    Raises
    ------
    StageError
        If the file is missing or a cell is no number.
    """
    return {
        int(cell_number(row["branch_id"], path, line)): cell_number(row["sky_share"], path, line)
        for line, row in read_table(path, ("branch_id", "sky_share"))
        if row["sky_share"]
    }


def read_pieces(path: str | os.PathLike) -> list[dict]:
    """Read where each piece of ``bearing.csv`` lies, its place in `KINDS` and its age.

    Raises
    ------
    StageError
        If the file is missing or a cell is wrong.
    """
    pieces = []
    for line, row in read_table(path, _COLUMNS):
        if row["kind"] not in KINDS:
            raise StageError(f"line {line}: no kind of wood {row['kind']!r}", file=path)
        numbers = {name: cell_number(row[name], path, line) for name in _COLUMNS if name != "kind"}
        pieces.append({**numbers, "kind": KINDS.index(row["kind"])})
    return pieces


def node_wood(
    skeleton: Skeleton, pieces: list[dict] | None
) -> tuple[np.ndarray, np.ndarray] | None:
    """Kind and age of the wood below each node, (n_nodes,) uint8; 255 where no piece tells.

    Parameters
    ----------
    pieces : list of dict, optional
        From `read_pieces`; without them there is None.
    """
    if pieces is None:
        return None
    kind, age = (np.full(len(skeleton), 255, dtype=np.uint8) for _ in range(2))
    axis_list = axes(skeleton)
    for piece in pieces:
        nodes = axis_list[int(piece["branch_id"])].nodes
        middle = np.cumsum(skeleton.edge_length[nodes]) - 0.5 * skeleton.edge_length[nodes]
        inside = nodes[(middle >= piece["start_m"]) & (middle <= piece["end_m"])]
        kind[inside], age[inside] = piece["kind"], min(piece["age_years"], 254)
    return kind, age
