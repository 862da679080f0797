"""Triangle meshes of the orchard's things: branch tubes, boards, boxes, rings, the ground."""

from dataclasses import dataclass, field

import numpy as np
from numba import njit

from cherrypicker.geometry.directions import unit
from cherrypicker_lab.orchard.grow.tree import relative_radius

NO_TREE = 255


@dataclass
class Mesh:
    """Triangles with per-vertex attributes."""

    vertices: np.ndarray  # (V, 3) float64: positions, m
    faces: np.ndarray  # (F, 3) int32: vertex indices, counter-clockwise seen from outside
    # dict of str to ndarray of shape (V, ...): what the texture needs (`rest`, `uv`) and what the
    # truth needs (`axis`, `radius`)
    attributes: dict = field(default_factory=dict)

    def moved(self, offset, rotation=None):
        """The mesh turned by a 3x3 rotation and then moved."""
        vertices = self.vertices if rotation is None else self.vertices @ np.asarray(rotation).T
        return Mesh(vertices + np.asarray(offset), self.faces, dict(self.attributes))

    def face_areas(self):
        """Area of each triangle, shape (F,), m2."""
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)

    def vertex_normals(self):
        """Outward unit normals at the vertices, shape (V, 3), faces weighted by their area."""
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        face = np.cross(b - a, c - a)
        normals = np.empty_like(self.vertices)
        for k in range(3):
            normals[:, k] = np.bincount(
                self.faces.ravel(), np.repeat(face[:, k], 3), len(self.vertices)
            )
        return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)


@dataclass
class SceneObject:
    """A mesh with its class and its look."""

    name: str
    label: int  # class of all of it; a tree's wood takes its class from the axis instead
    mesh: Mesh
    # `kind` (bark, wood, image, plain, leaves) and what that kind needs, see `surface_color`
    material: dict
    tree: int = NO_TREE  # 0 the target, 1.. neighbours, 255 no tree.
    radius: float = 0.05  # how thick it is, m: stereo loses wires and threads as it loses twigs


def join(meshes):
    """Concatenate meshes that have the same attributes."""
    offsets = np.cumsum([0] + [len(m.vertices) for m in meshes[:-1]])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.faces + o for m, o in zip(meshes, offsets)]).astype(np.int32),
        {k: np.concatenate([m.attributes[k] for m in meshes]) for k in meshes[0].attributes},
    )


@njit(cache=True)
def _transported(tangents, first):
    """Unit vectors (n, 3) across the tangents of one axis, carried along it without twist."""
    normals = np.empty_like(tangents)
    n = first.copy()
    for i in range(len(tangents)):
        t = tangents[i]
        n = n - t * (n[0] * t[0] + n[1] * t[1] + n[2] * t[2])
        n = n / np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
        normals[i] = n
    return normals


def across(tangents):
    """Unit vectors (n, 3) across the tangents of one axis, see `_transported`."""
    t = tangents[0]
    ref = np.array([1.0, 0.0, 0.0]) if abs(t[2]) > 0.7 else np.array([0.0, 0.0, 1.0])
    return _transported(np.ascontiguousarray(tangents), np.cross(t, ref))


def two_across(directions):
    """Two unit vectors across each of unit vectors, (n, 3) each, and across one another."""
    steep = np.abs(directions[:, 2:]) > 0.7
    u = unit(np.cross(directions, np.where(steep, [[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]])))
    return u, np.cross(directions, u)


def circles(u, v, sides):
    """Unit vectors all around, (n, sides, 3), from two across one another, (n, 3) each."""
    angle = np.arange(sides) * 2 * np.pi / sides
    return np.cos(angle)[:, None] * u[:, None] + np.sin(angle)[:, None] * v[:, None]


