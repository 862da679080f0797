"""Colours of the orchard's surfaces (linear albedo) and the light that falls on them."""

from dataclasses import dataclass

import numpy as np

from cherrypicker_lab.orchard.scene.noise import fbm, spots


@dataclass(frozen=True)
class Light:
    """Sun and sky. `sun_direction` points to the sun; colours are linear RGB factors."""

    sky: str
    sun_direction: np.ndarray
    sun: np.ndarray
    ambient_top: np.ndarray
    ambient_bottom: np.ndarray

    def shade(self, albedo, normals, lit=1.0):
        """Radiance of albedo (N, 3) with unit normals (N, 3); `lit` is the share of sun."""
        facing = np.clip(normals @ self.sun_direction, 0.0, 1.0) * lit
        up = 0.5 + 0.5 * normals[:, 2:3]
        ambient = up * self.ambient_top + (1.0 - up) * self.ambient_bottom
        return albedo * (facing[:, None] * self.sun + ambient)


SKIES = {
    # sun, sun colour, ambient from above, ambient from below, elevation range in degrees
    "clear": (1.45, (1.0, 0.95, 0.86), (0.62, 0.70, 0.84), (0.42, 0.40, 0.36), (30, 48)),
    "broken": (1.05, (1.0, 0.96, 0.90), (0.80, 0.84, 0.92), (0.48, 0.46, 0.43), (28, 50)),
    "overcast": (0.22, (1.0, 1.0, 1.0), (1.18, 1.20, 1.24), (0.66, 0.65, 0.63), (35, 60)),
    "low": (1.25, (1.0, 0.80, 0.58), (0.58, 0.63, 0.76), (0.36, 0.32, 0.28), (9, 18)),
}
SMOOTH_M = 0.005  # wood of this radius and less has no relief
RELIEF, RELIEF_M = 0.07, 0.0025
DRAWN_SKIES = ("clear", "broken", "overcast")


def make_light(rng, sky=None):
    """Draw a light; `sky` is a key of `SKIES` (drawn from `DRAWN_SKIES` by default)."""
    if sky is None:
        sky = str(rng.choice(DRAWN_SKIES))
    strength, tint, top, bottom, elevation = SKIES[sky]
    azimuth, e = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(*elevation))
    direction = np.array([np.cos(e) * np.cos(azimuth), np.cos(e) * np.sin(azimuth), np.sin(e)])
    return Light(sky, direction, strength * np.array(tint), np.array(top), np.array(bottom))


