"""Meshes of things of any kind: plates, turned solids, bars, bent tubes, sheets, blades.

Each has `rest` (m, for textures of wood and dirt) and `uv` in [0, 1] (for images) at its vertices.
"""

import numpy as np

from cherrypicker.geometry.directions import unit
from cherrypicker_lab.orchard.scene.mesh import Mesh, circles, grid_faces, join


def _with_uv(vertices, faces, uv):
    vertices = np.asarray(vertices, float)
    attributes = {"rest": vertices.copy(), "uv": np.asarray(uv, float)}
    return Mesh(vertices, np.asarray(faces, np.int32), attributes)


def _grid(places, uv, *, wrap=False):
    """A surface through a grid (rows, columns, 3), its columns closed to a ring where `wrap`."""
    faces = grid_faces(*places.shape[:2], wrap=wrap)
    return _with_uv(places.reshape(-1, 3), faces, uv.reshape(-1, 2))


def both_sides(mesh):
    """A surface without thickness, seen from either side."""
    turned = Mesh(mesh.vertices, mesh.faces[:, ::-1].copy(), mesh.attributes)
    return join([mesh, turned])


def plate(width, height, thickness, corners=4):
    """A board of 3 or more corners in the x-y plane, its front at z = 0, printed through.

    Four corners make a rectangle, many an ellipse; all fill `width` times `height` (m).
    """
    angle = np.pi / 2 + (np.arange(corners) - 0.5 * (corners == 4)) * 2 * np.pi / corners
    outline = np.column_stack([np.cos(angle), np.sin(angle)])
    low, high = outline.min(axis=0), outline.max(axis=0)
    share = (outline - low) / (high - low)
    flat = (share - 0.5) * [width, height]
    n = np.arange(1, corners - 1)
    fan = np.column_stack([0 * n, n, n + 1])
    front = _with_uv(np.column_stack([flat, np.zeros(corners)]), fan, share)
    behind = np.column_stack([flat, np.full(corners, -thickness)])
    back = _with_uv(behind, fan[:, ::-1], share)
    rim = _grid(np.stack([behind, front.vertices]), np.full((2, corners, 2), -1.0), wrap=True)
    return join([front, back, rim])


def turned(radii, heights, sides=24):
    """A solid with the radii (n,) at the heights (n,), m, around the z axis; u runs around it.

    Few sides make prisms and pyramids. Radii of 0 close it.
    """
    radii, heights = np.asarray(radii, float), np.asarray(heights, float)
    u = np.arange(sides + 1) / sides  # a seam, so that images close
    angle = 2 * np.pi * (u + 0.5 / sides)
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    rise = np.broadcast_to(heights[:, None, None], (len(radii), sides + 1, 1))
    places = np.concatenate([radii[:, None, None] * ring, rise], axis=2)
    v = (heights - heights.min()) / max(np.ptp(heights), 1e-9)
    uv = np.stack(np.broadcast_arrays(u[None], v[:, None]), axis=-1)
    return _grid(places, uv)


def bar(start, stop, width, depth=None, sides=4):
    """A straight bar between two places, m: a batten of 4 sides, a rod of more."""
    start, stop = np.asarray(start, float), np.asarray(stop, float)
    length = np.linalg.norm(stop - start)
    along = (stop - start) / length
    side = np.cross(along, [0.0, 0.0, 1.0] if abs(along[2]) < 0.9 else [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    radius = np.array([0.0, 1.0, 1.0, 0.0]) * (np.sqrt(0.5) if sides == 4 else 0.5)
    made = turned(radius, [0, 0, length, length], sides)
    scaled = made.vertices * [width, width if depth is None else depth, 1.0]
    moved = scaled @ np.stack([side, np.cross(along, side), along]) + start
    return Mesh(moved, made.faces, made.attributes | {"rest": scaled + start * 7.3})


def tube(points, radius, sides=8):
    """A tube of radius `radius`, m or (n,), along a polyline (n, 3), open at its ends."""
    along = unit(np.gradient(points, axis=0))
    across = unit(np.cross(along, np.array([0.31, 0.52, 0.79])))
    outward = circles(across, np.cross(along, across), sides)
    places = points[:, None] + np.broadcast_to(radius, len(points))[:, None, None] * outward
    s = np.linspace(0, 1, len(points))
    return _grid(places, np.stack(np.meshgrid(np.arange(sides) / sides, s), -1), wrap=True)


def sheet(width, depth, height, n=(25, 61)):
    """A surface over a rectangle around the origin, seen from both sides.

    `height` gives z (m) at shares (k,) and (k,) of `width` (x) and `depth` (y, m).
    """
    v, u = np.meshgrid(np.linspace(0, 1, n[0]), np.linspace(0, 1, n[1]), indexing="ij")
    z = height(u.ravel(), v.ravel()).reshape(u.shape)
    places = np.stack([(u - 0.5) * width, (v - 0.5) * depth, z], axis=-1)
    return both_sides(_grid(places, np.stack([u, v], -1)))


def blades(feet, ways, width):
    """Leaves of grass: triangles on feet (n, 3) along ways (n, 3), m, seen from both sides."""
    across = np.cross(ways, [0.31, 0.95, 0.1])
    across *= 0.5 * width / np.linalg.norm(across, axis=1, keepdims=True)
    corners = np.stack([feet - across, feet + across, feet + ways], axis=1).reshape(-1, 3)
    faces = np.arange(len(corners)).reshape(-1, 3)
    return both_sides(_with_uv(corners, faces, np.zeros((len(corners), 2))))
