"""The pruner's table of a tree: its limbs by size, and what their wood is to the stem's.

The limb-to-trunk ratio is the sum of the limbs' cross-sections 2.5 cm beyond the stem's surface
over the stem's (Schupp et al., HortScience 52(9):1233-1240, 2017). Pruning to a ratio takes the
largest limbs first, so every row tells what is left when it and all larger ones go.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from cherrypicker.geometry.error_terms import Terms
from cherrypicker.skeleton import Axis
from cherrypicker.traits.intervals import CM2, Estimate, diameter_terms
from cherrypicker.traits.scaffold import Limb, Scaffold


def limb_of_axis(axis_list: list[Axis], limbs: list[int]) -> np.ndarray:
    """The limb that carries each axis, (n_axes,) int64: its own axis's number, -1 for none.

    The axes are those of `cherrypicker.skeleton.axes`, parents before children; `limbs` are the
    numbers of those that start limbs.
    """
    carried = np.full(len(axis_list), -1, dtype=np.int64)
    carried[limbs] = limbs
    for index, axis in enumerate(axis_list):
        if axis.parent >= 0 and carried[index] < 0:
            carried[index] = carried[axis.parent]
    return carried


def squares_terms(limbs: list[Limb]) -> dict[str, float]:
    """What the error of the sum of the limbs' squared diameters follows.

    Each fit errs for itself; surfaces that are moved as a whole move all limbs alike. None where it
    is not known how a limb's points scatter.
    """
    if not limbs or not all(limb.scatter for limb in limbs):
        return {}
    diameter, error, scatter = np.array([(b.diameter, b.error, b.scatter) for b in limbs]).T
    slope = 2.0 * diameter
    return {
        "fit": float(np.linalg.norm(slope * 2.0 * error)),
        "diameter_shared": float(slope @ scatter),
    }


def ratio_terms(
    squares: Mapping[str, float], ratio: float, stem_diameter: float, stem: Terms
) -> dict[str, float]:
    """What the error of the limb-to-trunk ratio follows; none where a part of it is not known.

    `squares` are from `squares_terms`, `stem` is what the error of the stem's diameter follows.
    """
    if not squares or not stem:
        return {}
    slope, area = 2.0 * ratio / stem_diameter, stem_diameter**2
    return {
        name: float(np.hypot(slope * stem.get(name, 0.0), squares.get(name, 0.0) / area))
        for name in {**stem, **squares}
    }


def by_diameter(limbs: list[Limb], bounds: Sequence[float]) -> dict[str, int]:
    """Number of limbs by class of diameter; `bounds` part the classes."""
    ends = [f"{bound:g}" for bound in sorted(bounds)]
    names = [f"{low}-{high}" for low, high in zip(["0", *ends], [*ends, ""], strict=True)]
    count, _ = np.histogram([limb.diameter for limb in limbs], [0.0, *sorted(bounds), np.inf])
    return dict(zip(names, count.tolist(), strict=True))


def limb_rows(
    scaffold: Scaffold,
    branches: list[dict],
    stem_diameter: float,
    foot_z: float,
    *,
    scale_error: float = 0.0,
) -> list[dict]:
    """The rows of ``limbs.csv``, the thickest limb first, keys as in `LIMB_COLUMNS`.

    ``branches`` are the rows of ``branches.csv``, one an axis. Limbs are compared with the stem's
    diameter. ``foot_z`` is the height of the stem's foot in the skeleton's frame, ``scale_error``
    the relative standard error of the scan's scale, for the intervals.
    """
    limbs, points = scaffold.limbs, scaffold.skeleton.points
    carried = limb_of_axis(scaffold.axes, [limb.axis for limb in limbs])
    left = total = sum(limb.diameter**2 for limb in limbs)
    rows: list[dict] = []
    for limb in sorted(limbs, key=lambda limb: (-limb.diameter, limb.axis)):
        branch = branches[limb.axis]
        own = [branches[axis] for axis in np.flatnonzero(carried == limb.axis)]
        left -= limb.diameter**2
        terms = diameter_terms(limb.diameter, limb.error, limb.scatter) if limb.scatter else {}
        low, high = Estimate.of(limb.diameter, terms, scale=scale_error).ends or (None, None)
        rows.append(
            {
                "rank": len(rows) + 1,
                "branch_id": limb.axis,
                "area_cm2": np.pi / 4 * CM2 * limb.diameter**2,
                "diameter_m": limb.diameter,
                "diameter_low_m": low,
                "diameter_high_m": high,
                "height_m": points[limb.stem_node, 2] - foot_z,
                "azimuth_deg": branch["azimuth_deg"],
                "crotch_angle_deg": branch["insertion_angle_deg"],
                "crotch_angle_low_deg": branch["insertion_angle_low_deg"],
                "crotch_angle_high_deg": branch["insertion_angle_high_deg"],
                "wood_length_m": sum(row["length_m"] for row in own),
                "wood_volume_m3": sum(row["volume_m3"] for row in own),
                "area_share": limb.diameter**2 / total,
                "ratio_without": max(left, 0.0) / stem_diameter**2,
                "flags": branch["flags"],
            }
        )
    return rows
