"""The matching cost of PatchMatch: weighted NCC of a small slanted patch between two photos.

A hypothesis at pixel (x, y) is the inverse depth ``w`` there and its slopes ``gx``, ``gy`` per
pixel. A plane's inverse depth is affine in the pixel's position, so a hypothesis moves to a
neighbour pixel with two multiplications, and a pixel projects into a source as

    (u, v, 1) z = A (x, y, 1) + b w,   A = K_s R K_r^-1,  b = K_s t,

whose derivatives give the affine map of the patch (homographies are affine over seven pixels). What
the wood bends away from the plane (:mod:`cherrypicker.mvs.kernels.bend`) moves a sample along its
epipolar line.

Photos are packed, four neighbouring grey values in one 32-bit word, so that a bilinear sample costs
one load and the loop over the samples of a patch compiles to vector gathers.
"""

import cv2
import numpy as np
import pycolmap

from cherrypicker.compiled import Num, inlined
from cherrypicker.geometry.robust import robust_sigma
from cherrypicker.mvs.kernels.level import N_SAMPLES, Level, Scratch
from cherrypicker.mvs.kernels.projection import BEHIND, depth_in, pixel_in

# Samples that are all taken where a window has more: the disc of radius 2
N_INNER = 13
# Deviation of the spatial weight, in radii of the window (guess)
WINDOW_SIGMA = 0.75
# Cost of a source that cannot see the patch, and of one whose patch does not correlate at all
INVALID_COST = np.float32(2.0)
# Variance (grey levels squared) of camera noise and JPEG: damps the correlation of flat patches.
# With each photo's own, 3 and 50, F1 at 5 mm of two scans falls by 0.007 and 0.08 (2026-11-30)
NOISE_VARIANCE = np.float32(4.0)
# A patch may grow at most so much from one photo to another (guess)
MAX_STRETCH = np.float32(3.0)
# Pixels of reprojection error at which geometric inconsistency no longer grows
MAX_GEOMETRIC_PX = np.float32(pycolmap.PatchMatchOptions().geom_consistency_max_cost)

_0 = np.float32(0.0)
_1 = np.float32(1.0)
_BYTE = np.int32(255)


def pack_bilinear(grey: np.ndarray) -> np.ndarray:
    """Pack each pixel (height, width), uint8, with its right, lower and lower right neighbour.

    Bytes from the lowest, in (height * width,) int32: (y, x), (y, x + 1), (y + 1, x),
    (y + 1, x + 1); edges repeated.
    """
    padded = np.pad(grey, ((0, 1), (0, 1)), mode="edge")
    corners = padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:]
    return cv2.merge(corners).view("<i4").ravel()


def pack_color(rgb: np.ndarray) -> np.ndarray:
    """Pack red, green, blue and grey of each pixel, (height, width, 3) uint8 to (h * w,) int32."""
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    return cv2.merge((*cv2.split(rgb), grey)).view("<i4").ravel()


def noise_variance(rgb: np.ndarray) -> float:
    """Estimate the variance of a photo's noise, grey levels squared, from (h, w, 3) uint8.

    That of the median response to the mask of Immerkaer ("Fast noise variance estimation", CVIU
    1996), in which edges and slopes vanish, where no channel is clipped; one grey level at least.
    Its pixels lie two apart: demosaicing, undistortion and JPEG take the noise of neighbours away.
    Fine texture counts.
    """
    second = np.array((1.0, 0.0, -2.0, 0.0, 1.0))
    response = cv2.filter2D(rgb, cv2.CV_32F, np.outer(second, second) / 6.0)
    told = response[(rgb > 0) & (rgb < 255)]
    return max(robust_sigma(told) ** 2, 1.0) if len(told) else 1.0


