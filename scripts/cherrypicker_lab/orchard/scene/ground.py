"""The orchard's floor: its albedo at any place, and baked into textures for the renderer.

Both come from one function of the place, so clouds and photos show the same ground. A texture is
a regular grid, on which the lattice noise of whole rows shares its random numbers.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from cherrypicker_lab.orchard.scene.appearance import encode_srgb
from cherrypicker_lab.orchard.scene.noise import hash_cell, value_noise


@dataclass(frozen=True)
class GroundKind:
    """A kind of floor; None keeps what the seed draws."""

    bare: float | None = None  # how much of the alleys is bare earth; below 0 none, above 1 all
    strip: float | None = None  # half width of the strip along the row, m; 0 for none
    dead: float = 0.0  # share of dead grass on the strip, in place of bare earth
    litter: tuple = (1.0, 1.0, 1.0)  # pebbles, clods and dead leaves, of their usual number
    # cells, density: pieces that cover it: cells a metre, share of the cells that hold one
    cells: float = 30.0
    density: float = 0.0
    # low, high: colours between which the pieces lie, linear RGB
    low: tuple = (0.0, 0.0, 0.0)
    high: tuple = (0.0, 0.0, 0.0)
    everywhere: bool = False  # pieces lie everywhere; else on the strip alone


GROUNDS = {
    "meadow": GroundKind(),
    "grass": GroundKind(bare=0.05, strip=0.0, litter=(0.15, 0.6, 0.5)),
    "soil": GroundKind(bare=1.2, strip=60.0, litter=(0.7, 1.5, 0.15), cells=20.0, density=0.3,
                       low=(0.10, 0.07, 0.045), high=(0.30, 0.22, 0.15), everywhere=True),
    "herbicide": GroundKind(bare=0.15, strip=0.75, dead=0.85, litter=(0.3, 1.0, 0.5)),
    "mulch": GroundKind(bare=0.2, strip=0.7, litter=(0.2, 0.7, 0.4), cells=38.0, density=0.95,
                        low=(0.08, 0.04, 0.02), high=(0.36, 0.24, 0.13)),
    "gravel": GroundKind(bare=1.2, strip=60.0, litter=(0.0, 0.3, 0.2), cells=34.0, density=0.9,
                         low=(0.13, 0.125, 0.12), high=(0.46, 0.45, 0.43), everywhere=True),
}  # fmt: skip
# pebbles, clods and straw, dead leaves: cells a metre, density, shift of the seed, colours
_LITTER = (
    (26.0, 0.18, 53, (0.16, 0.15, 0.14), (0.48, 0.46, 0.42)),
    (60.0, 0.22, 59, (0.05, 0.045, 0.04), (0.36, 0.30, 0.22)),
    (15.0, 0.28, 67, (0.16, 0.085, 0.04), (0.42, 0.25, 0.11)),
)
_COVER_SEED = 73
# axis-aligned noise: cells a metre, octaves, gain, shift of the seed
_TONE, _FINE, _PICK, _BARE = (2.5, 5, 0.7, 0), (42.0, 4, 0.8, 11), (18.0, 1, 0.55, 31), (
    1.6, 5, 0.65, 41,
)  # fmt: skip
_LEVELS = 8192  # of the table from linear light to sRGB


def _draw(seed, kind):
    """Numbers of one floor: the lattice's seed, palette (17,) and pieces (n, 10)."""
    if kind not in GROUNDS:
        raise ValueError(f"ground must be one of {', '.join(GROUNDS)}, got {kind!r}")
    floor = GROUNDS[kind]
    rng = np.random.default_rng([int(seed), 41])
    lattice = int(rng.integers(1 << 30))
    bare, strip = rng.uniform(0.25, 0.55), rng.uniform(0.4, 0.9)
    green = np.array([0.125, 0.170, 0.050]) * rng.uniform(0.8, 1.2)
    dry = np.array([0.33, 0.28, 0.13]) * rng.uniform(0.8, 1.1)
    earth = np.array([0.190, 0.135, 0.090]) * rng.uniform(0.75, 1.25)
    bare = bare if floor.bare is None else floor.bare
    strip = strip if floor.strip is None else floor.strip
    palette = np.concatenate([[bare, strip, floor.dead], green, dry, earth])
    pieces = [
        (cells, density * share, shift, *low, *high, 1.0)
        for (cells, density, shift, low, high), share in zip(_LITTER, floor.litter)
    ]
    if floor.density > 0:
        pieces.insert(0, (floor.cells, floor.density, _COVER_SEED, *floor.low, *floor.high,
                          float(floor.everywhere)))  # fmt: skip
    return lattice, palette, np.array(pieces)


