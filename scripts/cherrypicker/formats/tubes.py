"""A tree as closed triangle meshes: one tube with two ends an axis.

A ring of vertices stands on each node of an axis, in the plane that halves the bend there, wide
enough that a tube of one radius keeps its cross-section round the bend; a ring's polygon has the
area of the circle. So a tube has the volume of its cones, which is the volume that the traits
report.
"""

from collections.abc import Iterator

import numpy as np

from cherrypicker.formats.measured import MeasuredTree
from cherrypicker.geometry.lines import NEAR

N_SIDES = 12
# A ring is stretched across a bend up to so much: twice, that of a bend by 120 degrees
LARGEST_STRETCH = 2.0


def axis_tubes(tree: MeasuredTree) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Yield ``branch_id``, vertices and faces of the tube of every axis that has a length.

    Vertices, (n_vertices, 3) float64, are in the skeleton's frame and unit; faces, (n_faces, 3)
    int64, are rows of them, counterclockwise as seen from outside.
    """
    for index in range(len(tree.axis_list)):
        points, radii = tree.axis_points(index), tree.axis_radii(index)
        moves = np.linalg.norm(np.diff(points, axis=0), axis=1) > NEAR
        keep = np.append(True, moves)
        if keep.sum() > 1:
            yield index, *tube(points[keep], radii[keep], N_SIDES)


def tube(points: np.ndarray, radii: np.ndarray, n_sides: int) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and faces of a closed tube about a polyline, no two places of it equal.

    The polyline's points are (n > 1, 3) and its radii (n,), float64; a ring has ``n_sides``
    corners.
    """
    steps = np.diff(points, axis=0)
    steps /= np.linalg.norm(steps, axis=1)[:, None]
    before, after = np.vstack([steps[:1], steps]), np.vstack([steps, steps[-1:]])
    across = _carried(steps, n_sides)  # (n - 1, n_sides, 3) of each step
    # Each corner runs along its step as far as the plane that halves the bend there
    halving = before + after
    is_back = np.linalg.norm(halving, axis=1) < NEAR
    halving[is_back] = before[is_back]
    rings = across[np.maximum(np.arange(len(points)) - 1, 0)]
    slope = (
        np.einsum("nsk,nk->ns", rings, halving) / np.einsum("nk,nk->n", before, halving)[:, None]
    )
    most = np.sqrt(LARGEST_STRETCH**2 - 1.0)
    rings = rings - np.clip(slope, -most, most)[..., None] * before[:, None]
    area = n_sides / (2.0 * np.pi) * np.sin(2.0 * np.pi / n_sides)
    corners = points[:, None] + (radii / np.sqrt(area))[:, None, None] * rings
    vertices = np.vstack([corners.reshape(-1, 3), points[:1], points[-1:]])
    return vertices, _faces(len(points), n_sides)


def _carried(steps: np.ndarray, n_sides: int) -> np.ndarray:
    """Unit vectors round each step, turned from step to step without a twist."""
    side = np.eye(3)[np.argmin(np.abs(steps[0]))]
    side = side - (side @ steps[0]) * steps[0]
    sides = [side / np.linalg.norm(side)]
    for last, step in zip(steps[:-1], steps[1:]):
        # Across the last step, so the turn that takes it onto this one is a mirror between the two
        middle, turned = last + step, sides[-1]
        if middle @ middle > NEAR:
            turned = turned - 2.0 * (turned @ middle) / (middle @ middle) * middle
        turned = turned - (turned @ step) * step
        sides.append(turned / np.linalg.norm(turned))
    one = np.array(sides)
    two = np.cross(steps, one)
    angle = 2.0 * np.pi * np.arange(n_sides) / n_sides
    return np.cos(angle)[:, None] * one[:, None] + np.sin(angle)[:, None] * two[:, None]


def _faces(n_rings: int, n_sides: int) -> np.ndarray:
    """Triangles of a tube of rings, the middles of its two ends coming last."""
    corner = np.arange(n_rings * n_sides).reshape(n_rings, n_sides)
    further = np.roll(corner, -1, axis=1)
    low, low_next, up, up_next = (
        of.ravel() for of in (corner[:-1], further[:-1], corner[1:], further[1:])
    )
    first, last = np.repeat(corner.size + np.arange(2), n_sides).reshape(2, n_sides)
    triangles = [
        (low, low_next, up_next),
        (low, up_next, up),
        (first, further[0], corner[0]),
        (last, corner[-1], further[-1]),
    ]
    return np.vstack(list(map(np.column_stack, triangles)))
