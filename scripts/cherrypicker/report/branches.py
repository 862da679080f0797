"""What page and view say of axes and limbs: ``branches.csv``, light and bearing wood."""

from collections.abc import Sequence

import numpy as np

from cherrypicker.bearing.measure import KINDS
from cherrypicker.report.text import tell, tell_all
from cherrypicker.skeleton import Skeleton, axes
from cherrypicker.traits.table import BRANCH_COLUMNS, LIMB_COLUMNS, BranchColumn
from cherrypicker.units import unit_name

_FLAGS = {
    "low_arc": "points on under half of its girth",
    "few_points": "few points at its base",
    "gap": "bridges gaps in the points",
}
_RANKED = LIMB_COLUMNS["rank"], LIMB_COLUMNS["branch_id"]
#: Of ``light.json``, the wood and then the leaves.
LIGHT_COLUMNS = [
    BranchColumn(prefix + name, title=words + title, decimals=decimals)
    for prefix, words in (("", ""), ("leaf_", "leaf "))
    for name, title, decimals in (
        ("star", "STAR", 3),
        ("sky_share", "sky share", 3),
        ("shaded_length_m", "shaded", 3),
        ("direct_mj", "direct [MJ]", 1),
        ("diffuse_mj", "diffuse [MJ]", 1),
    )
]
#: Of ``bearing.json``.
BEARING_COLUMNS = [
    BranchColumn("shoots", title="one-year shoots", decimals=1),
    BranchColumn("spurs", title="spurs", decimals=1),
    BranchColumn("shoot_length_m", title="length of shoots", decimals=2),
    BranchColumn("bearing_length_m", title="bearing length", decimals=2),
    BranchColumn("shoot_buds", title="buds found on shoots", decimals=0),
    BranchColumn("shoot_buds_per_m", title="buds a metre of shoot", decimals=0),
    BranchColumn("shoots_per_cm2", title="shoots a cm²", decimals=2),
    BranchColumn("spurs_per_cm2", title="spurs a cm²", decimals=2),
    BranchColumn("bearing_length_m_per_cm2", title="bearing length a cm²"),
]
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


def branch_table(rows: list[dict]) -> dict:
    """The table of axes, the longest first within an order: its ``columns`` and ``rows``."""
    columns = [column for column in BRANCH_COLUMNS.values() if rows and column.name in rows[0]]
    ordered = sorted(rows, key=lambda row: (row["order"], -row["length_m"]))
    return {"columns": columns, "rows": ordered}


def limb_sums(columns: Sequence[BranchColumn], tree: dict | None) -> dict | None:
    """A table of limbs by rank, each with all that it carries, and of the ``tree``, as it is told.

    The ``tree`` holds sums by the names of columns, and ``limbs``, the same of each; None where
    none was told.
    """
    if tree is None:
        return None
    told = [column for column in columns if column.name in tree]
    return {"columns": [*_RANKED, *told], "rows": tree["limbs"], "tree": tree}


def branch_facts(row: dict, unit: str) -> list[tuple[str, str]]:
    """What the view says of a branch: names and texts."""
    flags = [_FLAGS.get(flag, flag.replace("_", " ")) for flag in row.get("flags", "").split()]
    facts = {
        "order": "{order}",
        "parent": "none" if row["parent_id"] < 0 else "{parent_id}",
        "length": "{length_m:.3f} {m}",
        "diameter at the base": "{base_diameter_m:.4f} {m}"
        + tell(" ({base_diameter_low_m:.4f} to {base_diameter_high_m:.4f})", row),
        "at the tip": "{tip_diameter_m:.4f} {m}",
        "angle": "{insertion_angle_deg:.1f}°"
        + tell(" ({insertion_angle_low_deg:.1f} to {insertion_angle_high_deg:.1f})", row),
        "height of its base": "{base_height_m:.3f} {m}",
        "diameter by the photos": "{photo_diameter_m:.4f} {m}",
        "there, by the photos": "{percent:.0f} %",
        "light": "{sky_percent:.0f} % of the sky",
        "cut": "{cuts}",
        "rests on": "{base_n_points:,} points, {base_arc_deg:.0f}° of its girth",
        "flags": "{words}",
    }
    percent, sky_percent = (
        None if row.get(name) is None else 100 * row[name] for name in ("p_exists", "sky_share")
    )
    told = {"percent": percent, "sky_percent": sky_percent, "words": "; ".join(flags) or "none"}
    return tell_all(facts, row | told | {"m": unit_name(unit)})


def node_wood(
    skeleton: Skeleton, pieces: Sequence[dict] | None
) -> tuple[np.ndarray, np.ndarray] | None:
    """Kind and age of the wood below each node, (n_nodes,) uint8; 255 where no piece tells.

    Pieces are rows of ``bearing.csv``; without them there is None. A kind is its place in `KINDS`.
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
