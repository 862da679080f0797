"""Photos of a textured box on a textured floor, rendered by homographies, with known cameras."""

import cv2
import numpy as np
from scan_scene import look_at_poses

WIDTH, HEIGHT, FOCAL = 320, 240, 300.0


def texture(rng, size=512):
    """Return an uint8 texture with detail at several scales."""
    image = np.zeros((size, size, 3), np.float32)
    for step in (6, 14, 40):
        coarse = rng.random((size // step + 2, size // step + 2, 3)).astype(np.float32)
        image += cv2.resize(coarse, (size, size), interpolation=cv2.INTER_CUBIC)
    return np.clip(image / 3 * 255, 0, 255).astype(np.uint8)


def box_quads(rng):
    """Return textured quads: corners (4, 3) in the order of the texture's corners, and texture."""
    floor = np.array([[-2.3, -2.3, 0], [2.3, -2.3, 0], [2.3, 2.3, 0], [-2.3, 2.3, 0]])
    quads = [(floor, texture(rng, 1024))]
    ring = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float) * 0.7
    for i in range(4):
        a, b = ring[i], ring[(i + 1) % 4]
        wall = np.array([[*a, 0], [*b, 0], [*b, 1.4], [*a, 1.4]], float)
        quads.append((wall, texture(rng)))
    roof = np.array([[*corner, 1.4] for corner in ring], float)
    return [*quads, (roof, texture(rng))]


def orbit(n_photos, radius=3.5, span_deg=360.0, height=1.9):
    """Return cam_from_world (n, 3, 4) of cameras around the box that look at its middle."""
    angles = np.deg2rad(np.arange(n_photos) * span_deg / n_photos)
    heights = height + 0.3 * (np.arange(n_photos) % 2)
    centers = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), heights])
    return look_at_poses(centers, [0.0, 0.0, 0.5]).cam_from_world


def render(cam_from_world, quads, width=WIDTH, height=HEIGHT, focal=FOCAL):
    """Render one photo, far quads first."""
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    image = np.full((height, width, 3), 200, np.uint8)
    center = -cam_from_world[:, :3].T @ cam_from_world[:, 3]
    walls = quads[1:]
    order = sorted(walls, key=lambda quad: -np.linalg.norm(quad[0].mean(axis=0) - center))
    for corners, surface in [quads[0], *order]:
        size = surface.shape[0]
        a, b, d = corners[0], corners[1], corners[3]
        plane = np.column_stack([(b - a) / size, (d - a) / size, a])
        world = np.vstack([plane, [0, 0, 1.0]])
        H = K @ cam_from_world @ world
        if (
            H[2] @ np.array([[0, 0, 1], [size, size, 1], [0, size, 1], [size, 0, 1]]).T
        ).min() < 0.1:
            continue
        to_center = np.eye(3)
        to_center[:2, 2] = -0.5  # OpenCV puts pixel centres at whole numbers
        H = to_center @ H @ np.linalg.inv(to_center)
        warped = cv2.warpPerspective(surface, H, (width, height), flags=cv2.INTER_AREA)
        mask = cv2.warpPerspective(np.full((size, size), 255, np.uint8), H, (width, height))
        image[mask > 127] = warped[mask > 127]
    return image


def write_orbit(folder, n_photos=10, seed=0, span_deg=150.0, suffix="jpg"):
    """Render an orbit into a folder; return photo paths and true poses."""
    folder.mkdir(parents=True, exist_ok=True)
    quads = box_quads(np.random.default_rng(seed))
    poses = orbit(n_photos, span_deg=span_deg)
    paths = []
    for i, pose in enumerate(poses):
        path = folder / f"photo {i:02d}.{suffix}"
        cv2.imwrite(str(path), render(pose, quads), [cv2.IMWRITE_JPEG_QUALITY, 97])
        paths.append(path)
    return paths, poses


def centers_of(poses):
    """Return camera centres (n, 3) of cam_from_world (n, 3, 4)."""
    return -np.einsum("nji,nj->ni", poses[:, :, :3], poses[:, :, 3])


# What COLMAP's own threads may change in the last digits, relative to the cameras' distance.
COLMAP_TOLERANCE = 1e-3


def similarity_errors(source, target):
    """Return the distances left after the best similarity of source onto target."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    U, S, Vt = np.linalg.svd(b.T @ a)
    D = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    scale = np.trace(np.diag(S) @ D) / (a**2).sum()
    return np.linalg.norm(scale * a @ (U @ D @ Vt).T - b, axis=1)
