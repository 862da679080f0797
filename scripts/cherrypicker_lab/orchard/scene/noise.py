"""Seeded lattice noise that never repeats: the source of every texture of the orchard.

The same functions colour the rendered photos and the sampled clouds, so that a network trained
on the clouds sees the bark and the ground that the photos show.
"""

import numpy as np
from numba import njit


@njit(cache=True, inline="always")
def hash_cell(i, j, k, seed):
    """Mix three lattice coordinates and a seed into a number in [0, 1)."""
    # numba widens products of 32-bit integers: every step is cut back to 32 bits
    h = np.uint32(np.uint32(seed) * np.uint32(0x9E3779B1))
    h = np.uint32(h ^ np.uint32(np.uint32(i) * np.uint32(0x85EBCA6B)))
    h = np.uint32((h ^ (h >> np.uint32(15))) * np.uint32(0x2C1B3C6D))
    h = np.uint32(h ^ np.uint32(np.uint32(j) * np.uint32(0xC2B2AE35)))
    h = np.uint32((h ^ (h >> np.uint32(12))) * np.uint32(0x297A2D39))
    h = np.uint32(h ^ np.uint32(np.uint32(k) * np.uint32(0x27D4EB2F)))
    h = np.uint32((h ^ (h >> np.uint32(15))) * np.uint32(0x165667B1))
    h = np.uint32(h ^ (h >> np.uint32(13)))
    return np.float64(h) / 4294967296.0


@njit(cache=True, inline="always")
def _layer(a, b, c, fx, fy, seed):
    near = hash_cell(a, b, c, seed) * (1 - fx) + hash_cell(a + 1, b, c, seed) * fx
    far = hash_cell(a, b + 1, c, seed) * (1 - fx) + hash_cell(a + 1, b + 1, c, seed) * fx
    return near * (1 - fy) + far * fy


@njit(cache=True)
def value_noise(x, y, z, seed):
    """Value noise at one point, in [0, 1]."""
    i, j, k = np.floor(x), np.floor(y), np.floor(z)
    fx, fy, fz = x - i, y - j, z - k
    fx, fy, fz = fx * fx * (3 - 2 * fx), fy * fy * (3 - 2 * fy), fz * fz * (3 - 2 * fz)
    a, b, c = np.int64(i), np.int64(j), np.int64(k)
    low = _layer(a, b, c, fx, fy, seed)
    if fz == 0.0:
        return low
    return low * (1 - fz) + _layer(a, b, c + 1, fx, fy, seed) * fz


@njit(cache=True)
def fbm_at(x, y, z, octaves, gain, seed):
    """`fbm` at one point."""
    amplitude, total, norm = 1.0, 0.0, 0.0
    for octave in range(octaves):
        total += amplitude * (value_noise(x, y, z, seed + octave) - 0.5)
        norm += amplitude * amplitude
        amplitude *= gain
        # a factor off 2 and a shift keep the lattices of the octaves apart
        x, y = 2.03 * x + 17.1, 2.03 * y + 5.3
        if z != 0.0:
            z = 2.03 * z + 9.7
    return min(max(0.5 + total / np.sqrt(norm), 0.0), 1.0)


@njit(cache=True)
def _fbm(points, octaves, gain, seed, out):
    for n in range(len(points)):
        out[n] = fbm_at(points[n, 0], points[n, 1], points[n, 2], octaves, gain, seed)


@njit(cache=True)
def _spots(points, density, seed, strength, tint):
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        i, j, k = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
        best, best_tint = 0.0, 0.0
        for a in range(i - 1, i + 2):
            for b in range(j - 1, j + 2):
                for c in range(k - 1, k + 2):
                    if hash_cell(a, b, c, seed) >= density:
                        continue
                    dx = x - a - hash_cell(a, b, c, seed + 1)
                    dy = y - b - hash_cell(a, b, c, seed + 2)
                    dz = z - c - hash_cell(a, b, c, seed + 3)
                    radius = 0.25 + 0.55 * hash_cell(a, b, c, seed + 4)
                    value = 1.0 - np.sqrt(dx * dx + dy * dy + dz * dz) / radius
                    if value > best:
                        best, best_tint = value, hash_cell(a, b, c, seed + 5)
        strength[n] = best
        tint[n] = best_tint


def fbm(points, *, octaves=4, gain=0.55, seed=0):
    """Fractal value noise (several octaves of lattice noise, not periodic), (N,) in [0, 1].

    Its mean is 0.5. The points (N, 3) are in lattice cells (metres times the cells per metre
    wanted); a third coordinate of exactly 0 gives the cheaper two-dimensional noise. Each octave is
    about twice as fine as the one before and has `gain` of its amplitude.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    out = np.empty(len(points))
    _fbm(points, int(octaves), float(gain), int(seed), out)
    return out


def spots(points, *, density=0.5, seed=0):
    """Randomly placed round spots: lichen, lenticels, knots.

    The points (N, 3) are in cells, of which a share, `density`, holds a spot of radius 0.25 to 0.8
    cells. Returns the strength (N,), 1 in the middle of a spot, falling to 0 at its rim and
    outside, and the tint (N,), a random number in [0, 1) of the spot that covers the point, 0
    outside.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    strength, tint = np.empty(len(points)), np.empty(len(points))
    _spots(points, float(density), int(seed), strength, tint)
    return strength, tint
