"""Height and crown of a tree from its wood points, with samples of each.

Both reach as far as the points do, less what noise carries beyond the wood, plus what the scan
lost of the shoots that end there, see `cherrypicker.traits.shoot_ends`. The estimates are the
medians of the samples. All shoots grow at once, since another may reach nearly as far.

Wood that is known to be missing (photos show it, or the cloud holds it and the skeleton does not)
widens the intervals upwards; the values stay those of the wood that was found.
"""

import numpy as np
from scipy.stats import binned_statistic_2d

from cherrypicker.evidence.missing_top import VOXEL, MissingTop
from cherrypicker.geometry.error_terms import FACTORS
from cherrypicker.geometry.hulls import Hull, hull_of, reach_around, width_of
from cherrypicker.geometry.neighbors import RANK
from cherrypicker.traits.reports import Reports

_N_RADIALS, _N_LEVELS = 8, 5  # of the contour (Culver and Till 1967)


def grown(hull: Hull, further: np.ndarray, overshoot: float = 0.0) -> tuple[float, float]:
    """Width and volume of a crown with further points (n, 3); 0 where its hull has no point.

    The hull of the crown's points lies outside the wood by ``overshoot``, the further points do
    not.
    """
    if not len(hull.points):
        return 0.0, 0.0
    reach = reach_around(hull.points[:, :2]) - overshoot
    reach = np.maximum(reach, reach_around(further[:, :2]))
    away = hull.equations[:, :3] @ further.T + hull.equations[:, 3:]
    outside = further[away.max(axis=0, initial=0.0) > 0.0]
    volume = hull_of(np.vstack([hull.points, outside])).volume if len(outside) else hull.volume
    return width_of(reach), max(volume - hull.area * overshoot, 0.0)


def measure_crown(
    wood: np.ndarray,
    hull: Hull,
    tips: np.ndarray,
    in_crown: np.ndarray,
    scatter: float,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Measure top, crown width and volume, (3,) float64, and samples of them, (n_samples, 3).

    The top is the z of the third highest point of the whole tree's wood, (n, 3). The width is the
    mean of the crown's widest horizontal extent and that across it, the volume that of its hull.
    ``tips``, (n_samples, n_ends, 3), are samples of where shoots end; without any the points' own
    extent is taken. Only shoots that are ``in_crown``, (n_ends,) bool, widen it. ``scatter`` is
    that of the points around the skeleton's radii; 0 where it is not known.
    """
    rank = min(RANK, len(wood))
    top = np.partition(wood[:, 2], -rank)[-rank]
    if not len(tips):
        return np.array([top, *grown(hull, np.empty((0, 3)))]), np.zeros((0, 3))
    overshoot = FACTORS["overshoot"] + FACTORS["overshoot_spread"] * rng.standard_normal(len(tips))
    samples = np.array(
        [
            (max(top, ends[:, 2].max(initial=top)), *grown(hull, ends[in_crown], scatter * over))
            for ends, over in zip(tips, overshoot, strict=True)
        ]
    )
    return np.median(samples, axis=0), samples


def missing_wood(
    left_out: np.ndarray, reports: Reports, top: MissingTop | None, foot: np.ndarray
) -> np.ndarray:
    """Places that what is known to be missing reaches to, (n, 3) float64.

    It is the wood that the skeleton left out, (n_left_out, 3). The reports tell of loose pieces
    that were no part of the target's wood, and of thin wood that photos show and the skeleton
    lacks. The top stands above the foot, (3,); told to a voxel, it may be one taller.
    """
    pieces = *reports.target.get("loose", ()), *reports.photo_check.get("missing_pieces", ())
    boxes = np.array([[piece["low"], piece["high"]] for piece in pieces if "low" in piece])
    which = np.indices((2, 2, 2)).reshape(3, -1).T  # lower or upper end along each axis
    corners = boxes.reshape(-1, 2, 3)[:, which, np.arange(3)].reshape(-1, 3)
    above = np.empty((0, 3))
    if top is not None:
        above = np.array([[*foot[:2], foot[2] + top.height + VOXEL * top.found]])
    return np.vstack([left_out, corners, above])


def growth_by(missing: np.ndarray, extent: np.ndarray, hull: Hull) -> np.ndarray:
    """By how much missing wood (n, 3) raises a crown's top, width and volume, (3,) float64."""
    if not len(missing):
        return np.zeros(3)
    larger = missing[:, 2].max(), *grown(hull, missing)
    return np.maximum(larger - extent, 0.0)


def contour_volume(points: np.ndarray, middle: np.ndarray) -> float:
    """Volume within a crown's outline: eight radials from the stem at each of five levels.

    Culver and Till (Australian Journal of Experimental Agriculture and Animal Husbandry 7:587-592,
    1967) measured five widths of the profile on each of eight radials and found no form needed.

    It is the sum over the levels of the areas of eight sectors around the stem's middle, (2,),
    times a level's height; 0 without points. A sector is as wide as the farthest of the crown's
    points (n, 3) in it.
    """
    if not len(points):
        return 0.0
    z, (x, y) = points[:, 2], (points[:, :2] - middle).T
    bins, ends = [_N_LEVELS, _N_RADIALS], [(z.min(), z.max()), (-np.pi, np.pi)]
    found = binned_statistic_2d(z, np.arctan2(y, x), x**2 + y**2, "max", bins, ends)
    return float(np.pi / _N_RADIALS * np.nansum(found.statistic) * np.ptp(z) / _N_LEVELS)
