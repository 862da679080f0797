"""Traits of a tree: trunk diameters, height, crown, lengths and branches, with uncertainties."""

from cherrypicker.traits.branches import BRANCH_COLUMNS, branch_rows, branches_csv, totals_by_order
from cherrypicker.traits.crown import alpha_volume, horizontal_width, projected_area
from cherrypicker.traits.foot import Foot, find_foot
from cherrypicker.traits.measure import measure_traits
from cherrypicker.traits.stem_fit import ConeFit, fit_cone, search_circle
from cherrypicker.traits.support import Support, find_support
from cherrypicker.traits.trunk import TrunkDiameter, measure_diameter

__all__ = [
    "BRANCH_COLUMNS",
    "ConeFit",
    "Foot",
    "Support",
    "TrunkDiameter",
    "alpha_volume",
    "branch_rows",
    "branches_csv",
    "find_foot",
    "find_support",
    "fit_cone",
    "horizontal_width",
    "measure_diameter",
    "measure_traits",
    "projected_area",
    "search_circle",
    "totals_by_order",
]
