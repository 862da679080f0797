"""Sections of wood: the circle, cone or freer outline that points across an axis lie on (compiled).

How strongly a point pulls is said in `cherrypicker.geometry.rice`.

Outliers lose their say (Tukey's weights). The covariance is that of an M-estimator whose points err
together within a cell of the surface: it holds for sections seen from one side, for bark, and for
what a circle does not follow.
"""

from dataclasses import dataclass

import numpy as np

from cherrypicker.compiled import compiled
from cherrypicker.geometry.rice import rice
from cherrypicker.geometry.robust import MAD_TO_SIGMA, TUKEY

LEAST_NOISE = 1e-4  # of the radius: what a perfect cloud is taken to have
ORDERS = (2, 3, 4, 5, 6)  # of an outline's waves: from an oval to six flutes
# Of the radius, over the order: a wave's expected standard deviation. Halved and doubled, it moves
# trunk diameters of three scans by 2 micrometres
WAVE = 0.05
N_SECTORS, N_LEVELS = 24, 4  # cells whose points err together
N_CELLS = N_SECTORS * N_LEVELS
FEWEST_POINTS = 6
N_ROUNDS, SETTLED = 30, 1e-5
# Of the radius: of points around the circle that a fit starts from. Halved and doubled, it moves
# trunk diameters of six trees by 0.04 mm at most
FIRST_SCATTER = 0.15


@dataclass(frozen=True)
class Section:
    """A piece of wood in its slab's frame: axis along w, origin inside.

    The numbers of `parameters` are centre u, v and radius at w = 0, their slopes along w, then
    cosine and sine of the outline's waves of `ORDERS` as shares of the radius.
    """

    parameters: np.ndarray  # (6 + 2 * n_orders,)
    covariance: np.ndarray  # (6 + 2 * n_orders, 6 + 2 * n_orders)
    noise: float  # robust standard deviation of the points around the surface, cloud's unit
    weights: np.ndarray  # (n_points,): Tukey's, in [0, 1]; 0 is an outlier
    offset: np.ndarray  # (n_points, 2): of the points from the axis

    @property
    def radius(self) -> float:
        """Radius at w = 0 of the circle of the section's area, in the cloud's unit."""
        return float(self.parameters[2] * self._swell)

    @property
    def _swell(self) -> float:
        return float(np.sqrt(1.0 + np.square(self.parameters[6:]).sum() / 2))

    @property
    def error(self) -> float:
        """Standard error of `radius`."""
        slope = np.zeros(len(self.parameters))
        slope[2] = self._swell
        slope[6:] = self.parameters[2] * self.parameters[6:] / (2 * self._swell)
        return float(np.sqrt(max(slope @ self.covariance @ slope, 0.0)))

    @property
    def arc_deg(self) -> float:
        """Part of the circumference that inliers cover, degrees, in steps of 10."""
        return float(arc_deg(self.offset[self.weights > 0], 36))

    @property
    def n_inliers(self) -> int:
        """Number of points with a weight above zero."""
        return int((self.weights > 0).sum())


def fit_section(
    local: np.ndarray,
    circle: np.ndarray,
    *,
    balance: np.ndarray | None = None,
    waves: bool = True,
) -> Section | None:
    """Fit a section to the points of a slab: first a circular one, then its waves as well.

    None where the points do not determine one.

    Parameters
    ----------
    local : ndarray of shape (n_points, 3), float64
        Points in the slab's frame (u, v across the axis, w along it), in the cloud's unit.
    circle : ndarray of shape (3,)
        First guess at w = 0.
    balance : ndarray of shape (n_points,), optional
        Weights of the points.
    waves : bool, default True
        Whether the radius changes with the direction.
    """
    local = np.column_stack([local, np.ones(len(local)) if balance is None else balance])
    wave = np.repeat(WAVE / np.array(ORDERS), 2) if waves else np.empty(0)
    expected = np.concatenate([np.full(6, np.inf), wave])
    start = np.append(circle, np.zeros(3 + len(wave)))
    fit = _fit(local, start, expected)
    return Section(*fit) if np.isfinite(fit[0]).all() else None


@compiled
def _fit(
    local: np.ndarray, start: np.ndarray, expected: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float, np.ndarray, np.ndarray]:
    """The fields of a `Section`; its radius is NaN where the points leave it open.

    The points come with their weights, (n_points, 4). Python calls this, compiled code `judge`: an
    array of a function that both call may not come back from Numba's cache.
    """
    found, scatter = start.copy(), FIRST_SCATTER * start[2]
    scatter = _iterate(local, found[:6], start[:6], expected[:6], scatter)
    if len(start) > 6 and np.isfinite(found[2]):
        scatter = _iterate(local, found, start, expected, scatter)
    if not np.isfinite(found[2]):
        local = local[:0]  # there is nothing to judge
    weights, offset, covariance = judge(local, found, expected, scatter)
    return found, covariance, scatter, weights, offset


