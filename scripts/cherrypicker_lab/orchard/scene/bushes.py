"""Hedges and bushes of real leaves: shells of small quads over a dark core."""

import numpy as np

from cherrypicker.classes import Label
from cherrypicker.geometry.directions import unit
from cherrypicker_lab.orchard.scene.mesh import Mesh, SceneObject, grid_faces, join
from cherrypicker_lab.orchard.scene.noise import fbm

# leaves from dark to light, linear RGB: evergreen, privet, a hornbeam's dead leaves kept in winter
FOLIAGE = (
    ((0.012, 0.030, 0.010), (0.075, 0.130, 0.040)),
    ((0.030, 0.045, 0.014), (0.150, 0.180, 0.060)),
    ((0.060, 0.034, 0.016), (0.260, 0.160, 0.075)),
)
CORE = (0.012, 0.014, 0.008)
COVER = 1.5  # leaf area over shell area: the core shows in gaps only
HEDGE_LEAF_M = 0.06  # length of a hedge's leaf
DEPTH_M = 0.22  # of the shell that holds leaves


def _leaves(rng, points, normals, size):
    """Quads (n, 4) around points, tilted at random from their normals (n, 3); `size` in m."""
    n = len(points)
    facing = normals + rng.normal(size=(n, 3)) * 0.7
    facing /= np.linalg.norm(facing, axis=1, keepdims=True) + 1e-12
    along = np.cross(facing, rng.normal(size=(n, 3)))
    along /= np.linalg.norm(along, axis=1, keepdims=True) + 1e-12
    across = np.cross(facing, along)
    length = size * rng.uniform(0.6, 1.4, (n, 1)) / 2
    corners = np.stack(
        [points + length * along, points + 0.6 * length * across,
         points - length * along, points - 0.6 * length * across], axis=1,
    )  # fmt: skip
    faces = 4 * np.arange(n)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    tint = rng.random(n) ** 1.5 * np.clip(0.5 + points[:, 2] / 3.0, 0.5, 1.2)
    attributes = {"tint": np.repeat(np.clip(tint, 0, 1), 4)}
    return Mesh(corners.reshape(-1, 3), faces.reshape(-1, 3).astype(np.int32), attributes)


def _core(mesh):
    """A mesh without tint, as dark as the inside of a hedge."""
    return Mesh(mesh.vertices, mesh.faces, {"tint": np.full(len(mesh.vertices), -1.0)})


def _ball(radii, bumps, seed):
    """A lumpy ellipsoid."""
    rows, columns = 14, 24
    polar = np.linspace(0.02, np.pi - 0.02, rows)[:, None]
    azimuth = np.linspace(0, 2 * np.pi, columns, endpoint=False)[None]
    d = np.stack(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth),
         np.cos(polar) + 0 * azimuth], axis=-1,
    ).reshape(-1, 3)  # fmt: skip
    vertices = d * radii * _lumps(d, bumps, seed)[:, None]
    row = np.arange(rows - 1)[:, None] * columns
    a, b = row + np.arange(columns), row + (np.arange(columns) + 1) % columns
    faces = np.stack(
        [np.stack([a, a + columns, b], -1), np.stack([b, a + columns, b + columns], -1)], 2
    )
    return Mesh(vertices, faces.reshape(-1, 3).astype(np.int32))


def _lumps(directions, bumps, seed):
    return 1.0 + bumps * 2.0 * (fbm(directions * 2.2 + 9.0, octaves=3, seed=seed) - 0.5)


def _foliage(rng, name, mesh, seed):
    dark, light = FOLIAGE[rng.integers(len(FOLIAGE))]
    material = {"kind": "leaves", "seed": seed, "dark": dark, "light": light, "core": CORE}
    return SceneObject(name, int(Label.UNLABELLED), mesh, material, radius=0.01)


def bush(rng, name, foot, height, width, seed, leaf_m):
    """A round bush on its foot (3,); all lengths are in m, the seed is of its lumps.

    `leaf_m` is the length of a leaf: the nearer the bush, the smaller.
    """
    radii = np.array([width / 2, width / 2 * rng.uniform(0.8, 1.2), 0.55 * height])
    middle = foot + [0.0, 0.0, 0.45 * height]
    area = 4 * np.pi * np.mean([radii[0] * radii[1], radii[0] * radii[2], radii[1] * radii[2]])
    d = unit(rng.normal(size=(int(COVER * area / (0.3 * leaf_m**2)), 3)))
    d = d[d[:, 2] > -0.75]  # what is below the foot lies in the ground
    shell = radii * _lumps(d, 0.25, seed)[:, None] * d
    inward = rng.uniform(0, min(DEPTH_M, 0.3 * width), (len(d), 1))
    leaves = _leaves(rng, middle + shell - inward * d, d / radii, leaf_m)
    core = _core(_ball(0.78 * radii, 0.25, seed).moved(middle))
    return _foliage(rng, name, join([leaves, core]), seed)


def hedge(rng, name, start, stop, height, width, ground, seed):
    """A clipped hedge between the ends, (2,) each, of its middle line; all lengths in m.

    `ground` gives the ground's level z (n,) at xy (n, 2); the seed is of its bumps.
    """
    length = float(np.linalg.norm(stop - start))
    along = (stop - start) / length
    across = np.array([-along[1], along[0]])
    sides = np.array([length * height, length * height, length * width, width * height,
                      width * height])  # fmt: skip
    n = int(COVER * sides.sum() / (0.3 * HEDGE_LEAF_M**2))
    side = rng.choice(5, n, p=sides / sides.sum())
    s, t, v = rng.random((3, n)) * np.array([[length], [1.0], [1.0]])
    out = np.array([[0, -1, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [1, 0, 0]], float)[side]
    local = np.column_stack([s, width * (t - 0.5), height * v])
    local[side == 0, 1], local[side == 1, 1] = -width / 2, width / 2
    local[side == 2, 2] = height
    local[side == 3, 0], local[side == 4, 0] = 0.0, length
    bump = 0.35 * (fbm(local * 0.9 + 3.0, octaves=3, seed=seed) - 0.5)
    local += (bump - rng.uniform(0, min(DEPTH_M, 0.3 * width), n))[:, None] * out

    def placed(points):
        xy = start + points[:, :1] * along + points[:, 1:2] * across
        return np.column_stack([xy, ground(xy) + points[:, 2] - 0.03])

    normals = np.column_stack([out[:, :1] * along + out[:, 1:2] * across, out[:, 2]])
    leaves = _leaves(rng, placed(local), normals, HEDGE_LEAF_M)
    return _foliage(rng, name, join([leaves, _core(_hedge_core(length, width, height, placed))]),
                    seed)  # fmt: skip


def _hedge_core(length, width, height, placed):
    """The dark inside: a row of closed profiles that follow the ground."""
    n = max(int(np.ceil(length / 0.5)), 2) + 1
    inner = max(0.5 * width - 0.7 * min(DEPTH_M, 0.3 * width), 0.1)
    profile = np.array([[-inner, -0.2], [-inner, height - 0.2], [inner, height - 0.2],
                        [inner, -0.2]])  # fmt: skip
    s = np.repeat(np.linspace(0.15, length - 0.15, n), 4)
    points = placed(np.column_stack([s, np.tile(profile, (n, 1))]))
    ends = np.array([[0, 2, 1], [0, 3, 2]])
    last = 4 * (n - 1) + ends[:, ::-1]
    return Mesh(points, np.concatenate([grid_faces(n, 4), ends, last]).astype(np.int32))
