"""Slabs of stem points: cut across the axis, the circle to start from, the section, its levels.

A slab of stem points is projected along the local axis and a circle is found in it by random
sampling, so that a minority of foreign points (a calibration ring, a post, a twig, floaters) does
not lead the fit of `cherrypicker.geometry.sections` astray.
"""

import numpy as np
from scipy.stats import binned_statistic_2d, theilslopes

from cherrypicker.errors import StageError
from cherrypicker.geometry.directions import tangent_basis
from cherrypicker.geometry.neighbors import rows_in_box
from cherrypicker.geometry.robust import robust_sigma
from cherrypicker.geometry.sections import N_SECTORS, Section, circles_through, fit_section

# Points that a section needs; 30 and 120 find the same eight diameters on three scans
FEWEST_POINTS = 60


def cut_slab(
    points: np.ndarray, center: np.ndarray, axis: np.ndarray, half_height: float, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of a slab across `axis` in its frame (u, v, w), their rows, and that frame, (3, 3)."""
    frame = np.vstack([tangent_basis(axis), axis])
    box = np.hypot(half_height, reach)
    near = rows_in_box(points, center - box, center + box)
    local = (points[near] - center) @ frame.T
    inside = np.abs(local[:, 2]) <= half_height
    inside &= np.hypot(local[:, 0], local[:, 1]) <= reach
    return local[inside], near[inside], frame


def stem_section(
    points: np.ndarray,
    slab: tuple[np.ndarray, np.ndarray, float, float],
    tolerance: float,
    radius_range: tuple[float, float],
    rng: np.random.Generator,
) -> tuple[Section, np.ndarray]:
    """The section of a stem through the points of a slab: its outline over its steady levels.

    It comes with the slab's frame, (3, 3), of `cut_slab`.

    Parameters
    ----------
    slab : tuple
        Centre and axis, (3,) both, half its height and its reach, as for `cut_slab`.
    tolerance, radius_range : float, tuple of float
        Of the circle that it starts from, see `search_circle`; its own radius lies in that range.

    Raises
    ------
    StageError
        If there are fewer than `FEWEST_POINTS`, no section in the range, or points at one end of
        the slab: a stem that is hidden in its middle would be carried on over the gap.
    """
    local, _, frame = cut_slab(points, *slab)
    z = slab[0][2]
    if len(local) < FEWEST_POINTS:
        raise StageError(f"{len(local)} stem points around z = {z:.2f}, not {FEWEST_POINTS}")
    search = tolerance, radius_range, rng
    fit = section_from(search_circle(local[:, :2], *search), local, waves=False)
    local = local[steady_levels(local, fit)]
    if len(local) < FEWEST_POINTS:
        raise StageError(f"{len(local)} stem points in steady levels around z = {z:.2f}")
    fit = section_from(search_circle(local[:, :2], *search), local, waves=True)
    # Points spread evenly reach sqrt(3) standard deviations from their mean
    along = local[fit.weights > 0, 2]
    if not len(along) or abs(along.mean()) > np.sqrt(3.0) * along.std():
        raise StageError(f"the stem points around z = {z:.2f} end above or below it")
    if not radius_range[0] <= fit.radius <= radius_range[1]:  # a fit may leave what it began at
        raise StageError(f"the stem fitted around z = {z:.2f} is not as thick as expected")
    return fit, frame


def section_from(circle: np.ndarray, local: np.ndarray, *, waves: bool) -> Section:
    """The section through points of a slab, (n_points, 3), from a circle that most lie on, (3,)."""
    balance = sector_weights(local[:, :2] - circle[:2])
    fit = fit_section(local, circle, balance=balance, waves=waves)
    if fit is None:
        raise StageError("no section fits the stem points", key="traits.trunk_height_m")
    return fit


def search_circle(
    points: np.ndarray,
    tolerance: float,
    radius_range: tuple[float, float],
    rng: np.random.Generator,
) -> np.ndarray:
    """Find the circle (u, v, radius) that explains most of a slice by sampling triples of points.

    Each point counts by the inverse root of its sector's point count, so that a densely seen side
    does not decide alone; the score is the truncated squared distance (MSAC).

    Parameters
    ----------
    points : ndarray of shape (n_points, 2), float64
        Slice in the plane across the axis, origin near the axis.
    tolerance : float
        Distance to the circle at which a point no longer supports it, in the cloud's unit.
    radius_range : tuple of float
        Least and largest radius accepted.

    Raises
    ------
    StageError
        If no candidate circle lies in the range.
    """
    most_scored, n_candidates = 1500, 600
    if len(points) > most_scored:
        points = points[rng.choice(len(points), most_scored, replace=False)]
    triples = rng.integers(0, len(points), (n_candidates, 3))
    circles = circles_through(points[triples])
    low, high = radius_range
    reach = np.hypot(circles[:, 0], circles[:, 1])
    usable = np.isfinite(circles).all(axis=1) & (circles[:, 2] >= low) & (circles[:, 2] <= high)
    usable &= reach <= high + circles[:, 2]
    circles = circles[usable]
    if not len(circles):
        raise StageError("no circle fits the stem points", key="traits.trunk_height_m")
    offset = points.T[:, None] - circles.T[:2, :, None]  # (2, n_circles, n_points)
    miss = np.minimum(np.square((np.hypot(*offset) - circles[:, 2:]) / tolerance), 1.0)
    score = [
        sector_weights(points - circle[:2]) @ (1.0 - own)
        for circle, own in zip(circles, miss, strict=True)
    ]
    return circles[np.argmax(score)]


def steady_levels(local: np.ndarray, fit: Section) -> np.ndarray:
    """Points of the levels whose radius goes with the others' by a first fit, (n_points,) bool.

    A ring around the stem, or a knot, moves all points of its levels by a distance that a robust
    fit of single points may take for noise. Levels are compared instead: each level's median
    residual against a Theil-Sen line through all of them.
    """
    n_levels = 16
    low, high = local[:, 2].min(), local[:, 2].max()
    level = ((local[:, 2] - low) / max(high - low, 1e-12) * n_levels).astype(int)
    level = np.minimum(level, n_levels - 1)
    sector = _sectors(fit.offset, 12)
    residual = np.linalg.norm(fit.offset, axis=1)
    residual -= fit.parameters[2] + fit.parameters[5] * local[:, 2]
    near = np.abs(residual) < 0.4 * fit.radius
    known = np.flatnonzero(np.bincount(level[near], minlength=n_levels) >= 6)
    if len(known) < 6:
        return np.ones(len(local), dtype=bool)
    cells = level[near], sector[near], residual[near], "median"
    medians = binned_statistic_2d(*cells, [np.arange(n_levels + 1), np.arange(13)]).statistic
    shift = np.full(n_levels, np.nan)
    shift[known] = np.nanmedian(medians[known], axis=1)
    deviation = shift - theilslopes(shift[known], known).slope * np.arange(n_levels)
    deviation -= np.median(deviation[known])
    spread = robust_sigma(deviation[known])
    allowed = max(3.0 * spread, 0.02 * fit.radius)
    is_steady = np.isnan(deviation) | (np.abs(deviation) <= allowed)
    return is_steady[level]


def sector_weights(offset: np.ndarray) -> np.ndarray:
    """Weights by which a sector counts by the root of its number of points, 1 for a usual one."""
    sector = _sectors(offset, N_SECTORS)
    count = np.bincount(sector)
    return np.sqrt(np.median(count[count > 0]) / count[sector])


def _sectors(offset: np.ndarray, n: int) -> np.ndarray:
    """Which of n sectors around the origin each place (n_points, 2) lies in, (n_points,) int."""
    turn = np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi) + 0.5
    return np.minimum((turn * n).astype(int), n - 1)
