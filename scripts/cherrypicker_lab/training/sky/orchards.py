"""Bare orchard rows, drawn as what stands before the sky.

Street and holiday photos show no crown through which one looks: a winter orchard is mostly sky,
seen between twigs down to the horizon, with rows, wires, hedges and hills below. They are drawn in
perspective over a sky, so that every gap has an exact label. Lengths in metres, images in pixels;
the camera stands at eye height and looks along the ground.
"""

from __future__ import annotations

import cv2
import numpy as np

from cherrypicker_lab.training.sky.synthesis import (
    bark_colors,
    draw_wood,
    fractal_noise,
    grow,
    random_luminance,
)

#: Ranges drawn from evenly; guesses of what a phone sees in an orchard.
CAMERA_HEIGHT_M = (0.8, 2.0)
TREE_HEIGHT_M = (2.0, 5.0)
TREE_SPACING_M = (1.0, 4.5)
ROW_SPACING_M = (3.0, 5.5)
DISTANCE_M = (1.5, 5.0)
#: Focal length, shares of the longer side of a photo of which the sample shows a part.
FOCAL = (0.8, 2.6)
#: Where the horizon lies, shares of the sample's height from above.
HORIZON = (0.1, 1.4)
N_ROWS, N_TREES = 3, 7
#: Branches of the nearest trees; those farther off have as many as their share of the height.
N_BRANCHES = 450
#: Side shoots of a fruit tree for each that a drawn branch has; guess.
SHOOTS = 1.8
#: White and coloured boards (markers, signs, tags) and the light on them; houses behind the rows.
BOARD_SIDE_M, BOARD_LIGHT = (0.08, 0.7), (0.25, 1.1)
N_BOARDS, N_HOUSES = 5, 3
#: The thinnest twig, and the haze that a hundred metres put before what is behind them.
TWIG_RADIUS_M = 0.0012
HAZE = 0.5


def _over(image, cover, colors, alpha):
    """Put a layer over an image and over the cover of what stands before the sky."""
    alpha = np.clip(alpha, 0, 1)
    image[:] = image * (1 - alpha[..., None]) + colors * alpha[..., None]
    cover[:] = 1 - (1 - cover) * (1 - alpha)


