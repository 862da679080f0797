"""Every column of ``pruning.csv``; nothing heavy is imported, since the pages read it."""

from functools import partial

from cherrypicker.traits.table import BranchColumn

_column = partial(BranchColumn, decimals=2)  # one with a title is on the page
_COLUMNS = (
    _column("cut", "whole", "cut"),
    _column("branch_id", "whole", "axis"),
    _column("node", "whole"),
    _column("kind", "text", "kind"),
    _column("reasons", "text", "why"),
    _column("along_m", title="at"),
    _column("height_m", title="height"),
    *(_column(name) for name in ("x_m", "y_m", "z_m")),
    BranchColumn("diameter_m", title="diameter"),
    *(_column(name, "maybe") for name in ("diameter_low_m", "diameter_high_m")),
    _column("removed_length_m", title="wood off"),
    _column("removed_volume_m3"),
    _column("ratio_after", title="ratio after"),
    _column("ratio_low", "maybe", "from"),
    _column("ratio_high", "maybe", "to"),
    _column("n_limbs_after", "whole", "limbs"),
    _column("length_after_m", title="wood left"),
    *(_column(name, "maybe") for name in ("length_low_m", "length_high_m")),
    _column("n_tips_after", "whole", "tips"),
    _column("shoots_after", "maybe", "shoots"),
    _column("bearing_length_after_m", "maybe", "bearing wood left"),
    _column("height_after_m", title="height after"),
    BranchColumn("sky_share_after", "maybe", "sky after"),
    _column("season_mj_after", "maybe", "MJ after"),
    _column("volume_after_m3"),
    *(_column(name, "maybe") for name in ("volume_low_m3", "volume_high_m3")),
)
#: Name to column, in the file's order.
CUT_COLUMNS = {column.name: column for column in _COLUMNS}
