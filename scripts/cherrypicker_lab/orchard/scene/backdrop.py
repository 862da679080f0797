"""What stands at infinity: sky with clouds, hills, a winter treeline and some buildings."""

import numpy as np

from cherrypicker_lab.orchard.scene.appearance import mix
from cherrypicker_lab.orchard.scene.noise import fbm

# zenith, horizon, cloud light, cloud dark, cloud threshold
SKY_COLORS = {
    "clear": (
        (0.13, 0.29, 0.66), (0.52, 0.66, 0.85), (0.95, 0.95, 0.95), (0.62, 0.66, 0.74), 0.60,
    ),
    "broken": (
        (0.17, 0.33, 0.64), (0.58, 0.69, 0.83), (0.95, 0.95, 0.96), (0.45, 0.48, 0.55), 0.46,
    ),
    "overcast": (
        (0.62, 0.66, 0.71), (0.80, 0.82, 0.84), (0.90, 0.91, 0.93), (0.50, 0.53, 0.58), 0.35,
    ),
    "low": (
        (0.20, 0.32, 0.58), (0.88, 0.66, 0.46), (0.96, 0.84, 0.70), (0.52, 0.46, 0.48), 0.50,
    ),
}  # fmt: skip


def _sky(d, kind, seed):
    zenith, horizon, light, dark, threshold = (np.asarray(v) for v in SKY_COLORS[kind])
    up = np.clip(d[:, 2], 0, 1)
    color = mix(horizon, zenith, np.sqrt(up))
    # clouds lie on a plane overhead and so shrink towards the horizon
    plane = np.column_stack([d[:, :2] / (up + 0.22)[:, None], np.zeros(len(d))])
    thick = fbm(plane * 1.6 + 40.0, octaves=6, gain=0.6, seed=seed)
    lit = fbm(plane * 2.4 + 90.0, octaves=4, gain=0.6, seed=seed + 9)
    cover = np.clip((thick - threshold) / 0.14, 0, 1) * np.clip(up / 0.06, 0.25, 1)
    return mix(color, mix(dark, light, np.clip(1.6 * lit - 0.25, 0, 1)), cover)


def _buildings(rng, azimuth, elevation):
    """Colour and cover of a handful of houses at the horizon."""
    color, cover = np.zeros((len(azimuth), 3)), np.zeros(len(azimuth), bool)
    for _ in range(7):
        middle, width = rng.uniform(-np.pi, np.pi), np.radians(rng.uniform(2.5, 7.0))
        wall, roof = np.radians(rng.uniform(1.5, 3.6)), np.radians(rng.uniform(0.8, 2.2))
        paint = np.array([[0.62, 0.58, 0.50], [0.45, 0.23, 0.16], [0.52, 0.53, 0.55]])
        paint = paint[rng.integers(3)] * rng.uniform(0.7, 1.1)
        tiles = np.array([0.22, 0.08, 0.05]) * rng.uniform(0.6, 1.6)
        n_windows = int(rng.integers(3, 7))
        x = np.angle(np.exp(1j * (azimuth - middle))) / width + 0.5
        z = elevation / wall
        on_wall = (x > 0) & (x < 1) & (z > -1) & (z < 1)
        pane = (np.abs((x * n_windows) % 1 - 0.5) < 0.22) & (np.abs((z * 2) % 1 - 0.5) < 0.28)
        shade = np.where(pane & (z > 0), 0.18, 1.0)
        on_roof = (elevation >= wall) & (
            elevation < wall + roof * np.clip(1.15 - np.abs(2 * x - 1), 0, 1)
        )
        color[on_wall] = (paint * shade[:, None])[on_wall]
        color[on_roof] = tiles
        cover |= on_wall | on_roof
    return color, cover


def backdrop(directions, sky, seed):
    """Linear RGB (N, 3) of what lies at infinity, and where it is sky, (N,) bool.

    The directions (N, 3) are unit and z up; the sky is a key of `SKY_COLORS`, the seed the scene's.
    """
    rng = np.random.default_rng([int(seed), 71])
    s = int(rng.integers(1 << 30))
    elevation = np.arcsin(np.clip(directions[:, 2], -1, 1))
    radiance = np.empty_like(directions)
    near = elevation < np.radians(16)
    far = directions[near]
    radiance[~near] = _sky(directions[~near], sky, s)
    is_sky = np.ones(len(directions), bool)

    # noise over a cylinder has no seam in azimuth
    azimuth, e = np.arctan2(far[:, 1], far[:, 0]), elevation[near]
    wall = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.tan(e) + 3.0])
    flat = np.column_stack([wall[:, :2], np.full(len(far), 3.0)])
    color, covered = _sky(far, sky, s), np.zeros(len(far), bool)
    bright = 0.75 if sky == "overcast" else 1.0

    hill = np.radians(1.2) + np.radians(4.5) * fbm(flat * 1.6, octaves=4, seed=s + 21)
    on = e < hill
    tone = 0.6 + 0.8 * fbm(wall[on] * 45, octaves=4, gain=0.7, seed=s + 25)
    color[on], covered[on] = np.array([0.24, 0.29, 0.33]) * tone[:, None] * bright, True

    houses, on = _buildings(rng, azimuth, e)
    grain = 0.75 + 0.5 * fbm(wall[on] * 160, octaves=3, gain=0.7, seed=s + 27)
    color[on], covered[on] = houses[on] * grain[:, None] * bright, True

    crown = fbm(flat * 7, octaves=4, gain=0.6, seed=s + 31) - 0.40
    top = np.radians(1.0) + np.radians(16.0) * np.clip(crown, 0, 1)
    density = (top - e) / np.radians(2.2) + 1.5 * (
        fbm(wall * 130, octaves=3, gain=0.8, seed=s + 35) - 0.5
    )
    on = density > 0
    streak = fbm(wall[on] * np.array([150, 150, 40]), octaves=4, gain=0.75, seed=s + 39)
    mood = fbm(flat[on] * 5, octaves=2, seed=s + 43)
    wood = mix(np.array([0.20, 0.155, 0.115]), np.array([0.13, 0.165, 0.07]), mood)
    color[on], covered[on] = wood * (0.15 + 1.6 * streak)[:, None] * bright, True

    on = e < np.radians(0.3)
    tone = 0.3 + 1.3 * fbm(wall[on] * np.array([60, 60, 500]), octaves=4, gain=0.7, seed=s + 47)
    color[on], covered[on] = np.array([0.17, 0.20, 0.09]) * tone[:, None] * bright, True

    radiance[near], is_sky[near] = color, ~covered
    return radiance, is_sky
