"""Walls, sheds and barns near a scan: panels with images of brick, planks, plaster and tiles."""

import numpy as np

from cherrypicker.classes import Label
from cherrypicker_lab.orchard.scene.mesh import Mesh, SceneObject, join
from cherrypicker_lab.orchard.scene.noise import fbm

TEXEL_M = 0.006  # 0.8 px of a photo at 6 m with 800 px of focal length
BRICK_M = (0.24, 0.071)
JOINT_M = 0.011
PLANK_M = 0.14
TILE_M = (0.20, 0.28)


def _grid(width, height):
    """Places (h * w, 3) of the texels of a panel, top row first, and the image's shape."""
    columns, rows = int(np.ceil(width / TEXEL_M)), int(np.ceil(height / TEXEL_M))
    x, y = np.meshgrid((np.arange(columns) + 0.5) * TEXEL_M,
                       height - (np.arange(rows) + 0.5) * TEXEL_M)  # fmt: skip
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]), (rows, columns, 3)


def _by_cell(i, j, rng):
    """A random number in [0, 1) for each cell (i, j) of a wall."""
    table = rng.random((256, 256))
    return table[i.astype(int) % 256, j.astype(int) % 256]


def _weather(p, seed):
    """Dirt, runs of water and the darker foot of a wall, as a factor (n,)."""
    dirt = fbm(p * 1.3, octaves=5, gain=0.7, seed=seed + 1)
    runs = fbm(p * np.array([14.0, 0.8, 1.0]), octaves=3, gain=0.7, seed=seed + 2)
    foot = np.clip(p[:, 1] / 0.5, 0.0, 1.0)
    return (0.55 + 0.7 * dirt) * (0.75 + 0.5 * runs) * (0.7 + 0.3 * foot)


def brick_image(rng, width, height, seed):
    """Bricks in stretcher bond, with plaster left on parts of them; linear albedo."""
    p, shape = _grid(width, height)
    course = np.floor(p[:, 1] / BRICK_M[1])
    x = p[:, 0] / BRICK_M[0] + 0.5 * (course % 2)
    tone = _by_cell(course, np.floor(x), rng)[:, None]
    grain = fbm(p * 110, octaves=3, gain=0.8, seed=seed + 3)[:, None]
    brick = np.array([0.16, 0.065, 0.045]) + tone * np.array([0.26, 0.10, 0.06])
    is_joint = (x % 1 * BRICK_M[0] < JOINT_M) | (p[:, 1] % BRICK_M[1] < JOINT_M)
    color = np.where(is_joint[:, None], [0.34, 0.32, 0.29], brick) * (0.5 + grain)
    patch = fbm(p * 0.9 + 7.0, octaves=4, gain=0.6, seed=seed + 4)
    plaster = np.array([0.50, 0.49, 0.45]) * (0.6 + 0.7 * grain)
    share = np.clip((patch - 0.58) / 0.02, 0, 1)[:, None]
    color = (color * (1 - share) + plaster * share) * _weather(p, seed)[:, None]
    return np.clip(color, 0.01, 0.8).reshape(shape)


def plank_image(rng, width, height, seed):
    """Upright weathered planks; linear albedo."""
    p, shape = _grid(width, height)
    x = p[:, 0] / PLANK_M
    tone = _by_cell(np.floor(x), np.zeros_like(x), rng)[:, None]
    grain = fbm(p * np.array([130.0, 6.0, 1.0]), octaves=4, gain=0.75, seed=seed + 5)[:, None]
    wood = np.array([0.13, 0.095, 0.065]) + tone * np.array([0.17, 0.13, 0.095])
    gap = np.where((x % 1 < 0.07)[:, None], 0.12, 1.0)
    color = wood * (0.35 + 1.2 * grain) * gap * _weather(p, seed)[:, None]
    return np.clip(color, 0.01, 0.8).reshape(shape)


def plaster_image(rng, width, height, seed):
    """A plastered wall with windows and stains; linear albedo."""
    p, shape = _grid(width, height)
    base = np.array([[0.52, 0.48, 0.38], [0.50, 0.50, 0.48], [0.46, 0.37, 0.27]])[rng.integers(3)]
    grain = fbm(p * 60, octaves=4, gain=0.8, seed=seed + 6)[:, None]
    color = base * (0.6 + 0.8 * grain) * _weather(p, seed)[:, None]
    for left in np.arange(0.9, width - 1.4, 2.1):
        x, y = p[:, 0] - left, p[:, 1] - 1.0
        is_frame = (np.abs(x - 0.5) < 0.56) & (np.abs(y - 0.6) < 0.68)
        is_pane = (np.abs((x * 2) % 1 - 0.5) < 0.44) & (np.abs(y - 0.6) < 0.58)
        is_pane &= (x > 0) & (x < 1)
        color[is_frame] = [0.42, 0.40, 0.36]
        glass = 0.03 + 0.08 * fbm(p[is_pane] * 2.0, octaves=2, seed=seed + 7)
        color[is_pane] = glass[:, None] * [0.9, 1.0, 1.1]
    return np.clip(color, 0.01, 0.8).reshape(shape)


