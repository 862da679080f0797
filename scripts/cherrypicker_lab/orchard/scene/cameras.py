"""Where the photographer stands: rings of cameras around the target tree."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.poses import Poses

FULL_FRAME_DIAGONAL_MM = 43.27
CLEARANCE_M = 0.4


@dataclass(frozen=True)
class CameraModel:
    """A camera; `sensor_diagonal_mm` only sets the focal length that EXIF names.

    `k1` and `k2` are its lens's radial distortion (COLMAP's RADIAL model); 0: a pinhole.
    """

    width: int = 800
    height: int = 1200
    focal_px: float = 1050.0
    make: str = "Cherry"
    model: str = "Orchard One"
    sensor_diagonal_mm: float = 9.5
    k1: float = 0.0
    k2: float = 0.0

    @property
    def K(self):
        """Intrinsics (3, 3), px, pixel centres at (0.5, 0.5)."""
        return np.array(
            [[self.focal_px, 0, self.width / 2], [0, self.focal_px, self.height / 2], [0, 0, 1]]
        )

    @property
    def focal_mm(self):
        """Focal length on the camera's own sensor, mm."""
        return self.focal_px / np.hypot(self.width, self.height) * self.sensor_diagonal_mm

    @property
    def focal_35mm(self):
        """Equivalent focal length on full frame by the diagonals, mm."""
        return self.focal_px / np.hypot(self.width, self.height) * FULL_FRAME_DIAGONAL_MM

    def resized(self, width, height):
        """The camera with another number of pixels and the same field of view (by the diagonal)."""
        factor = np.hypot(width, height) / np.hypot(self.width, self.height)
        return replace(self, width=width, height=height, focal_px=self.focal_px * factor)

    def widened(self, factor):
        """A pinhole of the same focal length and a frame that is larger by a factor."""
        width, height = round(self.width * factor), round(self.height * factor)
        return replace(self, width=width, height=height, k1=0.0, k2=0.0)


@dataclass(frozen=True)
class Ring:
    """`n` cameras at a height, at `radius` from the stem, aimed at `aim` above its foot (m)."""

    n: int
    height: float
    radius: float
    aim: float
    phase: float = 0.0


def look_at(center, target, roll=0.0):
    """Pose (3, 4) cam from world (x right, y down, z forward) of a camera that looks at a point."""
    forward = np.asarray(target, float) - center
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = np.cos(roll), np.sin(roll)
    rotation = np.stack([c * right + s * down, c * down - s * right, forward])
    return np.column_stack([rotation, -rotation @ center])


def default_rings(scene, camera, n_photos):
    """Three rings around a scene's target, as far off as the tree needs to be in frame.

    Trees of about 2.2 m get the rings of the demo; `n_photos` are shared out 5 : 5 : 2.
    """
    height = max(scene.target.height, 0.8)
    fit = 0.62 * height * camera.focal_px / (0.5 * min(camera.width, camera.height) * 1.2)
    radius = float(np.clip(max(1.15 * height, fit), 1.4, 8.0))
    n = [max(round(n_photos * share), 2) for share in (5 / 12, 5 / 12)]
    n.append(max(n_photos - sum(n), 1))
    return [
        Ring(n[0], min(0.5 * height, 1.7), radius, 0.5 * height),
        Ring(n[1], min(0.86 * height, 2.4), 0.97 * radius, 0.5 * height, 0.16),
        Ring(n[2], min(0.27 * height, 1.0), 0.97 * radius, 0.53 * height),
    ]


def _stand_clear(center, obstacles):
    """Step towards the stem until no wood of a neighbour is within reach of the lens."""
    for share in np.arange(1.0, 0.5, -0.05):
        moved = center * [share, share, 1.0]
        if obstacles is None or obstacles.query(moved)[0] > CLEARANCE_M:
            return moved
    return center


def numbered_poses(cam_from_world, camera):
    """Photos of one camera from their poses (3, 4), named IMG_0001.jpg and so on."""
    n = len(cam_from_world)
    names = np.array([f"IMG_{i + 1:04d}.jpg" for i in range(n)])
    sizes = np.full(n, camera.width), np.full(n, camera.height)
    return Poses(names, np.array(cam_from_world), np.repeat([camera.K], n, axis=0), *sizes)


def ring_poses(rings, camera, *, seed, ground=None, obstacles=None):
    """`Poses` of all photos, in shooting order, with a photographer's small irregularities.

    Heights count from `ground`, the level z (n,) at xy (n, 2), which is 0 everywhere by default. A
    camera that would stand in `obstacles`, (n, 3), m, the wood of the neighbours, steps towards the
    stem.
    """
    rng = np.random.default_rng([int(seed), 61])
    wood = None if obstacles is None or len(obstacles) == 0 else cKDTree(obstacles)
    poses = []
    for ring in rings:
        for i in range(ring.n):
            azimuth = ring.phase + 2 * np.pi * i / ring.n + np.radians(rng.normal() * 1.2)
            radius = ring.radius + rng.normal() * 0.05
            xy = radius * np.array([np.cos(azimuth), np.sin(azimuth)])
            level = 0.0 if ground is None else ground(xy[None])[0]
            center = np.array([*xy, level + ring.height + rng.normal() * 0.03])
            center = _stand_clear(center, wood)
            target = np.array([0.0, 0.0, ring.aim]) + rng.normal(size=3) * 0.03
            poses.append(look_at(center, target, np.radians(rng.normal() * 1.2)))
    return numbered_poses(poses, camera)


def close_up_poses(scene, camera, n_photos, *, distance):
    """`Poses` of a ring of photos that look closely at the buds of the upper third of a target.

    The photographer stands `distance` m from these, at two heights of a lens by turns, and below
    them, so that the sky is behind.
    """
    rng = np.random.default_rng([scene.seed, 62])
    buds = scene.target.buds.points
    middle = buds[buds[:, 2] > 0.62 * scene.target.height].mean(axis=0)
    poses = []
    for i in range(n_photos):
        azimuth = 2 * np.pi * i / n_photos + rng.normal() * 0.02
        around = distance * np.array([np.cos(azimuth), np.sin(azimuth)])
        center = np.array(
            [*middle[:2] + around, middle[2] - (0.4, 0.8)[i % 2] + rng.normal() * 0.03]
        )
        target = middle + rng.normal(size=3) * 0.03
        poses.append(look_at(center, target, np.radians(rng.normal() * 1.2)))
    return numbered_poses(poses, camera)
