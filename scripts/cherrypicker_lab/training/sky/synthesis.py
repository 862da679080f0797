"""Procedural skies and bare branches for training.

Public sky masks show crowns with leaves or draw a bare crown as one blob. Winter crowns with sky
between the twigs are what this pipeline photographs, so they are drawn: exact masks for free.
All colours are linear mixes in [0, 1], arrays float32.
"""

from __future__ import annotations

import cv2
import numpy as np


def fractal_noise(rng: np.random.Generator, shape: tuple[int, int], octaves: int) -> np.ndarray:
    """Return smooth noise of a shape (H, W), scaled to [0, 1]."""
    total = np.zeros(shape, np.float32)
    for octave in range(octaves):
        cells = 2 ** (octave + 1)
        grid = rng.random((cells + 1, cells + 1), dtype=np.float32)
        size = (shape[1], shape[0])
        total += cv2.resize(grid, size, interpolation=cv2.INTER_CUBIC) / 1.8**octave
    total -= total.min()
    return total / max(float(total.max()), 1e-6)


def random_sky(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """A sky, (H, W, 3) float32 in [0, 1]: clear, broken clouds, overcast, burnt out, or low sun."""
    height, width = shape
    zenith = np.array([0.12, 0.32, 0.68]) * rng.uniform(0.6, 1.4) + rng.normal(0, 0.04, 3)
    horizon = np.array([0.65, 0.78, 0.90]) * rng.uniform(0.75, 1.1) + rng.normal(0, 0.03, 3)
    kind = rng.choice(
        ["clear", "broken", "overcast", "white", "low"], p=[0.2, 0.25, 0.35, 0.1, 0.1]
    )
    if kind == "overcast":
        zenith = np.full(3, rng.uniform(0.2, 0.95)) + rng.normal(0, 0.02, 3)
        horizon = zenith + rng.uniform(-0.1, 0.15)
    elif kind == "white":
        zenith = np.full(3, rng.uniform(0.93, 1.05))
        horizon = zenith + rng.uniform(-0.03, 0.05)
    elif kind == "low":
        horizon = np.array([0.95, 0.75, 0.5]) + rng.normal(0, 0.08, 3)
    span = rng.uniform(0.4, 3.0)
    start = rng.uniform(0.0, 0.6)
    t = np.clip(start + np.linspace(0, 1, height) / span, 0, 1)[:, None]
    tilt = rng.uniform(-0.3, 0.3) * np.linspace(-0.5, 0.5, width)[None, :]
    t = np.clip(t + tilt, 0, 1)[..., None]
    sky = (1 - t) * zenith + t * horizon
    if kind in ("broken", "overcast"):
        noise = fractal_noise(rng, shape, 6)
        cover, soft = rng.uniform(0.3, 0.7), rng.uniform(0.08, 0.4)
        alpha = np.clip((noise - cover) / soft + 0.5, 0, 1)[..., None]
        if kind == "overcast":
            alpha = alpha * rng.uniform(0.1, 1.0)
        shade = rng.uniform(0.3, 1.05) + 0.3 * (fractal_noise(rng, shape, 4)[..., None] - 0.5)
        sky = (1 - alpha) * sky + alpha * shade
    return np.clip(sky, 0, 1).astype(np.float32)


def grow(
    rng: np.random.Generator,
    side: float,
    start: tuple[float, float],
    heading: float,
    radius: float,
    length: float,
    limit: int = 140,
    thinnest: float = 0.25,
    density: float = 1.0,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Grow one branch with its side shoots: points (n, 2) and radii (n,) of each, pixels.

    Lengths between shoots and bends are shares of `side`. The branch has its foot at `start`, where
    it has a heading (radians), a radius and a length. There are at most `limit` branches, none of a
    radius below `thinnest`; `density` is a factor on the number of side shoots. All lengths are in
    pixels.
    """
    lines = []
    stack = [(np.array(start, np.float64), heading, radius, length, 0)]
    while stack and len(lines) < limit:
        at, angle, thick, length, order = stack.pop()
        n = max(3, int(length / (0.025 * side)))
        angles = angle + np.cumsum(rng.normal(0, 0.10, n)) + rng.normal(0, 0.05, n)
        steps = length / n * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        points = np.vstack([at, at + np.cumsum(steps, axis=0)])
        radii = np.linspace(thick, max(0.35 * thick, thinnest), n + 1)
        lines.append((points, radii))
        if order >= 3:
            continue
        for k in rng.choice(
            n, size=min(n, rng.poisson(density * (2.0 + length / (0.10 * side)))), replace=False
        ):
            turn = rng.choice([-1, 1]) * rng.uniform(0.4, 1.3)
            child = radii[k] * rng.uniform(0.3, 0.75)
            part = length * rng.uniform(0.15, 0.6)
            stack.insert(0, (points[k], angles[k] + turn, max(child, thinnest), part, order + 1))
    return lines


def draw_wood(
    rng: np.random.Generator,
    lines: list[tuple[np.ndarray, np.ndarray]],
    shape: tuple[int, int],
) -> tuple[np.ndarray, np.ndarray]:
    """Draw branches, the thin ones first.

    Returns the fraction of each pixel covered by wood, and by wood that the light falls on, (H, W)
    float32 each.
    """
    height, width = shape
    zoom = 2
    canvas = np.zeros((height * zoom, width * zoom), np.uint8)
    lit = np.zeros_like(canvas)
    light = rng.normal(0, 1, 2)
    light /= np.linalg.norm(light) + 1e-6
    for points, radii in sorted(lines, key=lambda line: line[1][0]):
        ends = np.rint(points * zoom * 8).astype(np.int32)
        # A line thinner than a pixel covers a part of it.
        covers = np.rint(255 * np.minimum(1.0, 2 * radii * zoom)).tolist()
        thick = np.maximum(1, np.rint(2 * radii * zoom)).astype(int).tolist()
        if thick[0] == 1:
            cv2.polylines(canvas, [ends], False, covers[len(covers) // 2], 1, cv2.LINE_AA, 3)
            continue
        shifts = np.rint(0.5 * radii[:, None] * light * zoom * 8).astype(np.int32)
        for k, (p, q) in enumerate(zip(ends[:-1], ends[1:])):
            cv2.line(canvas, p.tolist(), q.tolist(), covers[k], thick[k], cv2.LINE_AA, 3)
            if thick[k] > 2:
                line = (p + shifts[k]).tolist(), (q + shifts[k]).tolist()
                cv2.line(lit, *line, 255, max(1, thick[k] // 2), cv2.LINE_AA, 3)
    size = (width, height)
    return tuple(
        cv2.resize(part, size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255
        for part in (canvas, lit)
    )


def random_luminance(rng: np.random.Generator) -> float:
    """Draw how bright bark is: from wood against the light to bleached wood in the sun."""
    return float(np.exp(rng.uniform(np.log(0.03), np.log(0.6))))


def bark_colors(
    rng: np.random.Generator, lit: np.ndarray, noise: np.ndarray, luminance: float
) -> np.ndarray:
    """Colour bark, lighter where it is lit, with ``noise`` as its texture; (H, W, 3), float32."""
    bark = luminance * np.array([1 + rng.uniform(-0.05, 0.3), 1.0, 1 - rng.uniform(-0.05, 0.3)])
    texture = 1 + rng.uniform(0, 0.7) * (noise - 0.5)
    shade = (1 + rng.uniform(0, 1.2) * lit) * texture
    return np.clip(shade[..., None] * bark, 0, 1).astype(np.float32)


def random_branches(rng: np.random.Generator, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Draw bare branches that enter the frame from its border.

    The image, given and returned with the branches before it, is (H, W, 3) float32 in [0, 1], RGB;
    the cover (H, W) float32 is the fraction of each pixel covered by wood.
    """
    height, width = shape = image.shape[:2]
    side = float(max(shape))
    lines = []
    for _ in range(rng.integers(1, 5)):
        edge = rng.integers(0, 4)
        along = rng.random()
        start = [
            (along * width, height),
            (0, along * height),
            (width, along * height),
            (along * width, 0),
        ]
        inward = [-np.pi / 2, 0.0, np.pi, np.pi / 2][edge]
        heading = inward + rng.normal(0, 0.45)
        radius = side * np.exp(rng.uniform(np.log(0.002), np.log(0.04)))
        lines += grow(rng, side, start[edge], heading, radius, rng.uniform(0.35, 1.0) * side)
    cover, lit = draw_wood(rng, lines, shape)
    cover = cv2.GaussianBlur(cover, (0, 0), rng.uniform(0.2, 0.8))
    bark = bark_colors(rng, lit, fractal_noise(rng, shape, 7), random_luminance(rng))
    return image * (1 - cover[..., None]) + bark * cover[..., None], cover
