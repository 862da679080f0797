"""Synthetic photo scans with known truth, in an arbitrary frame, for the geometry tests."""

import numpy as np

from cherrypicker.poses import Poses


def rotation_about(axis, degrees):
    """Rotation matrix about an axis."""
    axis = np.asarray(axis, float) / np.linalg.norm(axis)
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    angle = np.radians(degrees)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def look_at_poses(centers, targets, *, roll_deg=0.0, turns=0, size=(1200, 800), focal=1000.0):
    """Upright cameras (z up) at `centers` that look at `targets`, rolled and stored sideways."""
    n = len(centers)
    rolls = np.broadcast_to(roll_deg, n)
    quarter = np.broadcast_to(turns, n)
    matrices = []
    for center, target, roll, turn in zip(
        centers, np.broadcast_to(targets, (n, 3)), rolls, quarter
    ):
        forward = (target - center) / np.linalg.norm(target - center)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        cam = np.stack([right, np.cross(forward, right), forward])
        # Turn 1 is EXIF 6: the scene's up is the stored image's left.
        stored = {0: 0.0, 1: -90.0, 2: 180.0, 3: 90.0}[int(turn)]
        cam = rotation_about([0, 0, 1], stored + roll) @ cam
        matrices.append(np.column_stack([cam, -cam @ center]))
    K = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1.0]])
    return Poses(
        [f"photo_{i:03d}.jpg" for i in range(n)],
        np.array(matrices),
        np.repeat(K[None], n, axis=0),
        np.full(n, size[0]),
        np.full(n, size[1]),
    )


def ring(n=40, radius=3.0, heights=(0.7, 1.4, 2.1), arc_deg=360.0, center=(0.0, 0.0)):
    """Camera centres on an arc around the z axis, several heights in turn."""
    azimuth = np.radians(np.arange(n) * arc_deg / n)
    z = np.resize(heights, n)
    return np.column_stack(
        [center[0] + radius * np.cos(azimuth), center[1] + radius * np.sin(azimuth), z]
    )


def level_ring(n, radius):
    """Camera centres 1 m up all around the z axis."""
    return ring(n, radius, heights=(1.0,))


def tree_points(rng, foot=(0.0, 0.0, 0.0), height=2.6, radius=0.05, n=6000):
    """Stem with a crown of straight branches."""
    t, phi = rng.random(n), rng.uniform(0, 2 * np.pi, n)
    taper = radius * (1 - 0.7 * t)
    stem = np.column_stack([taper * np.cos(phi), taper * np.sin(phi), t * height])
    crown = []
    for _ in range(25):
        azimuth, start = rng.uniform(0, 2 * np.pi), rng.uniform(0.3, 0.95) * height
        length = rng.uniform(0.4, 1.0)
        direction = np.array([np.cos(azimuth), np.sin(azimuth), rng.uniform(0.3, 1.0)])
        steps = rng.random((n // 25, 1)) * length
        crown.append([0, 0, start] + steps * direction + rng.normal(0, 0.006, (n // 25, 3)))
    return np.concatenate([stem, *crown]) + foot


def ground_points(rng, reach=6.0, n=40000, hills=0.0, hole=0.0):
    """Ground with optional hills; z is 0 at the origin."""
    xy = rng.uniform(-reach, reach, (n, 2))
    z = rng.normal(0, 0.01, n) + hill_height(xy, hills)
    points = np.column_stack([xy, z])
    return points[np.hypot(*xy.T) > hole]


def hill_height(xy, hills):
    """Two crossing waves, zero and flat at the origin only on average."""
    x, y = np.asarray(xy).T
    return hills * (np.sin(x / 1.3) + 0.6 * np.sin(y / 0.9 + 0.5) - 0.6 * np.sin(0.5))


def arbitrary_frame(points, poses, seed=3):
    """Move a scene as COLMAP would: any rotation, scale and origin."""
    rng = np.random.default_rng(seed)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.linalg.det(q))
    scale, shift = 1.7, rng.normal(size=3)
    return scale * points @ q.T + shift, poses.transformed(scale, q, shift), (scale, q, shift)