@compiled
def _iterate(
    local: np.ndarray, found: np.ndarray, mean: np.ndarray, expected: np.ndarray, scatter: float
) -> float:
    """Improve the parameters of a section by Newton's steps; the scatter of the points around it.

    `mean` and `expected` say what is known of them beforehand: values and their standard
    deviations, infinite for what is open. `scatter` is that around the section to begin with. The
    radius becomes NaN where the points leave them open.
    """
    n, near = len(found), np.empty(len(local))
    least = max(LEAST_NOISE * found[2], 1e-12)
    scatter = max(scatter, least)
    normals, scores = np.empty((1, n, n)), np.empty((1, n))
    normal, gradient = normals[0], scores[0]
    for _ in range(N_ROUNDS):
        _sums(local, found, scatter, normals, scores)
        gradient += (scatter / expected) ** 2 * (found - mean)
        _add_known(normal, expected, scatter)
        step = _solved(normal, gradient)
        moved = max(abs(step[0]), abs(step[1]), abs(step[2]))
        share = min(1.0, 0.5 * found[2] / max(moved, 1e-300))
        found -= share * step
        if not (found[2] > 0 and np.isfinite(step[0])):
            found[2] = np.nan
            break
        n_near = 0
        for row in range(len(local)):
            away = abs(_seen(local, row, found, scatter)[0])
            if away < 3.0 * scatter:
                near[n_near] = away
                n_near += 1
        if n_near < FEWEST_POINTS:
            break
        spread = max(MAD_TO_SIGMA * median(near[:n_near]), least)
        # Shrinks by at most a third a step: a fast drop would lock the fit onto the first guess.
        scatter = max(spread, 0.67 * scatter)
        if moved < SETTLED * found[2] and scatter <= 1.01 * spread:
            break
    return scatter


@compiled
def median(values: np.ndarray) -> float:
    """NumPy's median, compiled once and not anew into every function that calls it."""
    return np.median(values)


@compiled
def _seen(local: np.ndarray, row: int, section: np.ndarray, scatter: float) -> tuple:
    """How a point stands to a section.

    Its distance from where noise lets the surface appear; its offset from the axis; the outline's
    lean there and the cosine of it; the radius without waves, what they make of it, and with them.
    """
    x, y, base = local[row, 0] - section[0], local[row, 1] - section[1], section[2]
    if len(section) > 3:
        w = local[row, 2]
        x, y, base = x - w * section[3], y - w * section[4], base + w * section[5]
    away, wave, turn = np.sqrt(x * x + y * y), 1.0, 0.0
    if len(section) > 6:
        angle = np.arctan2(y, x)
        for at, order in enumerate(ORDERS):
            even, odd = section[6 + 2 * at], section[7 + 2 * at]
            cosine, sine = np.cos(order * angle), np.sin(order * angle)
            wave += even * cosine + odd * sine
            turn += order * (odd * cosine - even * sine)
    radius = max(base * wave, 1e-3 * section[2])
    lean = base * turn / max(away, 1e-12)
    upright = 1.0 / np.sqrt(1.0 + lean * lean)
    off = upright * (away - np.sqrt(radius**2 + scatter**2))
    return off, x, y, lean, upright, base, wave, radius


