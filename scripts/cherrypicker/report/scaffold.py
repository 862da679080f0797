"""The limbs' section of a tree's page: the pruner's table, and what is left when limbs go."""

import numpy as np

from cherrypicker.geometry.hulls import hull_of
from cherrypicker.report.text import script_json
from cherrypicker.skeleton import axes, axis_of_node
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.traits.limb_table import limb_of_axis
from cherrypicker.traits.table import LIMB_COLUMNS, TRAITS
from cherrypicker.units import unit_name

_FORMS = (
    *(f"crown_{form}volume_m3" for form in ("", "alpha_", "contour_", "ellipsoid_", "cone_")),
    *("crown_base_height_m", "tree_row_volume_m3_ha", "branching_index_per_m"),
)
# Columns of a limb that the page's script reckons with
_OF_LIMB = (
    *("branch_id", "rank", "area_cm2", "diameter_m", "height_m", "azimuth_deg"),
    *("wood_length_m", "wood_volume_m3"),
)


def limb_section(traits: dict, rows: list[dict] | None, skeleton: Skeleton) -> dict | None:
    """What ``scaffold.html.j2`` shows of ``traits.json`` and the `rows` of ``limbs.csv``.

    None for a tree without limbs. The rows number the axes of the skeleton.
    """
    if not rows:
        return None
    unit, classes = traits.get("unit", "m"), []
    factor, word = (1e3, "mm") if unit == "m" else (1.0, unit_name(unit))
    for name, count in traits.get("n_limbs_by_diameter", {}).items():
        low, high = (f"{float(end) * factor:g}" if end else "" for end in name.split("-"))
        classes.append((f"{low} to {high} {word}" if high else f"{low} {word} and more", count))
    return {
        "traits": traits,
        "unit": unit,
        "classes": classes,
        "forms": [TRAITS[name] for name in _FORMS],
        "columns": [column for column in LIMB_COLUMNS.values() if column.title],
        "rows": rows,
        "what_if": script_json(_what_if(traits, rows, skeleton, unit)),
    }


def _what_if(traits: dict, rows: list[dict], skeleton: Skeleton, unit: str) -> dict:
    """What the page's script reckons with: of each limb and of the stem what they add to the tree.

    The crown's width and volume are those of the hulls of the skeleton's nodes, told as a share of
    the traits.
    """
    axis_list = axes(skeleton)
    limbs = [row["branch_id"] for row in rows]
    carried = limb_of_axis(axis_list, limbs)
    carrier = carried[axis_of_node(skeleton, axis_list)]
    is_wood = skeleton.fields.get("gap", np.zeros(len(skeleton))) == 0
    foot_z = traits["foot"][2]
    base_z = foot_z + (traits.get("crown_base_height_m") or 0.0)
    of_stem = (carrier < 0) & (skeleton.points[:, 2] >= base_z) & is_wood
    middle = np.append(skeleton.points[0, :2], foot_z)
    return {
        "unit": unit_name(unit),
        "ratio": traits["limb_trunk_ratio"],
        "area": sum(row["area_cm2"] for row in rows),
        "crown_volume": traits["crown_volume_m3"],
        "crown_width": traits["crown_width_m"],
        "stem": {
            "wood_length_m": traits["total_length_m"] - sum(row["wood_length_m"] for row in rows),
            "wood_volume_m3": traits["wood_volume_m3"] - sum(row["wood_volume_m3"] for row in rows),
            "hull": _corners(skeleton.points[of_stem] - middle),
        },
        "limbs": [
            {name: row[name] for name in _OF_LIMB}
            | {"hull": _corners(skeleton.points[(carrier == row["branch_id"]) & is_wood] - middle)}
            for row in rows
        ],
    }


def _corners(points: np.ndarray) -> list[list[float]]:
    """The points that the hull of all has for corners, rounded."""
    return np.round(np.unique(hull_of(points).points, axis=0), 3).tolist()