def turn_about(angle):
    """Rotation by an angle about z, (3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def grid_faces(rows, columns, *, wrap=True):
    """Triangles (n, 3) of a grid of vertices, row by row; columns close to rings where `wrap`."""
    r = np.arange(rows - 1)[:, None] * columns
    c = np.arange(columns if wrap else columns - 1)
    a, b = r + c, r + (c + 1) % columns
    faces = np.stack(
        [np.stack([a, b, b + columns], -1), np.stack([a, b + columns, a + columns], -1)], axis=2
    )
    return faces.reshape(-1, 3).astype(np.int32)


def _tube(points, radii, tangents, sides, arclength, rest_offset, *, section=None, is_cut=False):
    """One tube with a rounded end, or a flat one. `rest` is the point on the straightened axis.

    `section` has the surface's distance from the axis at its angles, a row a point.
    """
    u = across(tangents)
    v = np.cross(tangents, u)
    # two shrinking rows past the last node round the tip off
    tip, r, t = points[-1], radii[-1], tangents[-1]
    beyond = np.zeros(2) if is_cut else r * np.array([0.6, 1.0])
    points = np.vstack([points, tip + beyond[:, None] * t])
    radii = np.append(radii, [0.8 * r, 0.02 * r])
    arclength = np.append(arclength, arclength[-1] + beyond)
    u, v = np.vstack([u, u[-1:], u[-1:]]), np.vstack([v, v[-1:], v[-1:]])
    angle = np.arange(sides) * 2 * np.pi / sides
    c, s = np.cos(angle), np.sin(angle)
    outline = radii[:, None] * np.ones(sides)
    if section is not None:
        row = np.minimum(np.arange(len(points)), len(section) - 2)
        share = np.minimum(np.arange(len(points)) - row, 1)
        outline *= relative_radius(section, row[:, None], share[:, None], angle)[0]
    vertices = points[:, None] + outline[..., None] * circles(u, v, sides)
    rest = np.empty_like(vertices)
    rest[..., 0], rest[..., 1] = radii[:, None] * c, radii[:, None] * s
    rest[..., 2] = arclength[:, None]
    faces = grid_faces(len(points), sides)
    return vertices.reshape(-1, 3), faces, rest.reshape(-1, 3) + rest_offset


def tree_mesh(tree, *, row_step=0.01, side_step=0.006, max_sides=48, min_sides=8):
    """Tubes of all axes of a tree.

    Rows are `row_step` m apart along an axis, resampled by linear interpolation; a facet around it
    is about `side_step` m wide, and there are `min_sides` to `max_sides` of them. The attributes of
    the mesh are `rest` (V, 3) (position on the straightened axis, shifted per axis, for textures),
    `axis` (V,) int32, `radius` (V,) and `s` (V,), arc length, all m.
    """
    rng = np.random.default_rng([tree.bark_seed, 23])
    parts = []
    for i, axis in enumerate(tree.axes):
        s, tangents = axis.arclength, axis.tangents
        rows = np.linspace(0, s[-1], max(int(np.ceil(s[-1] / row_step)), 2) + 1)

        def at(values, s=s, rows=rows):
            columns = np.atleast_2d(values.T)
            return np.stack([np.interp(rows, s, c) for c in columns], axis=-1)

        radii = at(axis.radii)[:, 0]
        along = unit(at(tangents))
        circumference = 2 * np.pi * float(np.mean(axis.radii))
        sides = int(np.clip(round(circumference / side_step), min_sides, max_sides))
        vertices, faces, rest = _tube(
            at(axis.points), radii, along, sides, rows, rng.uniform(-50, 50, 3),
            section=None if axis.section is None else at(axis.section), is_cut=axis.is_cut,
        )  # fmt: skip
        n = len(vertices)
        attributes = {
            "rest": rest,
            "axis": np.full(n, i, np.int32),
            "radius": np.repeat(np.append(radii, radii[[-1, -1]]), sides),
            "s": np.repeat(np.append(rows, rows[[-1, -1]]), sides),
        }
        parts.append(Mesh(vertices, faces, attributes))
    return join(parts)


def ground_disc(height, outer, rings, sectors):
    """A disc of a radius of `outer` m around the origin, fine near it and coarse far off.

    `height` gives z (n,) of positions xy (n, 2), m. The mesh has no attributes.
    """
    radius = 0.01 + (outer - 0.01) * np.linspace(0, 1, rings) ** 2.0
    angle = np.arange(sectors) * 2 * np.pi / sectors
    xy = np.stack(
        [radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle)], axis=-1
    ).reshape(-1, 2)
    vertices = np.column_stack([xy, height(xy)])
    faces = grid_faces(rings, sectors)
    centre = np.array([[0, 0, height(np.zeros((1, 2)))[0]]])
    first = np.arange(sectors)
    fan = np.column_stack([np.full(sectors, len(vertices)), first, (first + 1) % sectors])
    return Mesh(np.vstack([vertices, centre]), np.vstack([faces, fan]).astype(np.int32))


def cylinder(base, top, radius, *, sides=32, rows=16):
    """A closed cylinder between two points, with `rest` coordinates for its texture."""
    base, top = np.asarray(base, float), np.asarray(top, float)
    s = np.linspace(0, np.linalg.norm(top - base), rows)
    t = np.repeat([(top - base) / s[-1]], rows, axis=0)
    points = base + s[:, None] * t
    vertices, faces, rest = _tube(points, np.full(rows, radius), t, sides, s, base * 7.3)
    return Mesh(vertices, faces, {"rest": rest})


def ring(points, radii):
    """An open sleeve around a stem: shape (n, 3) points, (n,) radii, both m."""
    t = unit(np.gradient(points, axis=0))
    s = np.linspace(0, np.linalg.norm(points[-1] - points[0]), len(points))
    # the rims bend in to the bark so that no gap shows
    points = np.vstack([points[:1], points, points[-1:]])
    radii = np.concatenate([[0.8 * radii[0]], radii, [0.8 * radii[-1]]])
    t, s = np.vstack([t[:1], t, t[-1:]]), np.concatenate([s[:1], s, s[-1:]])
    u = across(t)
    sides = 48
    out = circles(u, np.cross(t, u), sides)
    vertices = (points[:, None] + radii[:, None, None] * out).reshape(-1, 3)
    rest = np.column_stack([vertices[:, :2], np.repeat(s, sides)])
    return Mesh(vertices, grid_faces(len(points), sides), {"rest": rest})


def quad_board(width, height, thickness):
    """A board in the x-y plane, its front face up at z = 0 with `uv` from (0, 0) to (1, 1).

    u runs along x and v along y; the other five faces have uv (-1, -1).
    """
    x, y = width / 2, height / 2
    front = np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]])
    uv = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    back = box((width, height, thickness), skip_top=True).moved((0, 0, -thickness / 2))
    back.attributes["uv"] = np.full((len(back.vertices), 2), -1.0)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return join([Mesh(front, faces, {"uv": uv, "rest": front}), back])


def box(size, *, skip_top=False):
    """A box centred on the origin with `rest` coordinates; `skip_top` leaves out the +z face."""
    h = np.asarray(size, float) / 2
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * h
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    if skip_top:
        quads = quads[:5]
    vertices = np.concatenate([corners[list(q)] for q in quads])
    first = 4 * np.arange(len(quads))[:, None, None]
    faces = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    uv = np.tile([[0.0, 0], [1, 0], [1, 1], [0, 1]], (len(quads), 1))
    return Mesh(vertices, faces.astype(np.int32), {"rest": vertices.copy(), "uv": uv})