def tile_image(rng, width, height, seed):
    """Rows of roof tiles with moss; linear albedo."""
    p, shape = _grid(width, height)
    row = np.floor(p[:, 1] / TILE_M[1])
    x = p[:, 0] / TILE_M[0] + 0.5 * (row % 2)
    tone = _by_cell(row, np.floor(x), rng)[:, None]
    tile = np.array([0.15, 0.065, 0.045]) + tone * np.array([0.17, 0.075, 0.05])
    round_top = 0.55 + 0.45 * np.sin(np.pi * (x % 1))
    shade = np.clip((p[:, 1] % TILE_M[1]) / 0.05, 0.25, 1.0)
    grain = fbm(p * 70, octaves=3, gain=0.8, seed=seed + 8)
    color = tile * (round_top * shade * (0.5 + grain))[:, None]
    moss = np.clip((fbm(p * 2.5, octaves=4, gain=0.7, seed=seed + 9) - 0.55) / 0.1, 0, 1)[:, None]
    color = color * (1 - 0.7 * moss) + 0.7 * moss * np.array([0.09, 0.11, 0.04])
    return np.clip(color, 0.01, 0.8).reshape(shape)


def _panel(corners, uv):
    """A convex flat polygon (k, 3) with texture coordinates (k, 2)."""
    corners, k = np.asarray(corners, float), len(corners)
    faces = np.array([[0, i, i + 1] for i in range(1, k - 1)], np.int32)
    return Mesh(corners, faces, {"uv": np.asarray(uv, float), "rest": corners.copy()})


def _thing(name, panels, image, place):
    """Panels in a building's own frame (x along, y back, z up), put into the scene."""
    offset, turn = place
    mesh = join(panels).moved(offset, turn)
    material = {"kind": "image", "image": image, "filter": "linear"}
    return SceneObject(name, int(Label.UNLABELLED), mesh, material)


def _place(foot, azimuth):
    """Offset and rotation of a building at a place whose front faces away from the azimuth."""
    c, s = np.cos(azimuth), np.sin(azimuth)
    return np.asarray(foot, float), np.array([[s, c, 0.0], [-c, s, 0.0], [0.0, 0.0, 1.0]])


def _walls(width, depth, front, ridge, back):
    """Four walls on a rectangle; the gables rise from `front` by way of `ridge` to `back` (m).

    They share one image of max(width, depth) by their greatest height.
    """
    x, span, tall = width / 2, max(width, depth), max(front, ridge, back)
    low = -0.3  # in the ground
    gable = [(0, low), (depth, low), (depth, back), (depth / 2, ridge), (0, front)]
    made = []
    for height, y, way in ((front, 0.0, 1), (back, depth, -1)):
        outline = [(-x, low), (x, low), (x, height), (-x, height)]
        made.append(_panel([(way * a, y, b) for a, b in outline],
                           [((a + x) / span, b / tall) for a, b in outline]))  # fmt: skip
    for side in (-x, x):
        made.append(_panel([(side, a, b) for a, b in gable],
                           [(a / span, b / tall) for a, b in gable]))  # fmt: skip
    return made, (span, tall)


def _roof(width, slopes):
    """Roof panels between pairs of (y, z), eaves first, sharing an image of the longest slope."""
    x = width / 2 + 0.25
    run = max(np.hypot(b[0] - a[0], b[1] - a[1]) for a, b in slopes)
    made = []
    for (y0, z0), (y1, z1) in slopes:
        rise = np.hypot(y1 - y0, z1 - z0) / run
        made.append(_panel([(-x, y0, z0), (x, y0, z0), (x, y1, z1), (-x, y1, z1)],
                           [(0, 0), (1, 0), (1, rise), (0, rise)]))  # fmt: skip
    return made, (2 * x, run)


def garden_wall(rng, foot, azimuth, seed, *, length=8.0, height=2.2):
    """A brick wall with coping, its middle at `foot` (m), facing away from the azimuth (rad)."""
    place = _place(foot, azimuth)
    panels, size = _walls(length, 0.3, height, height, height)
    top, x = height, length / 2
    coping = [(-x, -0.04, top), (x, -0.04, top), (x, 0.34, top), (-x, 0.34, top)]
    panels.append(_panel(coping, [(0, 0.9), (1, 0.9), (1, 1), (0, 1)]))
    return [_thing("wall", panels, brick_image(rng, *size, seed), place)]


def shed(rng, foot, azimuth, seed, *, width=4.0, depth=2.6, height=2.6):
    """A wooden shed with a roof that falls to the back, placed as `garden_wall`."""
    place, back = _place(foot, azimuth), 0.78 * height
    walls, size = _walls(width, depth, height, (height + back) / 2, back)
    fall = (height - back) / depth
    eaves, top = (depth + 0.3, back - 0.3 * fall + 0.03), (-0.35, height + 0.35 * fall + 0.03)
    roof, roof_size = _roof(width, [(eaves, top)])
    return [
        _thing("shed", walls, plank_image(rng, *size, seed), place),
        _thing("shed_roof", roof, plank_image(rng, *roof_size, seed + 50), place),
    ]


def barn(rng, foot, azimuth, seed, *, width=8.0, depth=6.0, height=2.8, ridge=4.8):
    """A plastered barn with a tiled gable roof, placed as `garden_wall`."""
    place = _place(foot, azimuth)
    walls, size = _walls(width, depth, height, ridge, height)
    fall = (ridge - height) / (depth / 2)
    low, high = height - 0.4 * fall + 0.04, (depth / 2, ridge + 0.04)
    roof, roof_size = _roof(width, [((-0.4, low), high), ((depth + 0.4, low), high)])
    return [
        _thing("barn", walls, plaster_image(rng, *size, seed), place),
        _thing("barn_roof", roof, tile_image(rng, *roof_size, seed + 60), place),
    ]