@njit(cache=True)
def _noise_at(x, y, octaves, gain, seed):
    """`noise.fbm` at one place of the plane."""
    amplitude, total, norm = 1.0, 0.0, 0.0
    for octave in range(octaves):
        total += amplitude * (value_noise(x, y, 0.0, seed + octave) - 0.5)
        norm += amplitude * amplitude
        amplitude *= gain
        x, y = 2.03 * x + 17.1, 2.03 * y + 5.3
    return min(max(0.5 + total / np.sqrt(norm), 0.0), 1.0)


@njit(cache=True)
def _piece_at(x, y, density, seed):
    """`noise.spots` at one place of the plane: strength and tint."""
    i, j = np.int64(np.floor(x)), np.int64(np.floor(y))
    best, cell_a, cell_b = 0.0, i, j
    for a in range(i - 1, i + 2):
        for b in range(j - 1, j + 2):
            if hash_cell(a, b, 0, seed) >= density:
                continue
            dx = x - a - hash_cell(a, b, 0, seed + 1)
            dy = y - b - hash_cell(a, b, 0, seed + 2)
            if dx * dx + dy * dy > 0.64:  # no spot is larger
                continue
            radius = 0.25 + 0.55 * hash_cell(a, b, 0, seed + 4)
            value = 1.0 - np.sqrt(dx * dx + dy * dy) / radius
            if value > best:
                best, cell_a, cell_b = value, a, b
    return best, (hash_cell(cell_a, cell_b, 0, seed + 5) if best > 0 else 0.0)


@njit(cache=True, inline="always")
def _limited(value, low, high):
    return min(max(value, low), high)


@njit(cache=True)
def _color_at(x, y, tone, fine, pick, bare_noise, lattice, palette, pieces, out):
    """Albedo (3,) at a place where the axis-aligned noises are known."""
    # blades: noise stretched along two crossing directions, chosen patch by patch
    u, v = x + 0.6 * y, y - 0.6 * x
    if pick > 0.5:
        blades = _noise_at(220.0 * u, 38.0 * v, 2, 0.7, lattice + 23)
    else:
        blades = _noise_at(34.0 * u, 200.0 * v, 2, 0.7, lattice + 29)
    bare, strip, dead = palette[0], palette[1], palette[2]
    on_strip = 1.0 - abs(y) / strip if strip > 0 else -1.0
    cover = _limited((bare - bare_noise) / 0.05, -4.0, 4.0) + 5.0 * on_strip
    is_soil = _limited(0.5 + 0.4 * cover + 1.2 * (blades - 0.5), 0.0, 1.0)
    dryness = _limited(1.7 * (tone - 0.36), 0.0, 1.0)
    grass_light = 0.10 + 1.25 * blades + 0.55 * fine
    soil_light = 0.15 + 0.9 * fine + 0.8 * tone
    withered = dead * _limited(1.5 + 5.0 * on_strip, 0.0, 1.0)
    for c in range(3):
        dry = palette[6 + c]
        grass = (palette[3 + c] * (1.0 - dryness) + dry * dryness) * grass_light
        soil = palette[9 + c] * soil_light * (1.0 - withered) + dry * grass_light * withered
        out[c] = grass * (1.0 - is_soil) + soil * is_soil
    for k in range(len(pieces)):
        cells, everywhere = pieces[k, 0], pieces[k, 9]
        amount = 5.0
        if everywhere == 0.0:
            amount = 5.0 * _limited(2.0 * on_strip + 2.0 * (blades - 0.5), 0.0, 1.0)
            if amount == 0.0:
                continue
        # the fine noise frays the rims
        strength, tint = _piece_at(
            x * cells + 0.55 * (fine - 0.5), y * cells + 0.55 * (blades - 0.5), pieces[k, 1],
            lattice + int(pieces[k, 2]),
        )  # fmt: skip
        if strength > 0.0:
            share = _limited(amount * strength, 0.0, 1.0)
            light = 0.55 + 0.9 * fine
            for c in range(3):
                low, high = pieces[k, 3 + c], pieces[k, 6 + c]
                out[c] = out[c] * (1.0 - share) + (low + tint * (high - low)) * light * share
    for c in range(3):
        out[c] = _limited(out[c], 0.006, 0.8)


@njit(cache=True)
def _colors(xy, lattice, palette, pieces, noises, out):
    field = np.empty(4)
    for n in range(len(xy)):
        x, y = xy[n, 0], xy[n, 1]
        for k in range(4):
            cells, octaves, gain, shift = noises[k]
            field[k] = _noise_at(cells * x, cells * y, int(octaves), gain, lattice + int(shift))
        _color_at(x, y, field[0], field[1], field[2], field[3], lattice, palette, pieces, out[n])