def window(radius: int) -> np.ndarray:
    """Choose the samples of a round window of a radius, px: dx, dy and weight, (3, 32) float32.

    The inner pixels are all taken; where the disc has more than 32 pixels the outer ones are
    thinned evenly and stand for those left out.
    """
    reach = np.arange(-radius, radius + 1)
    dy, dx = (a.ravel() for a in np.meshgrid(reach, reach, indexing="ij"))
    squared = dx**2 + dy**2
    inside = np.flatnonzero(squared <= radius * radius + 1)
    order = inside[np.lexsort((np.arctan2(dy, dx)[inside], squared[inside]))]
    weight = np.ones(len(order))
    if len(order) > N_SAMPLES:
        n_outer = N_SAMPLES - N_INNER
        outer = order[N_INNER:]
        taken = outer[np.round(np.linspace(0, len(outer) - 1, n_outer)).astype(int)]
        weight = np.r_[np.ones(N_INNER), np.full(n_outer, len(outer) / n_outer)]
        order = np.r_[order[:N_INNER], taken]
    samples = np.zeros((3, N_SAMPLES), dtype=np.float32)
    samples[0, : len(order)] = dx[order]
    samples[1, : len(order)] = dy[order]
    samples[2, : len(order)] = weight * np.exp(
        -squared[order] / (2.0 * (WINDOW_SIGMA * radius) ** 2)
    )
    return samples


@inlined
def prepare(level: Level, x: Num, y: Num, scratch: Scratch) -> Num:
    """Fill the bilateral weights of the patch at (x, y) and its centred, weighted grey values.

    Weights fall with the squared colour distance to the centre pixel as ``1 / (1 + d^2 / s^2)``,
    so the window shrinks to the structure that the pixel belongs to, yet an edge still counts.
    ``s^2`` is what noise makes of ``d^2`` between two pixels of one colour: a clean photo's patch
    keeps to its twig, a noisy one's stays wide.
    Both go to ``scratch.patch``, with the patch's bends. Returns the patch's weighted variance,
    grey levels squared.
    """
    color, width, height = level.color, level.width, level.height
    patch, pixels = scratch.patch, scratch.pixels
    reach = np.int64(level.radius)
    pixel = y * width + x
    own = color[np.uint64(pixel)]
    r0 = np.float32(np.int32(own & _BYTE))
    g0 = np.float32(np.int32((own >> 8) & _BYTE))
    b0 = np.float32(np.int32((own >> 16) & _BYTE))
    total = _0
    mean = _0
    square = _0
    if x < reach or y < reach or x >= width - reach or y >= height - reach:
        for k in range(N_SAMPLES):  # the photo's edge is repeated
            px = min(max(x + np.int64(patch[0, k]), 0), width - 1)
            py = min(max(y + np.int64(patch[1, k]), 0), height - 1)
            pixels[k] = color[np.uint64(py * width + px)]
    else:
        for k in range(N_SAMPLES):
            pixels[k] = color[np.uint64(pixel + level.offsets[k])]
    for k in range(N_SAMPLES):
        q = pixels[k]
        dr = np.float32(np.int32(q & _BYTE)) - r0
        dg = np.float32(np.int32((q >> 8) & _BYTE)) - g0
        db = np.float32(np.int32((q >> 16) & _BYTE)) - b0
        grey = np.float32(np.int32((q >> 24) & _BYTE))
        weight = patch[2, k] / (_1 + (dr * dr + dg * dg + db * db) * level.inv_color)
        patch[3, k] = weight
        patch[4, k] = grey
        total += weight
        mean += weight * grey
        square += weight * grey * grey
    if level.bend.shape[0] > 0:
        bend = level.bend[y, x]
        for k in range(N_SAMPLES):
            across = bend[0] * patch[0, k] + bend[1] * patch[1, k]
            patch[5, k] = min(across * across, bend[2])
    inverse = _1 / total
    mean *= inverse
    for k in range(N_SAMPLES):
        weight = patch[3, k] * inverse
        patch[3, k] = weight
        patch[4, k] = (patch[4, k] - mean) * weight
    return max(square * inverse - mean * mean, _0)


@inlined
def most_bend(level: Level, x: Num, y: Num) -> Num:
    """Return by how much inverse depth the wood at a pixel bends away at most, 0 where flat."""
    return level.bend[y, x, 2] if level.bend.shape[0] > 0 else _0


