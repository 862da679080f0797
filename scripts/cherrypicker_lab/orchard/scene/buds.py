"""Winter buds: small pointed bodies at the tips and along the young wood of a tree."""

from dataclasses import dataclass

import numpy as np

from cherrypicker.geometry.directions import unit
from cherrypicker_lab.orchard.scene.mesh import Mesh, circles, grid_faces, two_across

LENGTH_M, WIDTH = (0.005, 0.009), (0.20, 0.28)  # radius of a bud per length
YOUNG_M = 0.0055  # radius of the wood that bears buds
LEAN = (0.5, 1.0)  # direction across the twig per direction along it
TURN = np.radians(144.0)  # two turns hold five buds, as on cherry shoots
PROFILE = ((-0.1, 0.75), (0.2, 1.0), (0.5, 0.85), (0.8, 0.45), (1.0, 0.0))  # along, radius
SIDES = 6


@dataclass
class Buds:
    """Buds of a tree, n of them."""

    # points, directions: (n, 3) float64: where they sit (m, tree's frame) and their unit direction
    points: np.ndarray
    directions: np.ndarray
    # length, radius, s: (n,) float64: size, and arc length of the seat on its axis, m
    length: np.ndarray
    radius: np.ndarray
    s: np.ndarray
    axis: np.ndarray  # (n,) int64: axis of the tree that bears each


def set_buds(rng, tree, per_metre):
    """Set a bud on every thin tip and more along the young wood.

    There are `per_metre` buds a metre of wood of at most 5.5 mm radius.
    """
    parts = []
    for number, axis in enumerate(tree.axes):
        s, tangents = axis.arclength, axis.tangents
        young = s[np.argmax(axis.radii <= YOUNG_M)] if axis.radii[-1] <= YOUNG_M else s[-1]
        step = 1.0 / per_metre
        at = np.arange(young + step * rng.uniform(0.3, 1.0), s[-1] - 0.3 * step, step)
        at = at + rng.uniform(-0.2, 0.2, len(at)) * step
        angle = rng.uniform(0, 2 * np.pi) + TURN * np.arange(len(at))

        def node(values, s=s, at=at):
            return np.stack([np.interp(at, s, c) for c in np.atleast_2d(values.T)], axis=-1)

        along = unit(node(tangents))
        u, v = two_across(along)
        side = np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v
        seats = node(axis.points) + 0.8 * node(axis.radii) * side
        directions = along + rng.uniform(*LEAN, (len(at), 1)) * side
        if axis.radii[-1] <= YOUNG_M:  # a stub has no bud on its cut
            tip = axis.points[-1:] + 0.5 * axis.radii[-1] * tangents[-1:]
            seats = np.vstack([seats, tip])
            directions = np.vstack([directions, tangents[-1:]])
            at = np.append(at, s[-1])
        parts.append((seats, directions, at, np.full(len(seats), number)))
    points, directions, s, axis = (np.concatenate(values) for values in zip(*parts))
    directions = unit(directions)
    length = rng.uniform(*LENGTH_M, len(points))
    return Buds(points, directions, length, length * rng.uniform(*WIDTH, len(points)), s, axis)


def bud_mesh(buds):
    """Mesh of all buds, with the attributes of `mesh.tree_mesh`."""
    n, rows = len(buds.points), len(PROFILE)
    along, wide = np.array(PROFILE).T
    ring = circles(*two_across(buds.directions), SIDES)
    reach = buds.length[:, None] * along  # (n, rows)
    spread = buds.radius[:, None] * wide
    vertices = (
        buds.points[:, None, None]
        + reach[:, :, None, None] * buds.directions[:, None, None]
        + spread[:, :, None, None] * ring[:, None]
    )  # (n, rows, sides, 3)
    each = rows * SIDES
    faces = grid_faces(rows, SIDES) + (np.arange(n) * each)[:, None, None]
    attributes = {
        "rest": vertices.reshape(-1, 3).copy(),
        "axis": np.repeat(buds.axis, each).astype(np.int32),
        "radius": np.repeat(buds.radius, each),
        "s": np.repeat(buds.s, each),
    }
    return Mesh(vertices.reshape(-1, 3), faces.reshape(-1, 3).astype(np.int32), attributes)
