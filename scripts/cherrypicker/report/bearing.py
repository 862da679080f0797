"""Light and bearing wood along the axes, as the view shows them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cherrypicker.bearing.measure import KINDS
from cherrypicker.skeleton import Skeleton, axes
from cherrypicker.traits.table import BRANCH_COLUMNS, BranchColumn

#: What the view reads of ``light.csv`` and of ``bearing.csv``.
SKY_COLUMNS = {
    "branch_id": BRANCH_COLUMNS["branch_id"],
    "sky_share": BranchColumn("sky_share", "maybe"),
}
PIECE_COLUMNS = {
    "branch_id": BRANCH_COLUMNS["branch_id"],
    "start_m": BranchColumn("start_m"),
    "end_m": BranchColumn("end_m"),
    "kind": BranchColumn("kind", "text"),
    "age_years": BranchColumn("age_years", "whole"),
}


def node_wood(
    skeleton: Skeleton, pieces: Sequence[dict] | None
) -> tuple[np.ndarray, np.ndarray] | None:
    """Kind and age of the wood below each node, (n_nodes,) uint8; 255 where no piece tells.

    Parameters
    ----------
    pieces : sequence of dict, optional
        Rows of ``bearing.csv``; without them there is None. A kind is its place in `KINDS`.
    """
    if pieces is None:
        return None
    kind, age = (np.full(len(skeleton), 255, dtype=np.uint8) for _ in range(2))
    axis_list = axes(skeleton)
    for piece in pieces:
        nodes = axis_list[piece["branch_id"]].nodes
        middle = np.cumsum(skeleton.edge_length[nodes]) - 0.5 * skeleton.edge_length[nodes]
        inside = nodes[(middle >= piece["start_m"]) & (middle <= piece["end_m"])]
        kind[inside], age[inside] = KINDS.index(piece["kind"]), min(piece["age_years"], 254)
    return kind, age
