"""The light's section of a tree's page: the tree, and each limb with all that it carries."""

from __future__ import annotations

import os

from cherrypicker.files import cell_number, read_table
from cherrypicker.report.branches import limb_sums
from cherrypicker.traits.table import BranchColumn

# Of the wood, and with ``leaf_`` before them of the leaves
_TITLES = {
    "star": "STAR",
    "sky_share": "sky share",
    "shaded_length_m": "shaded",
    "direct_mj": "direct [MJ]",
    "diffuse_mj": "diffuse [MJ]",
}


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


def light_section(light: dict | None, unit: str) -> dict | None:
    """What the page shows of ``light.json``, by `limb_sums`; None where no light was measured."""
    if light is None:
        return None
    columns = [
        BranchColumn(prefix + name, title=words + title, decimals=1 if "MJ" in title else 3)
        for prefix, words in (("", ""), ("leaf_", "leaf "))
        for name, title in _TITLES.items()
        if prefix + name in light
    ]
    return limb_sums(columns, light, light["limbs"], unit)