@njit(cache=True)
def _lattice_row(j, first, n, seed, out):
    for i in range(n):
        out[i] = hash_cell(first + i, j, 0, seed)


@njit(cache=True)
def _add_octave(x, ys, amplitude, seed, out):
    """Add one octave of noise on a grid with columns x and rows ys, in lattice cells."""
    first = np.int64(np.floor(x[0]))
    n_cells = np.int64(np.floor(x[-1])) - first + 2
    low, high = np.empty(n_cells), np.empty(n_cells)
    column = np.empty(len(x), np.int64)
    share = np.empty(len(x))
    for c in range(len(x)):
        column[c] = np.int64(np.floor(x[c])) - first
        f = x[c] - np.floor(x[c])
        share[c] = f * f * (3 - 2 * f)
    known = np.int64(np.floor(ys[0])) - 2
    for r in range(len(ys)):
        j = np.int64(np.floor(ys[r]))
        if j != known:
            _lattice_row(j, first, n_cells, seed, low)
            _lattice_row(j + 1, first, n_cells, seed, high)
            known = j
        f = ys[r] - np.floor(ys[r])
        f = f * f * (3 - 2 * f)
        for c in range(len(x)):
            i, g = column[c], share[c]
            a = low[i] * (1 - g) + low[i + 1] * g
            b = high[i] * (1 - g) + high[i + 1] * g
            out[r, c] += amplitude * (a * (1 - f) + b * f - 0.5)


@njit(cache=True)
def _grid_noise(x, ys, cells, octaves, gain, seed, out):
    """`noise.fbm` of the plane on a grid."""
    out[:] = 0.0
    x, ys = x * cells, ys * cells
    amplitude, norm = 1.0, 0.0
    for octave in range(octaves):
        _add_octave(x, ys, amplitude, seed + octave, out)
        norm += amplitude * amplitude
        amplitude *= gain
        x, ys = 2.03 * x + 17.1, 2.03 * ys + 5.3
    scale = 1.0 / np.sqrt(norm)
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            out[r, c] = min(max(0.5 + out[r, c] * scale, 0.0), 1.0)


@njit(cache=True)
def _bake(x, ys, lattice, palette, pieces, noises, table, fields, out):
    color = np.empty(3)
    for k in range(4):
        cells, octaves, gain, shift = noises[k]
        _grid_noise(x, ys, cells, int(octaves), gain, lattice + int(shift), fields[k])
    for r in range(len(ys)):
        for c in range(len(x)):
            _color_at(
                x[c], ys[r], fields[0, r, c], fields[1, r, c], fields[2, r, c], fields[3, r, c],
                lattice, palette, pieces, color,
            )  # fmt: skip
            for k in range(3):
                out[r, c, k] = table[int(color[k] * len(table))]


def ground_color(xy, seed, kind="meadow"):
    """Albedo of the orchard floor.

    Parameters
    ----------
    xy : ndarray of shape (N, 2)
        Position, m; the row runs along x.
    seed : int
        Seed of the floor; it also draws the mix of grass and soil.
    kind : str, default "meadow"
        A key of `GROUNDS`: "meadow" (grass alleys, a bare strip along the row, pebbles, dead
        leaves), "grass", "soil", "herbicide" (dead grass on the strip), "mulch" (wood chips on
        the strip) or "gravel".

    Returns
    -------
    ndarray of shape (N, 3), float64
        Linear RGB.

    Raises
    ------
    ValueError
        If there is no such kind.
    """
    xy = np.ascontiguousarray(xy, dtype=np.float64)
    out = np.empty((len(xy), 3))
    _colors(xy, *_draw(seed, kind), np.array([_TONE, _FINE, _PICK, _BARE]), out)
    return out


def bake_ground(seed, half, size, kind="meadow"):
    """Ground albedo over a square around the origin as an image, north (y) up.

    Parameters
    ----------
    seed, kind
        As in `ground_color`.
    half : float
        Half width of the square, m.
    size : int
        Pixels a side.

    Returns
    -------
    ndarray of shape (size, size, 3), uint8
        sRGB, each pixel the colour at its centre.
    """
    axis = (np.arange(size) + 0.5) / size * 2 * half - half
    table = np.round(255 * encode_srgb((np.arange(_LEVELS) + 0.5) / _LEVELS)).astype(np.uint8)
    noises = np.array([_TONE, _FINE, _PICK, _BARE])
    image = np.empty((size, size, 3), np.uint8)
    rows = max(1, min(size, 1_000_000 // size))
    fields = np.empty((4, rows, size))
    for start in range(0, size, rows):
        ys = -axis[start : start + rows]
        _bake(axis, ys, *_draw(seed, kind), noises, table, fields[:, : len(ys)],
              image[start : start + rows])  # fmt: skip
    return image