def _ground_colors(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Grass, straw, soil or snow with patches and grain."""
    colors = np.array(
        [[0.25, 0.35, 0.12], [0.5, 0.45, 0.25], [0.33, 0.25, 0.18], [0.85, 0.87, 0.9]]
    )
    first, second = colors[rng.choice(4, 2, p=[0.45, 0.25, 0.25, 0.05])]
    mix = fractal_noise(rng, shape, 5)[..., None]
    grain = 1 + rng.uniform(0.1, 0.6) * (rng.random(shape, dtype=np.float32)[..., None] - 0.5)
    light = np.exp(rng.normal(-0.3, 0.35))
    return np.clip((first * mix + second * (1 - mix)) * grain * light, 0, 1).astype(np.float32)


def _skyline(rng: np.random.Generator, shape, horizon: float, height: float, octaves: int):
    """Share of each pixel below a line that runs as noise up to a height above the horizon."""
    line = horizon - height * fractal_noise(rng, (4, shape[1]), octaves)[0]
    return np.clip(np.arange(shape[0])[:, None] - line[None] + 0.5, 0, 1).astype(np.float32)


def _far_things(rng: np.random.Generator, layers, horizon: float) -> None:
    """Hills and hedges behind the rows; a hedge is full of holes along its upper edge."""
    image, cover = layers
    shape = cover.shape
    if rng.random() < 0.6:
        below = _skyline(rng, shape, horizon, rng.uniform(0.02, 0.3) * shape[0], 3)
        tone = np.exp(rng.uniform(np.log(0.1), np.log(0.5)))
        tint = tone * np.array([1, 1 + rng.uniform(-0.05, 0.1), 1 + rng.uniform(-0.2, 0.3)])
        texture = 1 + 0.5 * (fractal_noise(rng, shape, 6)[..., None] - 0.5)
        _over(image, cover, np.clip(tint * texture, 0, 1), below)
    if rng.random() < 0.6:
        height = rng.uniform(0.03, 0.3) * shape[0]
        fine, rough = fractal_noise(rng, shape, 8), rng.random(shape, dtype=np.float32)
        line = horizon - height * (0.5 + 0.5 * fractal_noise(rng, (4, shape[1]), 6)[0])
        depth = (np.arange(shape[0])[:, None] - line[None]) / max(height, 1)
        holes = fine + 0.5 * rough < rng.uniform(0.4, 0.9) * np.clip(1 - 2 * depth, 0, 1)
        leaf = np.array([0.8, 1.0, 0.5]) if rng.random() < 0.6 else np.array([1.0, 0.85, 0.7])
        tone = np.exp(rng.uniform(np.log(0.05), np.log(0.4))) * leaf
        _over(image, cover, np.clip(tone * (0.5 + rough[..., None]), 0, 1), (depth > 0) & ~holes)


def _house(rng: np.random.Generator, layers, horizon: float) -> None:
    """Put a wall of any colour with its windows on the horizon, as pale as a cloud at times."""
    image, cover = layers
    height, width = cover.shape
    wall, tall = rng.uniform(0.1, 0.8) * width, rng.uniform(0.05, 0.4) * height
    left, top = rng.uniform(-0.3, 1.0) * width, horizon - tall
    shape = np.zeros(cover.shape, np.float32)
    corners = [(left, horizon), (left, top), (left + wall / 2, top - rng.uniform(0, 0.4) * tall)]
    corners += [(left + wall, top), (left + wall, horizon)]
    cv2.fillPoly(shape, [np.rint(corners).astype(np.int32)], 1.0, cv2.LINE_AA)
    tone = rng.uniform(0.15, 1.0) * (1 + rng.normal(0, 0.06, 3))
    colors = np.tile(tone.astype(np.float32), (height, width, 1))
    for x in np.arange(left, left + wall, max(0.25 * tall, 3.0))[1:]:
        low, high = (round(x), round(top + 0.3 * tall)), (round(x + 0.1 * tall), round(horizon))
        cv2.rectangle(colors, low, high, (rng.uniform(0.02, 0.3),) * 3, -1)
    _over(image, cover, colors, shape)


def _board(rng: np.random.Generator, layers, foot, scale: float) -> None:
    """Stand a board on its post: white or coloured, blank or with a pattern, seen from anywhere."""
    image, cover = layers
    side = rng.uniform(*BOARD_SIDE_M) * scale
    cells = int(rng.integers(3, 9))
    light = rng.uniform(*BOARD_LIGHT)
    ground = light * (1 + (rng.normal(0, 0.3, 3) if rng.random() < 0.3 else rng.normal(0, 0.03, 3)))
    pattern = np.ones((cells + 2, cells + 2, 1), np.float32)
    if rng.random() < 0.7:
        pattern[1:-1, 1:-1, 0] = rng.random((cells, cells)) < 0.5
    texture = np.clip(pattern * ground + (1 - pattern) * 0.05 * light, 0, 1).astype(np.float32)
    center = np.array(foot) - (0, rng.uniform(0.3, 1.0) * side + rng.uniform(0, 0.8) * scale)
    turn, squeeze = rng.normal(0, 0.5), rng.uniform(0.2, 1.0)
    spin = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (0.5 * side) * (squeeze, 1.0)
    corners = square @ spin.T + center + rng.normal(0, 0.04 * side, (4, 2))
    size = cells + 2
    source = np.array([[0, 0], [size, 0], [size, size], [0, size]], np.float32) - 0.5
    way = cv2.getPerspectiveTransform(source, corners.astype(np.float32))
    target = (cover.shape[1], cover.shape[0])
    colors = cv2.warpPerspective(texture, way, target, flags=cv2.INTER_NEAREST)
    alpha = np.zeros(cover.shape, np.float32)
    post = np.rint([center, foot]).astype(int).tolist()
    cv2.line(alpha, *post, 1.0, max(1, round(0.04 * scale)), cv2.LINE_AA)
    _over(image, cover, np.full(3, rng.uniform(0.05, 0.5), np.float32), alpha)
    alpha[:] = 0
    cv2.fillPoly(alpha, [np.rint(corners).astype(np.int32)], 1.0, cv2.LINE_AA)
    _over(image, cover, colors, alpha)


def _tree_places(rng: np.random.Generator) -> np.ndarray:
    """Feet of trees in rows, (n, 2): sideways and forwards, far ones first.

    The tree that is photographed stands before the camera, the rows run through it and beside it.
    """
    heading = rng.uniform(0, np.pi)
    along = np.array([np.cos(heading), np.sin(heading)])
    across = np.array([-along[1], along[0]])
    distance = rng.uniform(*DISTANCE_M)
    target = distance * np.array([rng.uniform(-0.5, 0.5), 1.0])
    rows = rng.uniform(*ROW_SPACING_M) * (np.arange(N_ROWS) - N_ROWS // 2)
    trees = rng.uniform(*TREE_SPACING_M) * (np.arange(N_TREES) - N_TREES // 2)
    feet = target + rows[:, None, None] * across + trees[None, :, None] * along
    feet = feet.reshape(-1, 2) + rng.normal(0, 0.1, (N_ROWS * N_TREES, 2))
    feet = feet[feet[:, 1] > DISTANCE_M[0] / 2]
    return feet[np.argsort(-feet[:, 1])]


def _tree(
    rng: np.random.Generator, shape: tuple[int, int], foot: tuple[float, float], scale: float
) -> tuple[np.ndarray, np.ndarray]:
    """Draw one bare tree; return how far it covers each pixel and how it is lit, (H, W) each."""
    height = rng.uniform(*TREE_HEIGHT_M) * scale
    radius = rng.uniform(0.012, 0.035) * height / 2
    limit = int(np.clip(N_BRANCHES * height / shape[0], 12, N_BRANCHES))
    heading = -np.pi / 2 + rng.normal(0, 0.08)
    length = rng.uniform(0.5, 1.0) * height
    lines = grow(rng, height, foot, heading, radius, length, limit, TWIG_RADIUS_M * scale, SHOOTS)
    return draw_wood(rng, lines, shape)


def random_orchard(rng: np.random.Generator, sky: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Draw bare rows of trees, what lies behind them and the ground before a sky.

    The sky and the image are (H, W, 3) float32 in [0, 1], RGB; the cover (H, W) float32 is the
    fraction of each pixel that hides the sky.
    """
    height, width = shape = sky.shape[:2]
    image, cover = sky.astype(np.float32).copy(), np.zeros(shape, np.float32)
    horizon = rng.uniform(*HORIZON) * height
    focal = rng.uniform(*FOCAL) * max(shape)
    eye = rng.uniform(*CAMERA_HEIGHT_M)
    layers = image, cover
    _far_things(rng, layers, horizon)
    for _ in range(rng.integers(0, N_HOUSES)):
        _house(rng, layers, horizon)
    _over(image, cover, _ground_colors(rng, shape), _skyline(rng, shape, horizon, 3.0, 5))
    noise, luminance = fractal_noise(rng, shape, 7), random_luminance(rng)
    haze, softness = image[: max(1, height // 4)].mean(axis=(0, 1)), rng.uniform(0.2, 0.8)
    trees = _tree_places(rng)
    boards = np.column_stack([rng.uniform(-2, 2, N_BOARDS), rng.uniform(1.0, 8.0, N_BOARDS)])
    boards = boards[: rng.integers(0, N_BOARDS + 1)]
    places = np.vstack([trees, boards])
    for k in np.argsort(-places[:, 1]):
        sideways, forwards = places[k]
        scale = focal / forwards
        foot = (width / 2 + scale * sideways, horizon + scale * eye)
        reach = 0.7 * scale * TREE_HEIGHT_M[1]
        if not -reach < foot[0] < width + reach:
            continue
        if k >= len(trees):
            _board(rng, layers, foot, scale)
            continue
        wood, lit = _tree(rng, shape, foot, scale)
        colors = bark_colors(rng, lit, noise, luminance * np.exp(rng.normal(0, 0.15)))
        veil = HAZE * min(1.0, forwards / 100)
        soft = cv2.GaussianBlur(wood, (0, 0), softness)
        _over(image, cover, colors * (1 - veil) + haze * veil, soft)
    for _ in range(rng.integers(0, 4)):  # wires of a trellis
        line = np.zeros(shape, np.float32)
        left, right = (rng.uniform(0, 1.0, 2) * horizon).tolist()
        cv2.line(
            line, (0, round(left)), (width, round(right)), rng.uniform(0.2, 1.0), 1, cv2.LINE_AA
        )
        _over(image, cover, np.full(3, rng.uniform(0.1, 0.6), np.float32), line)
    return image, cover
