"""The kernel of the fusion: a point for each pixel of a photo that other photos agree on."""

from typing import NamedTuple

import numpy as np

from cherrypicker.compiled import Num, inlined, kernel
from cherrypicker.mvs.kernels.projection import BEHIND, depth_in, pixel_at, pixel_in

_0 = np.float32(0.0)
_1 = np.float32(1.0)
# Neighbour pixels whose depths differ by less, as a share, are explained by one point (guess)
SAME_SURFACE = 0.003


class Group(NamedTuple):
    """A reference photo, the first, and those that overlap it, as the kernels take them."""

    # (n_slots, n_pixels, 4) float32: normals and depth of the photos at hand, each in its own
    # camera
    maps: np.ndarray
    # (n_views, n_pixels) uint8: pixels explained; those of the matching pixels are set. The same
    # value may be written by two threads, which is harmless, and nothing but the reference's own
    # row is read.
    used: np.ndarray
    # slots, rows, sizes: where each photo lies in ``maps`` and in ``used``, and (n, 2) its width
    # and height
    slots: np.ndarray
    rows: np.ndarray
    sizes: np.ndarray
    # forward, back, turns: projections from and to the reference, (n, 12); rotations to the
    # reference, (n, 9)
    forward: np.ndarray
    back: np.ndarray
    turns: np.ndarray
    ray: tuple  # reference's fx, fy, cx, cy (pixel centres at whole numbers)
    limits: tuple  # reprojection error (px), relative depth error, cosine of the normals' angle
    min_views: int


@inlined
def _explain(group: Group, j: Num, corner: Num, depth: Num) -> None:
    """Mark the four pixels around a match in photo ``j`` that lie on the same surface."""
    width = group.sizes[j, 0]
    for i in range(4):
        pixel = corner + (i & 1) + (i >> 1) * width
        if pixel < 0 or pixel >= width * group.sizes[j, 1]:
            continue
        if abs(group.maps[group.slots[j], pixel, 3] - depth) < np.float32(SAME_SURFACE) * depth:
            group.used[group.rows[j], pixel] = 1


@inlined
def _from_other(group: Group, j: Num, u: Num, v: Num, depth: Num) -> tuple[Num, Num, Num]:
    """Return the point of photo ``j`` at pixel (u, v) in the reference: x, y (px), depth."""
    w = _1 / depth
    z = depth_in(group.back, j, u, v, w)
    x, y = pixel_in(group.back, j, u, v, w, z)
    return x, y, z * depth


@inlined
def _ask(
    group: Group,
    j: Num,
    pixel: Num,
    x: Num,
    y: Num,
    depth: Num,
    normal: np.ndarray,
    values: np.ndarray,
    m: Num,
    matched: np.ndarray,
) -> Num:
    """Add photo ``j``'s own point to ``values`` and its normal to ``normal``, if it agrees."""
    w = _1 / depth
    z = depth_in(group.forward, j, x, y, w)
    if z <= BEHIND:
        return False
    u, v = pixel_in(group.forward, j, x, y, w, z)
    iu = pixel_at(u)
    iv = pixel_at(v)
    width = group.sizes[j, 0]
    if iu < 0 or iv < 0 or iu >= width or iv >= group.sizes[j, 1]:
        return False
    slot = group.slots[j]
    other = iv * width + iu
    found = group.maps[slot, other, 3]
    expected = z * depth
    if found <= _0 or abs(found - expected) > group.limits[1] * expected:
        return False
    bx, by, _ = _from_other(group, j, u, v, found)
    if (bx - x) ** 2 + (by - y) ** 2 > group.limits[0] * group.limits[0]:
        return False
    own = group.slots[0]
    cosine = _0
    for c in range(3):
        turned = _0
        for k in range(3):
            turned += group.turns[j, 3 * c + k] * group.maps[slot, other, k]
        normal[3 + c] = turned
        cosine += turned * group.maps[own, pixel, c]
    if cosine < group.limits[2]:
        return False
    for c in range(3):
        normal[c] += normal[3 + c]
    px, py, pz = _from_other(group, j, np.float32(iu), np.float32(iv), found)
    values[0, m] = (px - group.ray[2]) / group.ray[0] * pz
    values[1, m] = (py - group.ray[3]) / group.ray[1] * pz
    values[2, m] = pz
    values[3, m] = found
    matched[m, 0] = j
    matched[m, 1] = np.int64(np.floor(v)) * width + np.int64(np.floor(u))
    return True


@inlined
def _middle_mean(values: np.ndarray, row: Num, n: Num) -> Num:
    """Mean of the middle half of the first ``n`` values of a row, which are sorted in place.

    As deaf to a wrong quarter on either side as the median, with less noise: 84.3 instead of 84.0 %
    of the points within 5 mm of the wood (foreign_a).
    """
    for i in range(1, n):
        value = values[row, i]
        k = i
        while k > 0 and values[row, k - 1] > value:
            values[row, k] = values[row, k - 1]
            k -= 1
        values[row, k] = value
    cut = (n - 1) // 4
    total = _0
    for i in range(cut, n - cut):
        total += values[row, i]
    return total / np.float32(n - 2 * cut)


@kernel
def fuse_rows(
    group: Group,
    first: Num,
    last: Num,
    out: np.ndarray,
    counts: np.ndarray,
    values: np.ndarray,
    matched: np.ndarray,
    normal: np.ndarray,
) -> None:
    """Fuse rows of the reference.

    ``out`` (n_pixels, 6) takes position and normal in the reference's camera, ``counts``
    (n_pixels,) the number of photos, 0 where there is no point.
    """
    width = group.sizes[0, 0]
    own = group.slots[0]
    for y in range(first, last):
        fy = np.float32(y)
        for x in range(width):
            pixel = y * width + x
            counts[pixel] = 0
            depth = group.maps[own, pixel, 3]
            if depth <= _0 or group.used[group.rows[0], pixel] != 0:
                continue
            fx = np.float32(x)
            values[0, 0] = (fx - group.ray[2]) / group.ray[0] * depth
            values[1, 0] = (fy - group.ray[3]) / group.ray[1] * depth
            values[2, 0] = depth
            for c in range(3):
                normal[c] = group.maps[own, pixel, c]
            m = 1
            for j in range(1, group.slots.shape[0]):
                if _ask(group, j, pixel, fx, fy, depth, normal, values, m, matched):
                    m += 1
            if m < group.min_views:
                continue
            for i in range(1, m):
                _explain(group, matched[i, 0], matched[i, 1], values[3, i])
            counts[pixel] = min(m, 255)
            length = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
            for c in range(3):
                out[pixel, c] = _middle_mean(values, c, m)
                out[pixel, 3 + c] = normal[c] / max(length, np.float32(1e-12))
