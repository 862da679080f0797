"""Traits of measured trees beside reference measures: tapes, callipers, reference skeletons."""

from pathlib import Path

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.files import cell_number, read_json, read_table
from cherrypicker.skeleton import axes, read_skeleton, read_skeleton_csv
from cherrypicker.traits.intervals import Z90
from cherrypicker_lab.orchard.truth import width_of_wood
from cherrypicker_lab.traits.pairs import NEAR_BASE_M, NEAR_M, as_pair, axis_pairs
from cherrypicker_lab.traits.table import JUDGED, SCALARS

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
TABLE_COLUMNS = ("name", "trait", "value", "unit")


def read_reference_table(path):
    """Read reference measures of whole trees.

    Parameters
    ----------
    path : path-like
        CSV with the columns `name` (of the tree), `trait` (a name of ``traits.json``, with
        ``@height`` for a trunk diameter at that height in metres), `value` and `unit` (m, cm, mm).

    Returns
    -------
    dict of str to dict of str to float
        Tree to trait to value, metres.

    Raises
    ------
    StageError
        If the file cannot be read, or a row has an unknown trait or unit or no number.
    """
    measures = {}
    for number, row in read_table(path, TABLE_COLUMNS):
        trait = row["trait"].strip()
        unit = UNITS.get(row["unit"].strip())
        if unit is None or not _is_known(trait):
            raise StageError(f"row {number}: no trait {trait!r} in {row['unit']!r}", file=path)
        value = unit * cell_number(row["value"], path, number)
        measures.setdefault(row["name"].strip(), {})[trait] = value
    return measures


def _is_known(trait):
    name, _, height = trait.partition("@")
    if height:
        return name == "trunk_diameter_m" and height.replace(".", "", 1).isdigit()
    return name in SCALARS


def skeleton_measures(skeleton, trunk_heights):
    """Traits of a whole tree from its reference skeleton.

    Parameters
    ----------
    skeleton : Skeleton
        Metres; its root is the stem's foot.
    trunk_heights : iterable of float
        Heights over the foot at which the stem's diameter is asked for; those that the stem does
        not reach are left out.

    Returns
    -------
    dict of str to float
        Names as in a table of reference measures.
    """
    points, radius = skeleton.points, skeleton.radius
    stem = axes(skeleton)[0].nodes
    stem_z = np.maximum.accumulate(points[stem, 2]) - points[0, 2]
    measures = {
        "height_m": float(points[:, 2].max() - points[0, 2]),
        "crown_width_m": width_of_wood(points, radius),
        "total_length_m": float(skeleton.edge_length.sum()),
    }
    for height in trunk_heights:
        if height <= stem_z[-1]:
            measures[f"trunk_diameter_m@{height:g}"] = float(
                2 * np.interp(height, stem_z, radius[stem])
            )
    return measures


def compare_results(
    folder, measures=None, skeleton_path=None, *, near_m=NEAR_M, base_m=NEAR_BASE_M
):
    """Put a tree's results beside its reference measures.

    Parameters
    ----------
    folder : path-like
        With ``traits.json``, and for branches ``branches.csv`` and ``skeleton.graphml``.
    measures : dict of str to float, optional
        The tree's row of `read_reference_table`; it comes before what the skeleton says.
    skeleton_path : path-like, optional
        See `read_skeleton_csv`.
    near_m, base_m : float
        How near an axis runs and starts to stand for a reference axis, see `match_axes`.

    Returns
    -------
    dict
        `name`, `traits` (name to a list of pairs), `n_axes` and `n_matched`.

    Raises
    ------
    StageError
        If a file cannot be read, or there is nothing to compare with.
    """
    folder = Path(folder)
    found = read_json(folder / "traits.json")
    reference = None if skeleton_path is None else read_skeleton_csv(skeleton_path)
    diameters = _trunk_diameters(found)
    wanted = {} if reference is None else skeleton_measures(reference, diameters)
    wanted |= measures or {}
    if not wanted:
        raise StageError("no reference measure of this tree", file=folder.name)
    report = {"name": folder.name, "traits": {name: [] for name in JUDGED}}
    for trait, true in wanted.items():
        name, _, height = trait.partition("@")
        if name == "trunk_diameter_m":
            height = float(height) if height else found["trunk_height_m"]
            if height in diameters:
                report["traits"][name].append(as_pair(true, *diameters[height]))
        elif found.get(name) is not None:
            low, high = found.get(f"{name}_ci90") or (None, None)
            report["traits"][name].append(as_pair(true, found[name], low, high))
    report["n_axes"] = report["n_matched"] = 0
    if reference is not None:
        skeleton = read_skeleton(folder / "skeleton.graphml")
        rows = [_numbers(row) for _, row in read_table(folder / "branches.csv", ("branch_id",))]
        pairs, n_axes, n_matched = axis_pairs(
            reference, skeleton, rows, near_m=near_m, base_m=base_m
        )
        report["traits"] |= pairs
        report |= {"n_axes": n_axes, "n_matched": n_matched}
    return report


def _trunk_diameters(found):
    """Height over the foot to diameter and the ends of its 90 % interval.

    Further heights have a standard error alone: their interval is the normal one.
    """
    table = {}
    for height, diameter in found["trunk_diameters"].items():
        reach = Z90 * found["trunk_diameters_se"][height]
        table[float(height)] = (diameter, diameter - reach, diameter + reach)
    low, high = found.get("trunk_diameter_m_ci90") or (None, None)
    table[found["trunk_height_m"]] = (found["trunk_diameter_m"], low, high)
    return table


def _numbers(row):
    """Cells of ``branches.csv`` as numbers, None where empty."""
    return {
        name: None if text == "" else float(text) for name, text in row.items() if name != "flags"
    }
