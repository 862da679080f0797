"""What is built along the row: support posts and wires, a roof of foil, nets."""

import numpy as np

from cherrypicker.classes import Label
from cherrypicker.geometry.directions import unit
from cherrypicker_lab.orchard.scene.mesh import (
    Mesh,
    SceneObject,
    cylinder,
    grid_faces,
    join,
    quad_board,
)

NETS = ("over", "along")
WIRE_RADIUS_M = 0.0015
_THREAD_STEP_M = 0.12


def foil_roof(rng, seed):
    """Two panels of translucent foil over the row."""
    z, pitch = rng.uniform(2.9, 3.6), np.radians(rng.uniform(12, 28))
    width = rng.uniform(1.1, 1.7)
    panels = []
    for sign in (-1, 1):
        c, s = np.cos(sign * pitch), np.sin(sign * pitch)
        turn = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
        middle = (0, -sign * width / 2 * c, z - abs(s) * width / 2)
        panels.append(quad_board(7.0, width, 0.004).moved(middle, turn))
    tone = rng.uniform(0.35, 0.6) * np.array([0.95, 1.0, 1.05])
    material = {"kind": "plain", "seed": seed + 5, "color": tuple(tone)}
    return SceneObject("roof", int(Label.ROOF), join(panels), material)


def support_post(rng, seed, ground, xy):
    """A wooden post of class support post."""
    height, radius = rng.uniform(1.5, 2.4), rng.uniform(0.018, 0.038)
    z = ground(xy[None])[0]
    lean = rng.normal(size=2) * 0.01
    mesh = cylinder((*xy, z - 0.05), (*(xy + lean), z + height), radius, rows=60)
    color = ((0.36, 0.29, 0.20), (0.30, 0.27, 0.24), (0.42, 0.36, 0.24))[rng.integers(3)]
    material = {"kind": "wood", "seed": seed + 9, "color": color}
    return SceneObject("support_post", int(Label.SUPPORT_POST), mesh, material)


def trellis(seed, spacing, n_wires, ground):
    """Two posts beside the tree and wires between and beyond them, along the row."""
    rng = np.random.default_rng([seed, 7])
    made, half, y = [], 0.5 * spacing * rng.uniform(0.9, 1.05), rng.choice([-1, 1]) * 0.05
    top = rng.uniform(1.6, 2.4)
    for i, x in enumerate((-half, half)):
        post = support_post(np.random.default_rng([seed, 8, i]), seed + i, ground, np.array([x, y]))
        post.name = f"row_post_{i}"
        made.append(post)
    steel = {"kind": "plain", "seed": seed + 12, "color": (0.30, 0.30, 0.31)}
    for i in range(n_wires):
        z = top * (i + 1) / (n_wires + 0.3)
        wire = cylinder((-2 * half, y, z), (2 * half, y, z), WIRE_RADIUS_M, sides=6, rows=40)
        made.append(
            SceneObject(f"wire_{i}", int(Label.SUPPORT_POST), wire, steel, radius=WIRE_RADIUS_M)
        )
    return made


def _threads(lines, radius):
    """Square threads along polylines (k, n, 3): a mesh of k * n * 4 vertices."""
    k, n = lines.shape[:2]
    along = unit(np.gradient(lines, axis=1))
    u = unit(np.cross(along, np.array([0.31, 0.52, 0.79])))
    v = np.cross(along, u)
    ring = np.stack([u, v, -u, -v], axis=2)  # (k, n, 4, 3)
    vertices = (lines[:, :, None] + radius * ring).reshape(-1, 3)
    faces = grid_faces(n, 4) + (4 * n * np.arange(k))[:, None, None]
    return Mesh(vertices, faces.reshape(-1, 3).astype(np.int32), {"rest": vertices.copy()})


def _panel(corner, across, down, spacing, sag, radius):
    """A net between a corner and two edges (3,), sagging in its middle (m, downwards)."""
    size = np.linalg.norm(across), np.linalg.norm(down)
    n = [max(int(round(length / spacing)), 2) + 1 for length in size]
    fine = [max(int(round(length / _THREAD_STEP_M)), 4) + 1 for length in size]

    def at(s, t):  # (...,) shares of the edges
        place = corner + s[..., None] * across + t[..., None] * down
        place[..., 2] -= sag * 16 * s * (1 - s) * t * (1 - t)
        return place

    s, t = np.meshgrid(np.linspace(0, 1, n[0]), np.linspace(0, 1, fine[1]), indexing="ij")
    first = _threads(at(s, t), radius)
    t, s = np.meshgrid(np.linspace(0, 1, n[1]), np.linspace(0, 1, fine[0]), indexing="ij")
    return join([first, _threads(at(s, t), radius)])


def net(seed, kind, height, ground):
    """A net against hail or birds, of real threads, and the posts that carry it.

    It is a tent "over" the row, or a curtain "along" it, as tall as the target tree, whose height
    is given in m, and of class roof. `ground` gives the ground's level z (n,) at xy (n, 2). Raises
    a ValueError if there is no such kind.
    """
    if kind not in NETS:
        raise ValueError(f"net must be one of {', '.join(NETS)}, got {kind!r}")
    rng = np.random.default_rng([int(seed), 457])
    spacing, radius = rng.uniform(0.03, 0.07), rng.uniform(0.0005, 0.0011)
    tone = ((0.05, 0.05, 0.05), (0.55, 0.55, 0.53), (0.06, 0.12, 0.08))[rng.integers(3)]
    half, side = rng.uniform(2.2, 3.2), rng.choice([-1, 1])
    if kind == "over":
        top, drop = height + rng.uniform(0.25, 0.6), rng.uniform(0.3, 0.8)
        reach = rng.uniform(1.1, 1.7)
        panels = [
            _panel(np.array([-half, 0.0, top]), np.array([2 * half, 0, 0]),
                   np.array([0, way * reach, -drop]), spacing, rng.uniform(0.05, 0.2), radius)
            for way in (-1, 1)
        ]  # fmt: skip
        y = 0.0
    else:
        y = side * rng.uniform(0.75, 1.2)
        top = max(0.9 * height, 1.2)
        foot = rng.uniform(0.15, 0.5)
        panels = [
            _panel(np.array([-half, y, top]), np.array([2 * half, 0, 0]),
                   np.array([0, 0.15 * side, foot - top]), spacing, 0.0, radius)
        ]  # fmt: skip
    material = {"kind": "plain", "seed": seed + 15, "color": tone}
    made = [SceneObject("net", int(Label.ROOF), join(panels), material, radius=radius)]
    wood = {"kind": "wood", "seed": seed + 16, "color": (0.36, 0.29, 0.20)}
    for i, x in enumerate((-half, half)):
        z = ground(np.array([[x, y]]))[0]
        mesh = cylinder((x, y, z - 0.05), (x, y, top), rng.uniform(0.03, 0.05), rows=60)
        made.append(SceneObject(f"net_post_{i}", int(Label.SUPPORT_POST), mesh, wood))
    return made
