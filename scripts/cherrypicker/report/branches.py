"""What the page says of axes and limbs: ``branches.csv``, and sums of light and bearing wood."""

from __future__ import annotations

from collections.abc import Sequence

from cherrypicker.report.text import tell, tell_all
from cherrypicker.traits.table import BRANCH_COLUMNS, BranchColumn
from cherrypicker.units import unit_name

_FLAGS = {
    "low_arc": "points on under half of its girth",
    "few_points": "few points at its base",
    "gap": "bridges gaps in the points",
}
_RANKED = (BranchColumn("rank", "whole", "rank"), BranchColumn("branch_id", "whole", "axis"))
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
    BranchColumn("shoots_per_cm2", title="shoots a cm²", decimals=2),
    BranchColumn("spurs_per_cm2", title="spurs a cm²", decimals=2),
    BranchColumn("bearing_length_m_per_cm2", title="bearing length a cm²"),
]


def branch_table(rows: list[dict]) -> dict:
    """The table of axes, the longest first within an order: its ``columns`` and ``rows``."""
    columns = [column for column in BRANCH_COLUMNS.values() if rows and column.name in rows[0]]
    ordered = sorted(rows, key=lambda row: (row["order"], -row["length_m"]))
    return {"columns": columns, "rows": ordered}


def limb_sums(columns: Sequence[BranchColumn], tree: dict | None) -> dict | None:
    """A table of limbs by rank, each with all that it carries, and of the ``tree``, as it is told.

    Parameters
    ----------
    tree : dict or None
        Sums by the names of columns, and ``limbs``, the same of each; None where none was told.
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
