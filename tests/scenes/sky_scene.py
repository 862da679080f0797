"""Photos of thin twigs and a painted stem before different skies, drawn with exact masks."""

from dataclasses import dataclass

import cv2
import numpy as np
from scan_scene import level_ring, look_at_poses

from cherrypicker.poses import Poses

BARK = (0.30, 0.24, 0.19)
PAINT = (0.93, 0.93, 0.91)
GROUND = np.array([0.33, 0.36, 0.25])
#: Colour at the horizon and further up, RGB.
SKIES = {
    "clear": ([0.66, 0.78, 0.93], [0.28, 0.47, 0.80]),
    "overcast": ([0.86, 0.88, 0.90], [0.93, 0.94, 0.96]),
    "low sun": ([0.98, 0.76, 0.45], [0.60, 0.62, 0.72]),
}
NOISE = 0.012


@dataclass(frozen=True)
class Rod:
    """A straight piece of wood, metres."""

    start: tuple
    end: tuple
    radius: float
    color: tuple

    def surface(self, n: int, rng: np.random.Generator, off: float = 0.0) -> np.ndarray:
        """Draw points on the surface, or this far off it."""
        start, axis = np.array(self.start), np.subtract(self.end, self.start)
        across = np.cross(axis, [0.577, 0.577, -0.577])
        across /= np.linalg.norm(across)
        third = np.cross(axis / np.linalg.norm(axis), across)
        angle = rng.uniform(0, 2 * np.pi, (n, 1))
        around = np.cos(angle) * across + np.sin(angle) * third
        return start + rng.uniform(0, 1, (n, 1)) * axis + (self.radius + off) * around


TWIG = Rod((0.10, 0.02, 1.02), (0.16, -0.03, 1.24), 0.0015, BARK)
STEM = Rod((0.0, 0.0, 0.70), (0.0, 0.0, 1.18), 0.03, PAINT)


def ring(n_views=12, distance=2.5, focal=1000.0, size=(480, 560)) -> Poses:
    """Level cameras 1 m up on a circle that look at the z axis: the horizon at half height."""
    poses = look_at_poses(level_ring(n_views, distance), [0, 0, 1.0], size=size, focal=focal)
    poses.names = np.array([f"{k}.jpg" for k in range(n_views)])
    return poses


def sky_at(sky: str, rows: np.ndarray, height: int) -> np.ndarray:
    """Sky colour, (n, 3), at the rows of a photo; ground below the horizon."""
    low, high = (np.array(color) for color in SKIES[sky])
    up = np.clip(1 - 2 * rows / height, 0, 1)[:, None]
    return np.where(rows[:, None] > height / 2, GROUND, low + up * (high - low))


def draw(poses: Poses, i: int, rods: tuple, sky: str) -> tuple[np.ndarray, np.ndarray]:
    """Draw photo ``i``, (H, W, 3) uint8, and its exact sky mask, (H, W) bool."""
    width, height = int(poses.width[i]), int(poses.height[i])
    rows, columns = np.mgrid[:height, :width] + 0.5
    image = np.repeat(sky_at(sky, np.arange(height) + 0.5, height)[:, None], width, axis=1)
    free = rows <= height / 2
    ends = [poses[i].project(np.array([rod.start, rod.end])) for rod in rods]
    for k in np.argsort([-depth.mean() for _, depth in ends]):
        (a, b), depth = ends[k]
        along = ((columns - a[0]) * (b - a)[0] + (rows - a[1]) * (b - a)[1]) / ((b - a) @ (b - a))
        along = np.clip(along, 0, 1)
        away = np.hypot(columns - a[0] - along * (b - a)[0], rows - a[1] - along * (b - a)[1])
        radius = rods[k].radius * poses.K[i, 0, 0] / depth.mean()
        cover = np.clip(radius + 0.5 - away, 0, min(1.0, 2 * radius))
        image = image + cover[..., None] * (np.array(rods[k].color) - image)
        free = free & (cover < 0.3)
    image = cv2.GaussianBlur(image, (3, 3), 0.5)
    image = image + np.random.default_rng(i).normal(0, NOISE, image.shape)
    return np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8), free


def without_twigs(mask: np.ndarray) -> np.ndarray:
    """Return a mask that lost all that is thin."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (9, 9))
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, disc) > 0
