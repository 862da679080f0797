"""A tree that people digitised node by node, brought onto ours: a hand measurement a limb.

The tree keeps its size and shape: a turn and a shift bring it onto our skeleton. They are found as
for two scans of one tree (`cherrypicker.series.frame`): foot on foot, every azimuth, then ICP (Besl
and McKay 1992) whose pairs weigh less the farther apart they are. Lengths and angles of limbs are
those of `cherrypicker.traits.branches`, so that both trees are measured in one way.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.accuracy.measures import Measure
from cherrypicker.accuracy.places import TOLERANCE_M, Places
from cherrypicker.accuracy.quantities import QUANTITIES, UNITS
from cherrypicker.errors import StageError
from cherrypicker.files import rounded
from cherrypicker.formats.mtg import read_mtg_nodes
from cherrypicker.geometry.similarity import moved
from cherrypicker.series.frame import find_frame
from cherrypicker.series.wood import sample_wood
from cherrypicker.skeleton import Skeleton, axes
from cherrypicker.skeleton.csv_table import read_nodes, rooted_skeleton
from cherrypicker.skeleton.model import closed_radii
from cherrypicker.traits.branches import axis_shapes


@dataclass(frozen=True)
class Digitised:
    """A digitised tree."""

    file: str | os.PathLike  # that it was read from
    skeleton: Skeleton  # metres; a node without a diameter has its parent's
    is_measured: np.ndarray  # (n_nodes,) bool: which nodes have a diameter of their own


def read_digitised(
    path: str | os.PathLike, unit: str = "m", diameter_unit: str | None = None
) -> Digitised:
    """Read a digitised tree: an MTG where the file ends so, else a table of nodes.

    `read_mtg_nodes` and `read_skeleton_csv` say what these hold. The units are those of
    coordinates, and of diameters where it is another one: m, cm, mm, ft, in, or a number of metres.
    A `StageError` where the file cannot be read, its nodes are not one tree, none has a diameter,
    or a unit is unknown.
    """
    unit_m = _metres(unit, path, "--unit")
    thickness_m = _metres(diameter_unit, path, "--diameter_unit") if diameter_unit else unit_m
    is_mtg = Path(path).suffix.lower() == ".mtg"
    skeleton = rooted_skeleton((read_mtg_nodes if is_mtg else read_nodes)(path), path)
    is_measured = skeleton.radius > 0
    if not is_measured.any():
        raise StageError("no node has a diameter; measure some, one a limb at least", file=path)
    radius = np.where(is_measured, thickness_m * skeleton.radius, np.nan)
    radius = closed_radii(radius, skeleton.parent)
    skeleton = replace(skeleton, points=unit_m * skeleton.points, radius=radius)
    return Digitised(path, skeleton, is_measured)


def _metres(unit: str, path: str | os.PathLike, option: str) -> float:
    try:
        metres = UNITS["length"].get(unit) or float(unit)
    except ValueError:
        metres = 0.0
    if not 0 < metres < np.inf:
        known = ", ".join(UNITS["length"])
        cause = f"{unit!r} is no unit of length; give {known} or metres a unit"
        raise StageError(cause, file=path, key=option)
    return metres


def register(tree: str, theirs: Digitised, ours: Skeleton) -> tuple[Digitised, float, float]:
    """Bring a digitised tree onto our skeleton of it.

    Errors name the tree by its id.

    Returns
    -------
    theirs : Digitised
        In our frame.
    share : float
        Of its length that lies within half of `TOLERANCE_M` of our skeleton.
    residual : float
        Median distance of its length to our skeleton, m.

    Raises
    ------
    StageError
        If it is half as large as ours or twice, as with a wrong unit, or if less than half of its
        length comes to lie on ours.
    """
    reach, own = (
        np.linalg.norm(each.points - each.points[0], axis=1).max()
        for each in (theirs.skeleton, ours)
    )
    if not own / 2 < reach < 2 * own:  # the next unit is off by 2.54 or more
        cause = f"tree {tree}: it reaches {reach:.3g} m from its foot, our skeleton {own:.3g} m"
        raise StageError(f"{cause}; is the unit right?", file=theirs.file, key="--unit")
    wood, other = sample_wood(ours), sample_wood(theirs.skeleton)
    frame = np.linalg.inv(find_frame(other, wood).matrix)
    off = cKDTree(wood.points).query(other.moved(frame).points)[0]
    # Other trees have up to 0.60 of their length within all of the tolerance, 0.31 within half
    share = float(other.length @ (off <= TOLERANCE_M / 2) / other.length.sum())
    if share < 0.5:
        raise StageError(
            f"tree {tree}: {share:.0%} of its length lies within {50 * TOLERANCE_M:.0f} cm of our "
            "skeleton, and half must; is it this tree, with z up, in that unit?",
            file=theirs.file,
            key="--tree or --unit",
        )
    there = replace(theirs.skeleton, points=moved(theirs.skeleton.points, frame))
    return replace(theirs, skeleton=there), share, float(np.median(off))


def limb_measures(
    tree: str, theirs: Digitised, places: Places, who: str = ""
) -> tuple[list[Measure], int]:
    """Return what a digitised tree says, as rows of the table of hand measurements.

    It stands in our frame, see `register`, `tree` is its id in the table, the places are our
    skeleton's, and `who` digitised it.

    Returns
    -------
    rows : list of Measure
        The tree's height, of its trunk a diameter, of each branch with a diameter that diameter,
        its length and its angle, all at the middle one of its nodes with a diameter. Values that
        no fruit tree has are left out.
    n_left_out : int
        Branches that are none: ours at their place is of another order, because it lacks them or
        goes on into another arm of a fork. Their lengths would be those of other limbs.
    """
    skeleton = theirs.skeleton
    axis_list = axes(skeleton)
    shapes = axis_shapes(skeleton, axis_list)
    height = skeleton.points[:, 2].max() - skeleton.points[0, 2]
    found: list[tuple[str, float, Mapping[str, float]]] = [("height_m", height, {})]
    n_left_out = 0
    for row, axis in enumerate(axis_list):
        nodes = axis.nodes[theirs.is_measured[axis.nodes]]
        if not len(nodes):
            continue
        node = nodes[len(nodes) // 2]
        point, diameter = skeleton.points[node], 2 * skeleton.radius[node]
        if axis.order == 0:
            over_foot = {"height_m": rounded(point[2] - places.foot_z)}
            found.append(("trunk_diameter_m", diameter, over_foot))
            continue
        ours = places.at_point(point)
        if ours is None or places.order[ours.branch] != axis.order:
            n_left_out += 1
            continue
        x, y, z = map(rounded, point)
        place = {"x_m": x, "y_m": y, "z_m": z, "order": axis.order}
        found += [
            ("branch_diameter_m", diameter, place),
            ("branch_length_m", shapes["length_m"][row], place),
            ("branch_angle_deg", shapes["insertion_angle_deg"][row], place),
        ]
    note = f"digitised: {Path(theirs.file).name}"
    rows = [
        Measure(tree, quantity, rounded(value), quantity.unit, who, note, at, 0)
        for name, value, at in found
        if (quantity := QUANTITIES[name]).low <= value <= quantity.high
    ]
    return rows, n_left_out
