"""Sub-pixel marker corners: fit the whole printed pattern to the photo.

Corner refinement on gradients places the border of a small marker up to 0.4 px inside: optical blur
rounds the corners, and since photos are gamma encoded, half of the light is not half of the grey
value, which moves every edge towards the dark side. So the marker's known pattern, seen through a
homography and blurred by a Gaussian, is encoded as sRGB and fitted to the grey values with a free
tone curve for what a camera does beside it. Its white cells and its black ones shift against each
other under a wrong tone curve, which is what tells the curve from the marker's size. Without sRGB's
the free one is too smooth near black: edges of sharp photos came 0.06 px inside (`docs/scale.md`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cherrypicker.compiled import compiled
from cherrypicker.geometry.robust import robust_sigma
from cherrypicker.geometry.sampling import thin_randomly

# All guesses. Pixels that a fit uses (the most bound the time), and white margin around the marker
_MIN_PIXELS, _MAX_PIXELS = 60, 4000
_MARGIN_MODULES = 0.5
# The blur: nodes of the Gaussian each way and their spacing in its deviation; its limits, px, and
# where a fit starts, in modules and px
_NODES, _SPACING = 5, 0.8
_BLUR_PX, _BLUR_MODULES = (0.25, 1.5), 0.5
_START_BLUR_MODULES, _START_BLUR_PX = 0.2, (0.6, 2.0)
# Below this share of well explained pixels the paper is not flat, or a shadow lies across it; that
# it is where the corners stay so near to where they were: px, and a share of the side
_MIN_COVERED = 0.9
_STAYS_PX, _STAYS_SIDES = 1.5, 0.015
# Levenberg and Marquardt: steps of the derivatives, px; the first damping, what changes it, its
# least; trials of a step; its longest, in modules; a move that ends the search, px, and its round
_DERIVATIVE_PX = 0.02
_DAMPING, _DAMPING_FACTOR, _LEAST_DAMPING, _N_TRIALS = 1e-3, 5, 1e-7, 8
_LONGEST_MODULES, _SETTLED_PX, _SETTLED_FROM = 0.3, 1e-3, 3
# Residuals beyond so many deviations do not count, from this round on
_OUTLIER, _OUTLIERS_FROM = 6, 2
# Percentiles of the grey values that stand for black and white, and their least difference (guess)
_LEVELS, _LEAST_CONTRAST = (5, 95), 4.0
_N_PARAMETERS = 16  # of a fit: corners, blur and tone curve, less one


@dataclass(frozen=True)
class MarkerFit:
    """Result of :func:`fit_marker`."""

    # (4, 2): in the pixel coordinates given, clockwise from the pattern's top left
    corners: np.ndarray
    corner_std: float  # one standard deviation of a corner coordinate, px
    blur_px: float  # standard deviation of the blur, px
    # Share of the grey values' variance that the model explains, 1 at best; outlying pixels count
    # as little as they did in the fit
    agreement: float
    covered: float  # share of the pixels that the fit used at more than half weight
    # Whether one homography explains the whole marker; where not (curled paper), the corners are
    # those of its flat part, extended
    is_flat: bool


@compiled(nogil=True)
def _homography(corners: np.ndarray, n_modules: int) -> np.ndarray:
    """Homography from pixels to module coordinates, (0, 0) to (n, n), of four corners."""
    a = np.zeros((8, 8))
    b = np.zeros(8)
    target = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * n_modules
    for k in range(4):
        x, y = corners[k, 0], corners[k, 1]
        u, v = target[k, 0], target[k, 1]
        a[2 * k, 0], a[2 * k, 1], a[2 * k, 2] = x, y, 1.0
        a[2 * k, 6], a[2 * k, 7], b[2 * k] = -u * x, -u * y, u
        a[2 * k + 1, 3], a[2 * k + 1, 4], a[2 * k + 1, 5] = x, y, 1.0
        a[2 * k + 1, 6], a[2 * k + 1, 7], b[2 * k + 1] = -v * x, -v * y, v
    h = np.linalg.solve(a, b)
    return np.array([[h[0], h[1], h[2]], [h[3], h[4], h[5]], [h[6], h[7], 1.0]])


@compiled(nogil=True)
def _soft_cell(grid: np.ndarray, u: float, v: float, half_u: float, half_v: float) -> float:
    """Pattern value at module coordinates, averaged over a box of the given half widths."""
    n = grid.shape[0]
    gu, gv = np.round(u), np.round(v)
    fu = min(max((u - gu) / (2 * half_u) + 0.5, 0.0), 1.0)
    fv = min(max((v - gv) / (2 * half_v) + 0.5, 0.0), 1.0)
    value = 0.0
    for du in range(2):
        for dv in range(2):
            column, row = int(gu) - 1 + du, int(gv) - 1 + dv
            cell = 1.0
            if 0 <= column < n and 0 <= row < n:
                cell = grid[row, column]
            weight = (fu if du else 1.0 - fu) * (fv if dv else 1.0 - fv)
            value += weight * cell
    return value


@compiled(nogil=True)
def _render(model: np.ndarray, grid: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """White coverage in [0, 1] of the blurred pattern at pixel positions."""
    h = _homography(model[:8].reshape(4, 2), grid.shape[0])
    sigma = model[8]
    # A box of one node spacing joins the Gaussian's nodes, which adds its own variance.
    spacing = _SPACING * sigma
    node_sigma = np.sqrt(max(sigma**2 - spacing**2 / 12, 0.25 * sigma**2))
    weights = np.empty(_NODES)
    for k in range(_NODES):
        weights[k] = np.exp(-0.5 * ((k - _NODES // 2) * spacing / node_sigma) ** 2)
    weights /= weights.sum()
    coverage = np.zeros(len(pixels))
    for i in range(len(pixels)):
        x, y = pixels[i, 0], pixels[i, 1]
        w = h[2, 0] * x + h[2, 1] * y + 1.0
        u = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / w
        v = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / w
        ux, uy = (h[0, 0] - u * h[2, 0]) / w, (h[0, 1] - u * h[2, 1]) / w
        vx, vy = (h[1, 0] - v * h[2, 0]) / w, (h[1, 1] - v * h[2, 1]) / w
        half_u = min(max(0.5 * spacing * np.sqrt(ux * ux + uy * uy), 1e-6), 0.499)
        half_v = min(max(0.5 * spacing * np.sqrt(vx * vx + vy * vy), 1e-6), 0.499)
        total = 0.0
        for a in range(_NODES):
            for b in range(_NODES):
                dx, dy = (a - _NODES // 2) * spacing, (b - _NODES // 2) * spacing
                total += (
                    weights[a]
                    * weights[b]
                    * _soft_cell(grid, u + ux * dx + uy * dy, v + vx * dx + vy * dy, half_u, half_v)
                )
        coverage[i] = total
    return coverage


def fit_marker(
    grey: np.ndarray,
    corners: np.ndarray,
    grid: np.ndarray,
    pixel_map: Callable[[np.ndarray], np.ndarray] | None = None,
    *,
    max_iterations: int = 25,
) -> MarkerFit | None:
    """Refine marker corners by fitting the pattern to the grey values around it.

    Parameters
    ----------
    grey : ndarray of shape (height, width), uint8 or float
        As stored: gamma encoded.
    corners : ndarray of shape (4, 2)
        First guess, px, pixel centres at (0.5, 0.5), clockwise from the pattern's top left; within
        half a module of the truth.
    grid : ndarray of shape (n_modules, n_modules)
        The pattern with its black border: 0 black, 1 white.
    pixel_map : callable, optional
        Takes pixel positions of shape (n, 2) to undistorted ones, of about the same scale; the fit
        and the result are then in those coordinates.

    Returns
    -------
    MarkerFit or None
        None where the pattern cannot be matched (off the photo, degenerate, no convergence).
    """
    grid = np.ascontiguousarray(grid, float)
    chosen = _pixels_around(np.asarray(grey).shape, np.asarray(corners, float), len(grid))
    if chosen is None:
        return None
    columns, rows = chosen
    values = np.asarray(grey)[rows, columns].astype(float)
    pixels = np.column_stack([columns, rows]) + 0.5
    start = np.asarray(corners, float)
    if pixel_map is not None:
        mapped = pixel_map(np.concatenate([pixels, start]))
        if not np.isfinite(mapped).all():
            return None
        pixels, start = mapped[:-4], mapped[-4:]
    side = np.mean(np.linalg.norm(start - np.roll(start, 1, axis=0), axis=1))
    middle = start.mean(axis=0)
    # Centred coordinates keep the normal equations well conditioned.
    model = np.append(
        (start - middle).ravel(), np.clip(_START_BLUR_MODULES * side / len(grid), *_START_BLUR_PX)
    )
    pixels = pixels - middle
    levels = np.percentile(values, _LEVELS)
    if levels[1] - levels[0] < _LEAST_CONTRAST:
        return None
    problem = _Problem(grid, pixels, values, side, levels)
    fitted = _levenberg_marquardt(problem, model, max_iterations)
    if fitted is None:
        return None
    model, std, agreement, weights = fitted
    covered = float((weights > 0.5).mean())
    corners = model[:8].reshape(4, 2) + middle
    # A shadow across the marker leaves pixels unexplained too, but then the corners stay.
    moved = np.linalg.norm(corners - start, axis=1).max()
    is_flat = covered >= _MIN_COVERED or moved < max(_STAYS_PX, _STAYS_SIDES * side)
    return MarkerFit(corners, std, float(model[8]), agreement, covered, bool(is_flat))


def _light(grey: np.ndarray) -> np.ndarray:
    """Linear light in [0, 1] of sRGB values of 0 to 255 (IEC 61966-2-1)."""
    share = grey / 255
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def _grey(light: np.ndarray) -> np.ndarray:
    """The inverse of `_light`."""
    return 255 * np.where(
        light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055
    )


def _encoded(coverage: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """Share of the way from the grey of black to that of white, of a coverage by white light."""
    black, white = _light(levels)
    return (_grey(black + coverage * (white - black)) - levels[0]) / (levels[1] - levels[0])


def _pixels_around(
    shape: tuple[int, ...], corners: np.ndarray, n_modules: int
) -> tuple[np.ndarray, np.ndarray] | None:
    """Columns and rows of the pixels of the marker and a part of its white margin."""
    center = corners.mean(axis=0)
    grow = 1 + 2 * _MARGIN_MODULES / n_modules
    outline = center + grow * (corners - center)
    lower = np.floor(outline.min(axis=0)).astype(int)
    upper = np.ceil(outline.max(axis=0)).astype(int)
    height, width = shape[:2]
    if (lower < 0).any() or upper[0] >= width or upper[1] >= height:
        lower = np.maximum(lower, 0)
        upper = np.minimum(upper, [width - 1, height - 1])
    grid = np.meshgrid(np.arange(lower[0], upper[0] + 1), np.arange(lower[1], upper[1] + 1))
    columns, rows = (coordinates.ravel() for coordinates in grid)
    spots = np.column_stack([columns, rows]) + 0.5
    edges = np.roll(outline, -1, axis=0) - outline
    relative = spots[:, None, :] - outline[None]
    cross = edges[None, :, 0] * relative[:, :, 1] - edges[None, :, 1] * relative[:, :, 0]
    inside = (cross >= 0).all(axis=1) | (cross <= 0).all(axis=1)
    columns, rows = columns[inside], rows[inside]
    if len(columns) < _MIN_PIXELS:
        return None
    columns, rows = thin_randomly(np.column_stack([columns, rows]), _MAX_PIXELS).T
    return columns, rows


def _photometric_residuals(
    coverage: np.ndarray, pixels: np.ndarray, values: np.ndarray, weights: np.ndarray, side: float
) -> np.ndarray:
    """What the best tone curve, with smooth shading, leaves unexplained for a coverage.

    With c the encoded coverage, grey is ``a(x, y) c + b(x, y) + q c (1 - c) + r c (1 - c) (1 - 2
    c)``: shading linear in x and y for white, linear for black, and bows for what the camera's
    curve has beside sRGB's and for the blooming of white into black.
    """
    x, y = pixels[:, 0] / side, pixels[:, 1] / side
    basis = np.stack(
        [
            np.ones_like(coverage),
            coverage,
            coverage * x,
            coverage * y,
            (1 - coverage) * x,
            (1 - coverage) * y,
            coverage * (1 - coverage),
            coverage * (1 - coverage) * (1 - 2 * coverage),
        ],
        axis=1,
    )
    weighted = basis * weights[:, None]
    left = weighted.T @ basis + 1e-9 * len(values) * np.eye(basis.shape[1])
    return values - basis @ np.linalg.solve(left, weighted.T @ values)


@dataclass(frozen=True)
class _Problem:
    """What a fit compares: the pattern, pixels and their grey values."""

    grid: np.ndarray
    pixels: np.ndarray
    values: np.ndarray
    side: float
    levels: np.ndarray  # (2,): grey of black and of white

    def residuals(self, model: np.ndarray, weights: np.ndarray) -> np.ndarray:
        coverage = _encoded(_render(model, self.grid, self.pixels), self.levels)
        return _photometric_residuals(coverage, self.pixels, self.values, weights, self.side)

    def jacobian(self, model: np.ndarray, residuals: np.ndarray, weights: np.ndarray) -> np.ndarray:
        columns = []
        for k in range(len(model)):
            trial = model.copy()
            trial[k] += _DERIVATIVE_PX
            columns.append((self.residuals(trial, weights) - residuals) / _DERIVATIVE_PX)
        return np.stack(columns, axis=1)

    def limited(self, trial: np.ndarray) -> np.ndarray | None:
        """Keep the blur in bounds; None for corners that cross over."""
        low, high = _BLUR_PX
        trial[8] = np.clip(trial[8], low, _BLUR_MODULES * self.side / len(self.grid) + high)
        return trial if _is_convex(trial[:8].reshape(4, 2)) else None


def _levenberg_marquardt(
    problem: _Problem, model: np.ndarray, max_iterations: int
) -> tuple[np.ndarray, float, float, np.ndarray] | None:
    """Parameters by variable projection: the tone curve is solved for at every step."""
    values = problem.values
    weights = np.ones(len(values))
    damping, moved = _DAMPING, np.inf
    largest = _LONGEST_MODULES * problem.side / len(problem.grid)
    residuals = problem.residuals(model, weights)
    for iteration in range(max_iterations):
        scale = max(robust_sigma(residuals), 1.0)
        # Shadows and blades of grass are no noise: they lose their weight once the fit is close.
        if iteration >= _OUTLIERS_FROM:
            weights = _tukey(residuals / (_OUTLIER * scale))
        residuals = problem.residuals(model, weights)
        jacobian = problem.jacobian(model, residuals, weights)
        normal = (jacobian * weights[:, None]).T @ jacobian
        gradient = (jacobian * weights[:, None]).T @ residuals
        cost = np.sum(weights * residuals**2)
        moved = 0.0
        for _ in range(_N_TRIALS):
            lifted = normal + damping * np.diag(np.diag(normal) + 1e-9)
            try:
                step = -np.linalg.solve(lifted, gradient)
            except np.linalg.LinAlgError:
                return None
            trial = problem.limited(model + np.clip(step, -largest, largest))
            if trial is not None:
                trial_residuals = problem.residuals(trial, weights)
                if np.sum(weights * trial_residuals**2) <= cost:
                    moved = np.abs(trial - model)[:8].max()
                    model, residuals = trial, trial_residuals
                    damping = max(damping / _DAMPING_FACTOR, _LEAST_DAMPING)
                    break
            damping *= _DAMPING_FACTOR
        if moved < _SETTLED_PX and iteration >= _SETTLED_FROM:
            break
    total = np.sum(weights * (values - np.average(values, weights=weights)) ** 2)
    left = np.sum(weights * residuals**2)
    agreement = float(1 - left / total) if total > 0 else 0.0
    covariance = np.linalg.pinv(normal) * left / max(weights.sum() - _N_PARAMETERS, 1)
    # Neighbouring pixels share their noise (demosaicing, JPEG): about four count as one.
    std = float(2 * np.sqrt(np.mean(np.diag(covariance)[:8])))
    return model, std, agreement, weights


def _tukey(ratio: np.ndarray) -> np.ndarray:
    return np.where(np.abs(ratio) < 1, (1 - ratio**2) ** 2, 0.0)


def _is_convex(corners: np.ndarray) -> bool:
    edges = np.roll(corners, -1, axis=0) - corners
    following = np.roll(edges, -1, axis=0)
    cross = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    return bool((cross > 1e-6).all() or (cross < -1e-6).all())
