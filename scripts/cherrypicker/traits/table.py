"""Every trait and every column of ``branches.csv``, once: files, pages, batch and docs follow it.

A new trait is a row here and a value in `cherrypicker.traits.measure`; what its truth is stands in
the laboratory (`cherrypicker_lab.traits.table`). Nothing heavy is imported: the batch reads it.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Trait:
    """A number of ``traits.json``."""

    name: str  # its key there
    title: str  # its name on the pages
    power: int | None = 1  # of the length unit; None for a count or a share
    decimals: int = 3  # shown at least, in metric units; a small error adds some
    # is_shown, is_charted: a row of the report and a column of the batch; a chart over a series'
    # dates
    is_shown: bool = False
    is_charted: bool = False
    has_error: bool = False  # with a standard error and a 90 % interval where they can be had
    has_error_column: bool = False  # the standard error is a column of ``traits.csv`` as well

    @property
    def is_cm2(self) -> bool:
        """In square centimetres where there is a scale, else in 1e-4 square units."""
        return self.name.endswith("_cm2")


_SHOWN = {"is_shown": True}
_SURE = {"is_shown": True, "has_error": True}
_ROWS = (
    Trait("height_m", "Height", is_charted=True, has_error_column=True, **_SURE),
    Trait(
        "trunk_diameter_m", "Trunk diameter", 1, 4, is_charted=True, has_error_column=True, **_SURE
    ),
    Trait("trunk_height_m", "Height of that diameter", 1, 2, **_SHOWN),
    Trait("tcsa_cm2", "Trunk cross-section area", 2, 1, has_error_column=True, **_SURE),
    Trait("crown_width_m", "Crown width", **_SURE),
    Trait("crown_volume_m3", "Crown volume", 3, 3, is_charted=True, **_SURE),
    Trait("crown_projected_area_m2", "Projected area of the crown", 2),
    Trait("crown_alpha_m", "Widest hollow of the alpha volume"),
    Trait("crown_alpha_volume_m3", "Alpha volume of the crown", 3),
    Trait("total_length_m", "Total length of wood", 1, 2, is_charted=True, **_SHOWN),
    Trait("n_junctions", "Junctions", None, 0, **_SHOWN),
    Trait("n_tips", "Tips", None, 0, **_SHOWN),
    Trait("wood_volume_m3", "Volume of wood", 3),
    Trait("n_shoots", "Shoots", None, 0),
    Trait("mean_shoot_length_m", "Mean length of shoots"),
    Trait("lateral_spacing_m", "Spacing of laterals"),
    Trait("trunk_end_height_m", "Height of the trunk's end", 1, 2),
    Trait("photo_precision", "Skeleton that the photos do not refute, share", None, 3, **_SHOWN),
    Trait("photo_recall", "Thin wood of the photos in the skeleton, share", None, 3, **_SHOWN),
    Trait("photo_sky_share", "Skeleton with sky behind it in the photos, share", None, 2),
    Trait("n_photos", "Photos that judge the skeleton", None, 0),
)
#: Name to trait, in the pages' order.
TRAITS = {trait.name: trait for trait in _ROWS}


@dataclass(frozen=True)
class BranchColumn:
    """A column of ``branches.csv``."""

    name: str
    kind: str = "number"  # {"number", "maybe", "whole", "text"}: ``maybe`` is a number or empty
    title: str = ""  # its head on the report's table of axes; empty where it is not shown
    decimals: int = 3  # shown there

    @property
    def decimals_in_file(self) -> int:
        """Lengths to 0.01 mm, angles to 0.01 degrees."""
        if self.name.endswith(("_deg", "_per_m")):
            return 2
        return 8 if self.name.endswith("_m3") else 5

    def read(self, text: str) -> float | int | str | None:
        """Return a cell's value; None where an axis has no such number."""
        if self.kind == "maybe" and not text:
            return None
        return {"text": str, "whole": int}.get(self.kind, float)(text)


_COLUMNS = (
    BranchColumn("branch_id", "whole", "axis"),
    BranchColumn("parent_id", "whole", "parent"),
    BranchColumn("order", "whole", "order"),
    BranchColumn("length_m", title="length"),
    BranchColumn("chord_m", title="chord"),
    BranchColumn("base_diameter_m", title="base diameter", decimals=4),
    BranchColumn("tip_diameter_m", title="tip diameter", decimals=4),
    BranchColumn("insertion_angle_deg", title="insertion angle", decimals=1),
    BranchColumn("azimuth_deg", title="azimuth", decimals=1),
    BranchColumn("base_height_m", title="base height"),
    BranchColumn("mean_diameter_m"),
    BranchColumn("taper_mm_per_m"),
    BranchColumn("volume_m3"),
    BranchColumn("n_laterals", "whole"),
    BranchColumn("lateral_spacing_m", "maybe"),
    BranchColumn("shoot_length_m"),
    BranchColumn("base_arc_deg"),
    BranchColumn("base_n_points", "whole"),
    BranchColumn("gap_share"),
    BranchColumn("flags", "text", "flags"),
    BranchColumn("base_diameter_low_m", "maybe"),
    BranchColumn("base_diameter_high_m", "maybe"),
    BranchColumn("insertion_angle_low_deg", "maybe"),
    BranchColumn("insertion_angle_high_deg", "maybe"),
    BranchColumn("photo_diameter_m", "maybe"),
    BranchColumn("photo_diameter_se_m", "maybe"),
)
#: Name to column, in the file's order.
BRANCH_COLUMNS = {column.name: column for column in _COLUMNS}
