"""Every column of ``pruning.csv``, and the words for targets.

Nothing heavy is imported: the pages read it.
"""

from __future__ import annotations

from dataclasses import dataclass

from cherrypicker.traits.table import BranchColumn


@dataclass(frozen=True)
class CutColumn(BranchColumn):
    """A column of ``pruning.csv``; one with a title is on the page."""

    decimals: int = 2


_COLUMNS = (
    CutColumn("cut", "whole", "cut"),
    CutColumn("branch_id", "whole", "axis"),
    CutColumn("node", "whole"),
    CutColumn("kind", "text", "kind"),
    CutColumn("reasons", "text", "why"),
    CutColumn("along_m", title="at"),
    CutColumn("height_m", title="height"),
    *(CutColumn(name) for name in ("x_m", "y_m", "z_m")),
    BranchColumn("diameter_m", title="diameter"),
    CutColumn("diameter_low_m", "maybe"),
    CutColumn("diameter_high_m", "maybe"),
    CutColumn("removed_length_m", title="wood off"),
    CutColumn("removed_volume_m3"),
    CutColumn("ratio_after", title="ratio after"),
    CutColumn("ratio_low", "maybe", "from"),
    CutColumn("ratio_high", "maybe", "to"),
    CutColumn("n_limbs_after", "whole", "limbs"),
    CutColumn("length_after_m", title="wood left"),
    CutColumn("n_tips_after", "whole", "tips"),
    CutColumn("height_after_m", title="height after"),
    BranchColumn("sky_share_after", "maybe", "sky after"),
    CutColumn("volume_after_m3"),
    CutColumn("volume_low_m3", "maybe"),
    CutColumn("volume_high_m3", "maybe"),
)
#: Name to column, in the file's order.
CUT_COLUMNS = {column.name: column for column in _COLUMNS}
#: Words for what is limited, or goes by a limit.
TARGET_WORDS = {
    "limb_trunk_ratio": "Limb-to-trunk ratio",
    "n_limbs": "Limbs",
    "length_m_per_cm2": "Wood per cm² of the stem's section [m]",
    "tips_per_cm2": "Tips per cm² of the stem's section",
    "height_m": "Height",
    "row_width_m": "Width across the row",
    "renew_limbs": "Limbs to renew",
    "steep_deg": "Steep limbs",
    "shaded_share": "Shaded limbs",
    "crossing": "Axes that touch",
}
