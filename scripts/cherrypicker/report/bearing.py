"""The bearing wood's section of a tree's page: the tree, and each limb with all that it carries."""

from __future__ import annotations

import os

import numpy as np

from cherrypicker.bearing.measure import KINDS
from cherrypicker.errors import StageError
from cherrypicker.files import cell_number, read_table
from cherrypicker.report.branches import limb_sums
from cherrypicker.skeleton import Skeleton, axes
from cherrypicker.traits.table import BranchColumn

_COLUMNS = ("branch_id", "start_m", "end_m", "kind", "age_years")
_TITLES = {
    "shoots": ("one-year shoots", 1),
    "spurs": ("spurs", 1),
    "shoot_length_m": ("length of shoots", 2),
    "bearing_length_m": ("bearing length", 2),
    "shoots_per_cm2": ("shoots a cm²", 2),
    "spurs_per_cm2": ("spurs a cm²", 2),
    "bearing_length_m_per_cm2": ("bearing length a cm² [m]", 3),
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


def bearing_section(bearing: dict | None, unit: str) -> dict | None:
    """What the page shows of ``bearing.json``, by `limb_sums`; None where none was told."""
    if bearing is None:
        return None
    columns = [
        BranchColumn(_page_name(name), title=title, decimals=decimals)
        for name, (title, decimals) in _TITLES.items()
    ]
    tree, *limbs = (
        {_page_name(name): value for name, value in row.items()}
        for row in (bearing, *bearing["limbs"])
    )
    return limb_sums(columns, tree, limbs, unit)


def _page_name(name: str) -> str:
    """A sum's name; what is told a cm2 is no area, which its ending would say."""
    return name.replace("_per_cm2", "_density")