def encode_srgb(linear):
    """Linear light to sRGB in [0, 1], clipped."""
    x = np.clip(linear, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def mix(a, b, t):
    """Colours (n, 3) on the way from a to b by shares t (n,), which are clipped to [0, 1]."""
    t = np.clip(t, 0.0, 1.0)[:, None]
    return a * (1.0 - t) + b * t


def bark_color(rest, radius, seed):
    """Albedo of cherry bark: grey-brown with bands, lenticels across the stem, cracks, lichen.

    `rest` (N, 3) are positions on the straightened axes (x, y across, z along), `radius` (N,) is
    the local one, both m: old wood is grey and cracked, young wood red-brown and smooth. The seed
    of the tree's bark also draws the hue. Returns linear RGB, (N, 3).
    """
    rng = np.random.default_rng([int(seed), 31])
    seed = int(rng.integers(1 << 30))
    grey = np.array([0.23, 0.195, 0.165]) * rng.uniform(0.8, 1.25)
    brown = np.array([0.25, 0.155, 0.105]) * rng.uniform(0.8, 1.2)
    lichen = np.array([0.50, 0.52, 0.36]) * rng.uniform(0.8, 1.1)
    yellow = np.array([0.55, 0.44, 0.10])
    old = np.clip((radius - 0.004) / 0.02, 0.0, 1.0)

    color = mix(brown, grey, 0.25 + 0.55 * old + 1.1 * (fbm(rest * 14, octaves=3, seed=seed) - 0.5))
    bands = fbm(rest * np.array([25, 25, 95]), octaves=4, gain=0.75, seed=seed + 11)
    color = color * (0.30 + 1.40 * bands)[:, None]
    strength, tint = spots(rest * np.array([80, 80, 230]), density=0.45, seed=seed + 23)
    color = mix(color, np.array([0.46, 0.37, 0.27]), 1.6 * strength * (0.3 + 0.7 * tint))
    crack = np.abs(fbm(rest * np.array([110, 110, 45]), octaves=3, seed=seed + 37) - 0.5)
    color = color * (1.0 - 0.75 * (old * np.clip(1.0 - crack / 0.06, 0, 1)))[:, None]
    patch = fbm(rest * 9, octaves=2, seed=seed + 51)
    strength, tint = spots(rest * 70, density=0.55, seed=seed + 61)
    cover = np.clip(3.5 * strength, 0, 1) * np.clip((patch - 0.40) / 0.15, 0, 1)
    lichens = np.where((tint > 0.8)[:, None], yellow, lichen * (0.6 + 0.7 * tint)[:, None])
    return np.clip(mix(color, lichens, 0.85 * cover), 0.01, 0.8)


def bark_relief(rest, radius, material):
    """How far bark stands out from the smooth stem: plates and cracks of old wood, lenticels.

    `rest` and `radius` are as in `bark_color`. The material has `seed`, and `relief`: the depth, of
    that of old cherry trees; 0 for smooth wood. Returns m outwards, (N,), at most `RELIEF` of the
    radius and `RELIEF_M`, each way, times `relief`.
    """
    height = np.zeros(len(rest))
    old = np.flatnonzero(radius > SMOOTH_M)
    if not material.get("relief") or len(old) == 0:
        return height
    rest, radius = rest[old], radius[old]
    seed = int(np.random.default_rng([int(material["seed"]), 31]).integers(1 << 30))
    # the colour's own patterns, so that dark cracks are deep and pale lenticels stand out
    plates = fbm(rest * np.array([25, 25, 95]), octaves=2, gain=0.75, seed=seed + 11)
    crack = np.abs(fbm(rest * np.array([110, 110, 45]), octaves=3, seed=seed + 37) - 0.5)
    lenticel, _ = spots(rest * np.array([80, 80, 230]), density=0.45, seed=seed + 23)
    shape = 1.6 * (plates - 0.5) - 0.8 * np.clip(1.0 - crack / 0.06, 0, 1) + 0.5 * lenticel
    depth = np.minimum(RELIEF * (radius - SMOOTH_M), RELIEF_M)
    height[old] = material["relief"] * depth * np.clip(shape, -1, 1)
    return height


def _painted(color, rest, s, material):
    """White paint against frost on the stem's foot, worn off here and there, its rim uneven."""
    wear = fbm(rest * 22, octaves=4, gain=0.65, seed=material["seed"] + 71)
    rim = material["paint_m"] + 0.04 * (fbm(rest * 30, octaves=2, seed=material["seed"] + 73) - 0.5)
    cover = np.clip((0.68 - wear) / 0.12, 0, 1) * np.clip((rim - s) / 0.006, 0, 1)
    return mix(color, np.array([0.66, 0.65, 0.62]) * (0.75 + 0.4 * wear)[:, None], 0.92 * cover)


def wood_color(rest, seed, base=(0.36, 0.29, 0.20)):
    """Albedo of a weathered wooden post: streaks along it, knots, dirt."""
    streak = fbm(rest * np.array([90, 90, 6]), octaves=4, gain=0.6, seed=seed)
    dirt = fbm(rest * 12, octaves=5, gain=0.7, seed=seed + 7)
    knots, _ = spots(rest * np.array([9, 9, 6]), density=0.3, seed=seed + 17)
    tone = (0.45 + 0.75 * streak) * (0.55 + 0.9 * dirt) * (1.0 - 0.6 * knots)
    return np.clip(np.asarray(base) * tone[:, None], 0.01, 0.8)


def image_color(image, uv):
    """Nearest texel of an image (H, W, 3) linear at uv (N, 2); v runs up; outside is clamped."""
    height, width = image.shape[:2]
    column = np.clip((uv[:, 0] * width).astype(int), 0, width - 1)
    row = np.clip(((1.0 - uv[:, 1]) * height).astype(int), 0, height - 1)
    return image[row, column]


def surface_color(material, attributes, n):
    """Albedo (n, 3) of points on an object from its material and interpolated attributes."""
    kind = material["kind"]
    if kind == "bark":
        color = bark_color(attributes["rest"], attributes["radius"], material["seed"])
        if material.get("paint_m", 0.0) > 0:
            on_stem = (attributes["axis"] == 0) & (attributes["s"] < material["paint_m"] + 0.02)
            color[on_stem] = _painted(
                color[on_stem], attributes["rest"][on_stem], attributes["s"][on_stem], material
            )
        return color
    if kind == "wood":
        return wood_color(attributes["rest"], material["seed"], material["color"])
    if kind == "image":
        return image_color(material["image"], attributes["uv"])
    if kind == "leaves":
        dark, light = np.asarray(material["dark"]), np.asarray(material["light"])
        tint = attributes["tint"][:, None]
        return np.where(tint < 0, material["core"], dark + tint * (light - dark))
    if kind == "plain":
        dirt = fbm(attributes["rest"] * 20, octaves=4, gain=0.65, seed=material["seed"])
        return np.asarray(material["color"]) * np.ones((n, 1)) * (0.72 + 0.5 * dirt)[:, None]
    raise ValueError(f"unknown material kind {kind!r}")