@compiled
def _sums(
    local: np.ndarray, section: np.ndarray, scatter: float, normals: np.ndarray, scores: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Weights and offsets of the points; writes normal matrices and gradients of the cells.

    All points make one cell, or `N_CELLS` for the covariance, whose matrices are
    weighed by the slope of Tukey's function. Who calls makes the arrays: a flag instead, which
    Numba takes for a type, would have this compiled twice.
    """
    n, is_last = len(section), len(scores) > 1
    weights, offset = np.empty(len(local)), np.empty((len(local), 2))
    normals.fill(0.0)
    scores.fill(0.0)
    low, high = np.inf, -np.inf
    for row in range(len(local)):
        low, high = min(low, local[row, 2]), max(high, local[row, 2])
    by_axis, by_side, by_radius = np.zeros(n), np.zeros(n), np.zeros(n)
    for row in range(len(local)):
        off, x, y, lean, upright, base, wave, radius = _seen(local, row, section, scatter)
        offset[row, 0], offset[row, 1] = x, y
        share = min((off / (TUKEY * scatter)) ** 2, 1.0)
        weights[row] = (1.0 - share) ** 2
        if share == 1.0:
            continue
        w, away = local[row, 2], max(np.sqrt(x * x + y * y), 1e-12)
        x, y = x / away, y / away
        by_axis[0], by_axis[1] = upright * (lean * -y - x), upright * (lean * x - y)
        by_side[0], by_side[1] = -y, x
        by_radius[2] = upright * wave
        if n > 3:
            for i in range(3):
                by_axis[3 + i], by_side[3 + i] = w * by_axis[i], w * by_side[i]
            by_radius[5] = w * by_radius[2]
        if n > 6:
            angle = np.arctan2(y, x)
            for at, order in enumerate(ORDERS):
                by_radius[6 + 2 * at] = upright * base * np.cos(order * angle)
                by_radius[7 + 2 * at] = upright * base * np.sin(order * angle)
        first, second, out, side, own, cross = rice(away, radius, scatter, 1.0)
        told = local[row, 3] * weights[row]
        cell, slope = 0, told
        if is_last:
            sector = min(int((np.arctan2(y, x) / (2 * np.pi) + 0.5) * N_SECTORS), N_SECTORS - 1)
            level = min(int((w - low) / max(high - low, 1e-12) * N_LEVELS), N_LEVELS - 1)
            cell = sector * N_LEVELS + level
            slope = local[row, 3] * (1.0 - share) * (1.0 - 5.0 * share)
        for i in range(n):
            scores[cell, i] += told * upright * (first * by_axis[i] + second * by_radius[i])
            ahead = out * by_axis[i] + cross * by_radius[i]
            own_i = own * by_radius[i] + cross * by_axis[i]
            for j in range(n):
                both = ahead * by_axis[j] + own_i * by_radius[j]
                normals[cell, i, j] += slope * (both + side * by_side[i] * by_side[j])
    return weights, offset


@compiled
def _add_known(normal: np.ndarray, expected: np.ndarray, scatter: float) -> None:
    """Enter what is known beforehand into a normal matrix."""
    for i in range(len(normal)):
        known = scatter / max(expected[i], 1e-12)  # of a radius of 0 next to nothing is expected
        normal[i, i] += known**2 + 1e-9 * abs(normal[i, i]) + 1e-30


@compiled
def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solution of linear equations by elimination with pivots, NaN where they have none.

    NumPy's takes three seconds more to compile, and raises where they have none.
    """
    n, rest, found = len(right), matrix.copy(), right.copy()
    for at in range(n):
        pivot = at
        for row in range(at + 1, n):
            if abs(rest[row, at]) > abs(rest[pivot, at]):
                pivot = row
        if not abs(rest[pivot, at]) > 0.0:
            found.fill(np.nan)
            return found
        for column in range(at, n):
            rest[at, column], rest[pivot, column] = rest[pivot, column], rest[at, column]
        found[at], found[pivot] = found[pivot], found[at]
        for row in range(at + 1, n):
            share = rest[row, at] / rest[at, at]
            for column in range(at, n):
                rest[row, column] -= share * rest[at, column]
            found[row] -= share * found[at]
    for row in range(n - 1, -1, -1):
        for column in range(row + 1, n):
            found[row] -= rest[row, column] * found[column]
        found[row] /= rest[row, row]
    return found


@compiled
def judge(
    local: np.ndarray, section: np.ndarray, expected: np.ndarray, scatter: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights and offsets of the points and the covariance of the parameters, as in `Section`.

    The points come with their weights, (n_points, 4). `expected` has the parameters' standard
    deviations as known beforehand, infinite for what is open. The covariance is the jackknife's
    over cells, each of which errs by itself: leaving a cell out moves the parameters by its
    gradient over what the others tell. What is known beforehand errs by as much as it was expected
    to.
    """
    n, n_told = len(section), 0
    scatter = max(scatter, LEAST_NOISE * section[2], 1e-12)
    normals, scores = np.empty((N_CELLS, n, n)), np.empty((N_CELLS, n))
    weights, offset = _sums(local, section, scatter, normals, scores)
    total, covariance = np.zeros((n, n)), np.zeros((n, n))
    for cell in range(len(scores)):
        total += normals[cell]
    for cell in range(len(scores)):
        if scores[cell].any():
            rest = total - normals[cell]
            _add_known(rest, expected, scatter)
            step = _solved(rest, scores[cell])
            covariance += np.outer(step, step)
            n_told += 1
    covariance *= max(n_told - 1, 1) / max(n_told, 1)
    _add_known(total, expected, scatter)
    for i in range(n):
        known = np.zeros(n)
        known[i] = scatter**2 / max(expected[i], 1e-12)
        step = _solved(total, known)
        covariance += np.outer(step, step)
    return weights, offset, covariance


@compiled
def arc_deg(offset: np.ndarray, n_sectors: int) -> float:
    """Degrees of a circle whose sectors hold a point; `offset` (n, 2) is relative to the centre."""
    is_seen = np.zeros(n_sectors)
    for row in range(len(offset)):
        turn = np.arctan2(offset[row, 1], offset[row, 0]) / (2 * np.pi) + 0.5
        is_seen[min(int(turn * n_sectors), n_sectors - 1)] = 1.0
    return 360.0 * is_seen.sum() / n_sectors


def circles_through(triples: np.ndarray) -> np.ndarray:
    """Circles through three points each, (n, 3) of u, v, r; not finite where they are in line."""
    a, b, c = triples[:, 0], triples[:, 1], triples[:, 2]
    ab, ac = b - a, c - a
    cross = 2.0 * (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    ab2, ac2 = (ab**2).sum(axis=1), (ac**2).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (ac[:, 1] * ab2 - ab[:, 1] * ac2) / cross
        v = (ab[:, 0] * ac2 - ac[:, 0] * ab2) / cross
    return np.column_stack([a[:, 0] + u, a[:, 1] + v, np.hypot(u, v)])
