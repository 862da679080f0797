"""Every trait and every column of ``branches.csv`` and ``limbs.csv``, once: files, pages, batch and
docs follow it.

A new trait is a row here, with the number that it reads off a
`cherrypicker.traits.measure.ScannedTree`; what its truth is stands in the laboratory
(`cherrypicker_lab.traits.cases`). Nothing heavy is imported: the batch reads it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import pi
from statistics import fmean, median
from typing import Any

from cherrypicker.units import unit_of


@dataclass(frozen=True)
class Trait:
    """A number of ``traits.json``."""

    name: str  # its key there, which ends in its unit
    title: str  # its name on the pages
    definition: str  # for the dictionary of ``traits.csv``; docs/traits.md says more
    # Of a `ScannedTree`: an `Estimate`, or a number without an error; without it the trait is what
    # the check of the photos says by its name
    value: Callable[[Any], Any] | None = None
    decimals: int = 3  # shown at least, in metric units; a small error adds some
    is_shown: bool = False  # a row of the report, a column and a chart of the batch
    has_error: bool = False  # with a standard error and a 90 % interval where they can be had
    digits: int = 6  # rounded to in ``traits.json``

    @property
    def unit(self) -> str:
        """Its unit in a scan with a scale, as the tables spell it; "1" for a number without."""
        return unit_of(self.name)[0]

    @property
    def power(self) -> int | None:
        """Of the length unit; None for a count or a share, 0 for a ratio."""
        return unit_of(self.name)[1]

    @property
    def is_count(self) -> bool:
        """Whether it is a whole number."""
        return self.power is None and self.decimals == 0


_SURE = {"is_shown": True, "has_error": True}
_ROWS = (
    Trait(
        "height_m",
        "Height",
        "third highest wood point that the skeleton supports, or the likely end of a shoot that "
        "reaches higher, over the stem's foot",
        lambda t: t.height,
        **_SURE,
    ),
    Trait(
        "trunk_diameter_m",
        "Trunk diameter",
        "diameter of the circle of the area that the outline of the stem's points encloses in a "
        "slab across its axis, at trunk_height_m",
        lambda t: t.diameter(t.trunk),
        decimals=4,
        **_SURE,
    ),
    Trait(
        "trunk_height_m",
        "Height of that diameter",
        "height over the stem's foot at which the trunk diameter is measured",
        lambda t: t.trunk.height,
        decimals=2,
        is_shown=True,
    ),
    Trait(
        "tcsa_cm2",
        "Trunk cross-section area",
        "pi / 4 times the square of the trunk diameter",
        lambda t: t.diameter(t.trunk).circle_area(),
        decimals=1,
        **_SURE,
    ),
    Trait(
        "crown_width_m",
        "Crown width",
        "mean of the crown's widest horizontal extent and the one across it, with the likely ends"
        " of its shoots",
        lambda t: t.crown_width,
        **_SURE,
    ),
    Trait(
        "crown_volume_m3",
        "Crown volume",
        "convex hull of the crown's points (all but the stem below its lowest limb), with the "
        "likely ends of its shoots",
        lambda t: t.crown_volume,
        **_SURE,
    ),
    Trait(
        "crown_base_height_m",
        "Height of the crown's base",
        "where the lowest limb leaves the stem, over the stem's foot",
        lambda t: t.crown_base_height,
        decimals=2,
    ),
    Trait(
        "crown_projected_area_m2",
        "Projected area of the crown",
        "convex hull of the crown's points seen from above",
        lambda t: t.crown_projected_area,
    ),
    Trait(
        "crown_alpha_m",
        "Widest hollow of the alpha volume",
        "largest circumsphere's radius of the tetrahedra of the alpha volume",
        lambda t: t.crown_alpha,
    ),
    Trait(
        "crown_alpha_volume_m3",
        "Alpha volume of the crown",
        "tetrahedra of the crown's Delaunay mesh whose circumspheres' radius is at most "
        "crown_alpha_m",
        lambda t: t.crown_alpha_volume,
    ),
    Trait(
        "crown_cone_volume_m3",
        "Crown volume by the cone's formula",
        "pi / 12 times the square of the crown's width times its depth, from its base to the "
        "tree's height",
        lambda t: pi / 12 * t.crown_box,
    ),
    Trait(
        "crown_ellipsoid_volume_m3",
        "Crown volume by the ellipsoid's formula",
        "pi / 6 times the square of the crown's width times its depth, from its base to the "
        "tree's height",
        lambda t: pi / 6 * t.crown_box,
    ),
    Trait(
        "crown_contour_volume_m3",
        "Crown volume by its contour",
        "eight sectors around the stem at each of five levels, each as wide as the farthest crown"
        " point in it",
        lambda t: t.crown_contour,
    ),
    Trait(
        "tree_row_volume_m3_ha",
        "Tree row volume",
        "height times crown width times 10,000 m2 over the distance of the rows; configs with "
        "traits.row_distance_m alone",
        lambda t: t.tree_row_volume,
        decimals=0,
        digits=1,
    ),
    Trait(
        "n_limbs",
        "Limbs",
        "axes that leave the stem and come traits.min_limb_m clear of its surface",
        lambda t: len(t.limbs),
        decimals=0,
        is_shown=True,
    ),
    Trait(
        "limb_area_cm2",
        "Limbs' cross-section area",
        "sum of the cross-sections of the limbs 2.5 cm beyond the stem's surface",
        lambda t: t.limb_area,
        decimals=1,
        has_error=True,
    ),
    Trait(
        "limb_trunk_ratio",
        "Limb-to-trunk ratio",
        "limbs' cross-section area over the stem's at limb_trunk_height_m",
        lambda t: t.limb_trunk_ratio,
        decimals=2,
        **_SURE,
    ),
    Trait(
        "limb_trunk_height_m",
        "Height of the trunk's area of that ratio",
        "0.30 m over the graft union where traits.graft_height_m tells it, else the height of the"
        " trunk diameter",
        lambda t: t.limb_trunk.height,
        decimals=2,
    ),
    Trait(
        "branching_index_per_m",
        "Branching index",
        "side axes over the total length of wood",
        lambda t: (len(t.rows) - 1) / t.total_length,
        decimals=2,
    ),
    Trait(
        "total_length_m",
        "Total length of wood",
        "length of the skeleton",
        lambda t: t.sums.length(),
        decimals=2,
        **_SURE,
    ),
    Trait(
        "n_junctions",
        "Junctions",
        "nodes of the skeleton above its root where branches part",
        lambda t: t.n_junctions,
        decimals=0,
        is_shown=True,
    ),
    Trait(
        "n_tips",
        "Tips",
        "ends of the skeleton",
        lambda t: t.tips,
        decimals=0,
        **_SURE,
    ),
    Trait(
        "wood_volume_m3",
        "Volume of wood",
        "sum of the cone frusta between the nodes of each axis",
        lambda t: t.sums.volume(),
        digits=8,
        has_error=True,
    ),
    Trait(
        "n_shoots",
        "Shoots",
        "side axes",
        lambda t: t.sums.number(t.sums.order > 0),
        decimals=0,
        has_error=True,
    ),
    Trait(
        "mean_shoot_length_m",
        "Mean length of shoots",
        "mean way of the side axes from their last lateral to their tip",
        lambda t: fmean(t.shoots) if t.shoots else 0.0,
    ),
    Trait(
        "lateral_spacing_m",
        "Spacing of laterals",
        "median over the axes of the median way between successive laterals",
        lambda t: median(t.spacings) if t.spacings else None,
    ),
    Trait(
        "trunk_end_height_m",
        "Height of the trunk's end",
        "where the trunk's axis ends, over the stem's foot",
        lambda t: t.stem.height[-1],
        decimals=2,
    ),
    Trait(
        "photo_precision",
        "Skeleton that the photos do not refute, share",
        "mean probability over the skeleton's length of being there, by all photos together; "
        "scans from photos alone",
        is_shown=True,
    ),
    Trait(
        "photo_recall",
        "Thin wood of the photos in the skeleton, share",
        "length of skeleton that is there by the photos, over that and the thin wood that it "
        "lacks: what they show before the sky, and a share of what has no sky behind it; scans "
        "from photos alone",
        is_shown=True,
    ),
    Trait(
        "photo_sky_share",
        "Skeleton with sky behind it in the photos, share",
        "share of the skeleton's length that stands before the sky in the photos, where they can "
        "judge it; scans from photos alone",
        decimals=2,
    ),
    Trait(
        "n_photos",
        "Photos that judge the skeleton",
        "photos that judge the skeleton; scans from photos alone",
        decimals=0,
    ),
    Trait(
        "photo_confirmed",
        "Wood that photos confirm, share",
        "share of the length of the skeleton and of the wood that it lacks that photos confirm: "
        "where it is low, much is refuted, missing or out of sight; scans from photos alone",
        decimals=2,
    ),
)
#: Name to trait, in the pages' order.
TRAITS = {trait.name: trait for trait in _ROWS}


def ends_of(name: str) -> tuple[str, str]:
    """Return the columns that hold the ends of the 90 % interval of another."""
    stem, _, unit = name.rpartition("_")
    return f"{stem}_low_{unit}", f"{stem}_high_{unit}"


@dataclass(frozen=True)
class BranchColumn:
    """A column of ``branches.csv`` or ``limbs.csv``."""

    name: str
    kind: str = "number"  # {"number", "maybe", "whole", "text"}: ``maybe`` is a number or empty
    title: str = ""  # its head on the report's table of axes; empty where it is not shown
    decimals: int = 3  # shown there

    @property
    def decimals_in_file(self) -> int:
        """Lengths to 0.01 mm, angles to 0.01 degrees, areas to 0.1 mm²."""
        if self.name.endswith(("_deg", "_per_m")):
            return 2
        if self.name.endswith("_cm2"):
            return 3
        return 8 if self.name.endswith("_m3") else 5

    def read(self, text: str) -> float | int | str | None:
        """Return a cell's value; None where an axis has no such number."""
        if self.kind == "maybe" and not text:
            return None
        return {"text": str, "whole": int}.get(self.kind, float)(text)

    def write(self, value: float | str | None) -> int | str:
        """Return a value's cell; empty where there is no such number."""
        if value is None or isinstance(value, int | str):
            return "" if value is None else value
        return f"{value:.{self.decimals_in_file}f}"


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
    BranchColumn("p_exists", "maybe", "there", decimals=2),
)
#: Name to column, in the file's order.
BRANCH_COLUMNS = {column.name: column for column in _COLUMNS}
_LIMB_COLUMNS = (
    BranchColumn("rank", "whole", "rank"),
    BranchColumn("branch_id", "whole", "axis"),
    BranchColumn("area_cm2", title="area", decimals=1),
    BranchColumn("diameter_m", title="diameter", decimals=4),
    BranchColumn("diameter_low_m", "maybe"),
    BranchColumn("diameter_high_m", "maybe"),
    BranchColumn("height_m", title="height", decimals=2),
    BranchColumn("azimuth_deg", title="azimuth", decimals=0),
    BranchColumn("crotch_angle_deg", title="crotch angle", decimals=0),
    BranchColumn("crotch_angle_low_deg", "maybe"),
    BranchColumn("crotch_angle_high_deg", "maybe"),
    BranchColumn("wood_length_m", title="wood on it", decimals=2),
    BranchColumn("wood_volume_m3"),
    BranchColumn("area_share"),
    BranchColumn("ratio_without", title="ratio without", decimals=2),
    BranchColumn("flags", "text", "flags"),
)
#: The same of ``limbs.csv``.
LIMB_COLUMNS = {column.name: column for column in _LIMB_COLUMNS}
