"""Sub-pixel marker corners: fit the whole printed pattern to the photo.

Corner refinement on gradients places the border of a small marker up to 0.4 px inside: optical blur
rounds the corners, and since photos are gamma encoded, half of the light is not half of the grey
value, which moves every edge towards the dark side. So the marker's known pattern, seen through a
homography and blurred by a Gaussian, is encoded as sRGB and fitted to the grey values with a free
tone curve for what a camera does beside it. Its white cells and its black ones shift against each
other under a wrong tone curve, which is what tells the curve from the marker's size. Without sRGB's
the free one is too smooth near black: edges of sharp photos came 0.06 px inside.

The pattern is a sum of cells, and a cell the product of two intervals. Blurred, an interval is a
difference of two normal distribution functions, and what the two of a tilted cell have in common
is the first term of the tetrachoric series. So no sum over the kernel is needed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtr

from cherrypicker.geometry.robust import robust_sigma
from cherrypicker.geometry.sampling import thin_randomly
from cherrypicker.markers.layouts import AGREES_PX, MOST_OFF
from cherrypicker.photos import linear_light

# Pixels that a fit uses: half and twice as many move the scale of three scans by a third of its
# error at most. And white margin around the marker
_MAX_PIXELS = 4000
_MARGIN_MODULES = 0.5
# Below this share of well explained pixels the paper is not flat, or a shadow lies across it; that
# it is where the corners stay as near to where they were as sightings agree
_MIN_COVERED = 0.9
# Residuals beyond so many deviations do not count, and how often the deviation is asked for again
_OUTLIER, _N_TRIMMED = 6, 3
_STEP = np.sqrt(np.finfo(float).eps)  # of derivatives, as SciPy's own


@dataclass(frozen=True)
class MarkerFit:
    """Result of :func:`fit_marker`."""

    # (4, 2): in the pixel coordinates given, clockwise from the pattern's top left
    corners: np.ndarray
    corner_std: float  # one standard deviation of a corner coordinate, px
    # Share of the grey values' variance that the model explains, 1 at best; outlying pixels count
    # as little as they did in the fit
    agreement: float
    # Whether one homography explains the whole marker; where not (curled paper), the corners are
    # those of its flat part, extended
    is_flat: bool


def fit_marker(
    grey: np.ndarray,
    corners: np.ndarray,
    grid: np.ndarray,
    pixel_map: Callable[[np.ndarray], np.ndarray] = np.asarray,
) -> MarkerFit | None:
    """Refine marker corners by fitting the pattern to the grey values around it.

    None where the pattern cannot be matched (off the photo, degenerate, no convergence). Grey
    values, (height, width), uint8 or float, are as stored: gamma encoded. The corners (4, 2) are a
    first guess within half a module of the truth: px, pixel centres at (0.5, 0.5), clockwise from
    the pattern's top left. The grid, (n_modules, n_modules), is the pattern with its black border:
    0 black, 1 white. ``pixel_map`` takes pixel positions (n, 2) to undistorted ones, of about the
    same scale; the fit and the result are then in those coordinates.
    """
    start = np.asarray(corners, float)
    middle = start.mean(axis=0)
    outline = middle + (1 + 2 * _MARGIN_MODULES / len(grid)) * (start - middle)
    mask = np.zeros(grey.shape, np.uint8)
    cv2.fillConvexPoly(mask, np.round((outline - 0.5) * 16).astype(np.int32), 1, shift=4)
    pixels = thin_randomly(np.argwhere(mask)[:, ::-1], _MAX_PIXELS)
    if not len(pixels):
        return None
    values = grey[pixels[:, 1], pixels[:, 0]].astype(float)
    mapped = pixel_map(np.concatenate([pixels + 0.5, start]))
    if not np.isfinite(mapped).all():
        return None
    pixels, start = mapped[:-4], mapped[-4:]
    levels = np.array([values.min(), values.max()])  # black and white
    side = np.mean(np.linalg.norm(start - np.roll(start, 1, axis=0), axis=1))
    middle = start.mean(axis=0)
    pixels = pixels - middle
    tones = partial(_tones, levels=levels, places=pixels / side)

    def residuals(model: np.ndarray) -> np.ndarray:
        return tones(_coverage(model[:9], grid, pixels)[0]) @ model[9:] - values

    def jacobian(model: np.ndarray) -> np.ndarray:
        coverage, slopes = _coverage(model[:9], grid, pixels)
        here = tones(coverage)
        slope = (tones(coverage + _STEP) - here) @ model[9:] / _STEP
        return np.column_stack([slope[:, None] * slopes, here])

    model = np.append((start - middle).ravel(), 0.0)  # a blur of a pixel
    try:
        # Steps that go too far are refused by what they overflow to
        with np.errstate(all="ignore"):
            first = tones(_coverage(model[:9], grid, pixels)[0])
            model = np.append(model, np.linalg.lstsq(first, values)[0])
            # Shadows and blades of grass are no noise, which only a close fit tells
            for loss in ("soft_l1", *_N_TRIMMED * [_tukey]):
                limit = _OUTLIER * max(robust_sigma(residuals(model)), 1.0)
                how: Any = {"loss": loss, "f_scale": limit, "x_scale": "jac"}
                found = least_squares(residuals, model, jacobian, **how)
                model = found.x
        covariance = np.linalg.pinv(found.jac.T @ found.jac)
    except (np.linalg.LinAlgError, ValueError):  # corners that are those of no square
        return None
    weights = _tukey(np.square(found.fun / limit))[1]
    squares = weights @ np.square(found.fun)
    total = weights @ np.square(values - np.average(values, weights=weights))
    covariance *= squares / max(weights.sum() - len(model), 1)
    fitted = model[:8].reshape(4, 2) + middle
    covered = float((weights > 0.5).mean())
    # A shadow across the marker leaves pixels unexplained too, but then the corners stay.
    moved = np.linalg.norm(fitted - start, axis=1).max()
    stays = moved < max(AGREES_PX, MOST_OFF * side)
    return MarkerFit(
        corners=fitted,
        # Neighbouring pixels share their noise (demosaicing, JPEG): about four count as one.
        corner_std=float(2 * np.sqrt(np.mean(np.diag(covariance)[:8]))),
        agreement=float(1 - squares / total) if total > 0 else 0.0,
        is_flat=bool(covered >= _MIN_COVERED or stays),
    )


def _coverage(
    model: np.ndarray, grid: np.ndarray, pixels: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """White coverage in [0, 1] of the blurred pattern at pixels (n, 2), and its slopes (n, 9)."""
    here = _places(model, len(grid), pixels)
    steps, black = np.arange(len(grid) + 1), 1 - grid
    edges = (steps - here[:2, :, None]) / here[2:4, :, None]
    density = np.exp(-0.5 * edges**2) / np.sqrt(2 * np.pi)
    inside = np.diff(ndtr(edges))
    by_place, by_blur = (-np.diff(each) / here[2:4, :, None] for each in (density, density * edges))

    def blackened(across: np.ndarray, down: np.ndarray) -> np.ndarray:
        return np.sum(down @ black * across, axis=1)

    shared = here[4] * blackened(*by_place)
    slopes = [
        blackened(by_place[0], inside[1]),
        blackened(inside[0], by_place[1]),
        blackened(by_blur[0], inside[1]),
        blackened(inside[0], by_blur[1]),
    ]
    moved = [_places(model + step, len(grid), pixels) - here for step in _STEP * np.eye(9)]
    by_model = np.einsum("kqn,qn->nk", np.array(moved)[:, :4] / -_STEP, slopes)
    return 1 - blackened(*inside) - shared, by_model


def _places(model: np.ndarray, n: int, pixels: np.ndarray) -> np.ndarray:
    """Columns and rows of pixels in modules, the blur along both and its covariance, (5, n)."""
    x, y = model[:8].reshape(4, 2).T
    u, v = n * np.array([[0, 1, 1, 0], [0, 0, 1, 1]])
    one, none = np.ones(4), np.zeros((3, 4))
    rows = np.hstack([[x, y, one, *none, -u * x, -u * y], [*none, x, y, one, -v * x, -v * y]]).T
    h = np.append(np.linalg.solve(rows, np.append(u, v)), 1.0).reshape(3, 3)
    at = h[:, :2] @ pixels.T + h[:, 2:]
    places = at[:2] / at[2]
    # Of the lens, and of a pixel, which sees a square
    blur_px = np.sqrt(np.exp(2 * model[8]) + 1 / 12)
    blur = blur_px * (h[:2, :2, None] - places[:, None] * h[2, :2, None]) / at[2]
    return np.vstack([places, np.linalg.norm(blur, axis=1), np.sum(blur[0] * blur[1], axis=0)])


def _tones(coverage: np.ndarray, levels: np.ndarray, places: np.ndarray) -> np.ndarray:
    """What the tone curve is a sum of, (n, 8), at pixels (n, 2) in sides.

    White light of a coverage is encoded as sRGB (IEC 61966-2-1), as a share c of the way from the
    grey level of black to that of white, 0 to 255. Grey is ``a(x, y) c + b(x, y) + q c (1 - c) + r
    c (1 - c) (1 - 2 c)``: shading linear in x and y for white, linear for black, and bows for what
    the camera's curve has beside sRGB's and for the blooming of white into black.
    """
    dark, bright = linear_light(levels)
    light = dark + coverage * (bright - dark)
    curved = 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055
    grey = 255 * np.where(light <= 0.0031308, 12.92 * light, curved)
    white = ((grey - levels[0]) / (levels[1] - levels[0]))[:, None]
    shading, black = np.column_stack([np.ones(len(places)), places]), 1 - white
    bow = white * black
    return np.hstack([white * shading, black * shading, bow, bow * (black - white)])


def _tukey(squared: np.ndarray) -> np.ndarray:
    """Tukey's biweight of squared ratios and its two derivatives, for `least_squares`."""
    left = np.maximum(1 - squared, 0.0)
    return np.array([(1 - left**3) / 3, left**2, -2 * left])
