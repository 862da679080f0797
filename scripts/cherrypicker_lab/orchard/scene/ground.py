"""The orchard's floor: its albedo at any place, and baked into textures for the renderer.

Both come from one function of the place, so clouds and photos show the same ground.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from cherrypicker_lab.orchard.scene.appearance import encode_srgb
from cherrypicker_lab.orchard.scene.noise import fbm_at, hash_cell


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
# noise of tone, grain, patches of blades and bare earth: cells a metre, octaves, gain, seed's shift
_NOISES = ((2.5, 5, 0.7, 0), (42.0, 4, 0.8, 11), (18.0, 1, 0.55, 31), (1.6, 5, 0.65, 41))
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
def _color_at(x, y, lattice, palette, pieces, noises, out):
    """Albedo (3,) at a place."""
    field = np.empty(4)
    for k in range(4):
        cells, octaves, gain, shift = noises[k]
        seed = lattice + int(shift)
        field[k] = fbm_at(cells * x, cells * y, 0.0, int(octaves), gain, seed)
    tone, fine, pick, bare_noise = field
    # blades: noise stretched along two crossing directions, chosen patch by patch
    u, v = x + 0.6 * y, y - 0.6 * x
    if pick > 0.5:
        blades = fbm_at(220.0 * u, 38.0 * v, 0.0, 2, 0.7, lattice + 23)
    else:
        blades = fbm_at(34.0 * u, 200.0 * v, 0.0, 2, 0.7, lattice + 29)
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
    for n in range(len(xy)):
        _color_at(xy[n, 0], xy[n, 1], lattice, palette, pieces, noises, out[n])


def ground_color(xy, seed, kind="meadow"):
    """Albedo of the orchard floor at positions (N, 2), m, the row along x: linear RGB, (N, 3).

    The seed also draws the mix of grass and soil. The kind is a key of `GROUNDS`: "meadow" (grass
    alleys, a bare strip along the row, pebbles, dead leaves), "grass", "soil", "herbicide" (dead
    grass on the strip), "mulch" (wood chips on the strip) or "gravel". Raises a ValueError if there
    is no such kind.
    """
    xy = np.ascontiguousarray(xy, dtype=np.float64)
    out = np.empty((len(xy), 3))
    _colors(xy, *_draw(seed, kind), np.array(_NOISES), out)
    return out


def bake_ground(seed, half, size, kind="meadow"):
    """Ground albedo over a square around the origin as an image, north (y) up.

    Seed and kind are as in `ground_color`, `half` is the square's half width, m, `size` its pixels
    a side. The image, (size, size, 3) uint8, is sRGB, each pixel the colour at its centre.
    """
    axis = (np.arange(size) + 0.5) / size * 2 * half - half
    table = np.round(255 * encode_srgb((np.arange(_LEVELS) + 0.5) / _LEVELS)).astype(np.uint8)
    image = np.empty((size, size, 3), np.uint8)
    for row, y in enumerate(-axis):
        color = ground_color(np.column_stack([axis, np.full(size, y)]), seed, kind)
        image[row] = table[(color * _LEVELS).astype(int)]
    return image