@inlined
def source_cost(
    level: Level, s: Num, x: Num, y: Num, w: Num, gx: Num, gy: Num, variance: Num, patch: np.ndarray
) -> Num:
    """Return 1 - NCC of the patch in source ``s``, in [0, 2]; 2 where it is not to be seen."""
    P, layout, packed = level.project, level.layout, level.packed
    z = depth_in(P, s, x, y, w)
    if z <= BEHIND:
        return INVALID_COST
    u, v = pixel_in(P, s, x, y, w, z)
    iz = _1 / z
    zx = P[s, 6] + P[s, 11] * gx
    zy = P[s, 7] + P[s, 11] * gy
    ux = (P[s, 0] + P[s, 9] * gx - u * zx) * iz
    uy = (P[s, 1] + P[s, 9] * gy - u * zy) * iz
    vx = (P[s, 3] + P[s, 10] * gx - v * zx) * iz
    vy = (P[s, 4] + P[s, 10] * gy - v * zy) * iz
    reach_u = abs(ux) + abs(uy)
    reach_v = abs(vx) + abs(vy)
    if max(reach_u, reach_v) > MAX_STRETCH:
        return INVALID_COST
    back_u = (P[s, 9] - u * P[s, 11]) * iz
    back_v = (P[s, 10] - v * P[s, 11]) * iz
    most = most_bend(level, np.int64(x), np.int64(y))
    reach_u = reach_u * level.radius + abs(back_u) * most
    reach_v = reach_v * level.radius + abs(back_v) * most
    base = np.int32(layout[s, 0])
    width = np.int32(layout[s, 1])
    last_u = np.float32(layout[s, 1] - 1)
    last_v = np.float32(layout[s, 2] - 1)
    if u - reach_u < _0 or v - reach_v < _0 or u + reach_u > last_u or v + reach_v > last_v:
        return INVALID_COST
    first = _0
    second = _0
    cross = _0
    for k in range(N_SAMPLES):
        su = u + ux * patch[0, k] + uy * patch[1, k] - back_u * patch[5, k]
        sv = v + vx * patch[0, k] + vy * patch[1, k] - back_v * patch[5, k]
        iu = np.int32(su)
        iv = np.int32(sv)
        fu = su - np.float32(iu)
        fv = sv - np.float32(iv)
        q = packed[np.uint64(np.int64(np.int32(base + np.int32(iv * width) + iu)))]
        c00 = np.float32(np.int32(q & _BYTE))
        c01 = np.float32(np.int32((q >> 8) & _BYTE))
        c10 = np.float32(np.int32((q >> 16) & _BYTE))
        c11 = np.float32(np.int32((q >> 24) & _BYTE))
        top = c00 + fu * (c01 - c00)
        bottom = c10 + fu * (c11 - c10)
        value = top + fv * (bottom - top)
        first += patch[3, k] * value
        second += patch[3, k] * value * value
        cross += patch[4, k] * value
    source_variance = max(second - first * first, _0)
    return _1 - cross / np.sqrt((variance + NOISE_VARIANCE) * (source_variance + NOISE_VARIANCE))


@inlined
def geometric_error(level: Level, s: Num, x: Num, y: Num, w: Num) -> Num:
    """Return the reprojection error (px, at most 3) through the inverse depth map of source ``s``.

    The pixel goes into the source at inverse depth ``w``, and back at the inverse depth that the
    source itself found there; 3 px where the source does not know.
    """
    layout = level.layout
    z = depth_in(level.project, s, x, y, w)
    if z <= BEHIND:
        return MAX_GEOMETRIC_PX
    u, v = pixel_in(level.project, s, x, y, w, z)
    iu = np.int64(np.floor(u + np.float32(0.5)))
    iv = np.int64(np.floor(v + np.float32(0.5)))
    if iu < 0 or iv < 0 or iu >= layout[s, 1] or iv >= layout[s, 2]:
        return MAX_GEOMETRIC_PX
    found = level.depth[np.uint64(layout[s, 0] + iv * layout[s, 1] + iu)]
    if found <= _0:
        return MAX_GEOMETRIC_PX
    z = depth_in(level.back, s, u, v, found)
    if z <= BEHIND:
        return MAX_GEOMETRIC_PX
    back_x, back_y = pixel_in(level.back, s, u, v, found, z)
    dx = back_x - x
    dy = back_y - y
    return min(np.sqrt(dx * dx + dy * dy), MAX_GEOMETRIC_PX)
