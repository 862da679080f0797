"""What a person may measure by hand: its name, its unit, and which values make sense.

Traits of the tree and columns of ``branches.csv`` keep their names and titles
(`cherrypicker.traits.table`); the unit of a measurement stands in a column of its own, so that a
name is understood without its unit as well. Nothing heavy is imported: the batch reads it.
"""

import math
from dataclasses import dataclass

from cherrypicker.traits.table import BRANCH_COLUMNS, TRAITS
from cherrypicker.units import UNITS_M, unit_of

#: Kind of a quantity to its units, each in the kind's first.
UNITS: dict[str, dict[str, float]] = {
    "length": {**UNITS_M, "in": 0.0254},
    "area": {"m2": 1.0, "dm2": 1e-2, "cm2": 1e-4, "mm2": 1e-6},
    "volume": {"m3": 1.0, "dm3": 1e-3, "l": 1e-3, "cm3": 1e-6},
    "angle": {"deg": 1.0, "rad": math.degrees(1.0)},
    "count": {"1": 1.0},
}
_SPELLINGS = {"²": "2", "³": "3", "°": "deg", '"': "in", "inch": "in", "grad": "deg"}
_SIGNS = {"cm2": "cm²", "m2": "m²", "m3": "m³", "dm3": "dm³", "deg": "°"}
_DECIMALS = {"m": 2, "m2": 2, "m3": 2}  # on the pages


@dataclass(frozen=True)
class Quantity:
    """Something that is measured by hand and by us."""

    name: str  # in the tables
    title: str  # on the pages
    # low, high: in its unit; what lies outside is no fruit tree's. Guesses, a factor of three and
    # more beyond what orchards show: they are for units, not for outliers
    low: float
    high: float
    column: str = ""  # of branches.csv that has it; empty for a trait of the tree
    shown_in: str = ""  # unit on the pages, where it is another
    at_place: bool = False  # a diameter where the calliper was put, from the skeleton itself

    @property
    def unit(self) -> str:
        """The unit that all its values are in: the end of its name, or 1."""
        return unit_of(self.name)[0]

    @property
    def short_name(self) -> str:
        """The name without its unit."""
        return self.name if self.unit == "1" else self.name.rpartition("_")[0]

    @property
    def units(self) -> dict[str, float]:
        """The units that it may be given in, each in its own."""
        kind = next(units for units in UNITS.values() if self.unit in units)
        return {unit: factor / kind[self.unit] for unit, factor in kind.items()}

    def shown(self, value: float, *, sign: str = "-") -> str:
        """Return a value with its unit on the pages, with a plus where `sign` is one."""
        unit = self.shown_in or self.unit
        text = f"{value / self.units[unit]:{sign}z,.{_DECIMALS.get(unit, 1)}f}"
        return text if unit == "1" else f"{text} {_SIGNS.get(unit, unit)}"

    @property
    def is_on_branch(self) -> bool:
        """Whether it needs a place on the tree."""
        return bool(self.column) or self.at_place


def _trait(name: str, low: float, high: float, shown_in: str = "") -> Quantity:
    return Quantity(name, TRAITS[name].title, low, high, shown_in=shown_in)


def _column(name: str, column: str, low: float, high: float, shown_in: str = "") -> Quantity:
    return Quantity(name, f"Branch: {BRANCH_COLUMNS[column].title}", low, high, column, shown_in)


_ROWS = (
    _trait("height_m", 0.2, 30.0, "cm"),
    _trait("trunk_diameter_m", 0.004, 1.5, "mm"),
    _trait("tcsa_cm2", 0.1, 20_000.0),
    _trait("crown_width_m", 0.05, 25.0, "cm"),
    _trait("crown_volume_m3", 0.001, 3000.0),
    _trait("crown_projected_area_m2", 0.005, 500.0),
    _trait("total_length_m", 0.2, 10_000.0),
    _trait("wood_volume_m3", 1e-5, 20.0, "dm3"),
    _trait("n_junctions", 0.0, 100_000.0),
    _trait("n_tips", 1.0, 100_000.0),
    _trait("n_shoots", 0.0, 100_000.0),
    _trait("mean_shoot_length_m", 0.005, 3.0, "cm"),
    _trait("trunk_end_height_m", 0.05, 30.0, "cm"),
    Quantity(
        "branch_diameter_m", "Branch: diameter at a place", 0.001, 0.8, shown_in="mm", at_place=True
    ),
    _column("branch_base_diameter_m", "base_diameter_m", 0.001, 0.8, "mm"),
    _column("branch_length_m", "length_m", 0.01, 20.0, "cm"),
    _column("branch_angle_deg", "insertion_angle_deg", 0.0, 180.0),
)
#: Name to quantity, in the pages' order.
QUANTITIES = {quantity.name: quantity for quantity in _ROWS}
#: Every name that the table of measures may hold, with its unit and without.
NAMES = QUANTITIES | {quantity.short_name: quantity for quantity in _ROWS}


def known_unit(text: str) -> str:
    """Return a unit as `UNITS` spells it: "cm²" is "cm2"; empty is a count's."""
    for spelling, plain in _SPELLINGS.items():
        text = text.replace(spelling, plain)
    return text.strip() or "1"
