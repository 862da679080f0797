"""A tree as triangles that know their axis, for rays: tubes of the wood, and leaves by a rule."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cherrypicker.formats.measured import MeasuredTree
from cherrypicker.formats.tubes import tube
from cherrypicker.geometry.directions import tangent_basis, unit
from cherrypicker.geometry.lines import Line


@dataclass
class PartMesh:
    """Triangles in parts: an axis's tube or a leaf, which no triangle of its own part shades."""

    vertices: np.ndarray  # (n_vertices, 3) float64
    triangles: np.ndarray  # (n_triangles, 3) int64
    part: np.ndarray  # (n_triangles,) int64: of each triangle
    step: np.ndarray  # (n_triangles,) int64: the skeleton's node that its step leads to
    axis: np.ndarray  # (n_parts,) int64: that each part is of or hangs on
    is_leaf: np.ndarray  # (n_parts,) bool

    def areas(self) -> np.ndarray:
        """Surface of each part, (n_parts,) float64, of a leaf both sides."""
        a, b, c = (self.vertices[self.triangles[:, corner]] for corner in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        total = np.bincount(self.part, area, minlength=len(self.axis))
        return np.where(self.is_leaf, 2 * total, total)

    def with_parts(self, other: PartMesh) -> PartMesh:
        """Both meshes as one, the other's parts numbered on."""
        triangles, part = other.triangles + len(self.vertices), other.part + len(self.axis)
        added = replace(other, triangles=triangles, part=part)
        fields = zip(vars(self).values(), vars(added).values(), strict=True)
        return PartMesh(*map(np.concatenate, fields))


def wood_mesh(tree: MeasuredTree) -> PartMesh:
    """The tubes of a tree's axes, each a part of its number.

    A tube begins inside the wood of its parent, where the axis was last within the parent's radius.
    A ring's corners have the circle's perimeter, so that the tube's mean silhouette, which is the
    perimeter over pi (Cauchy), and its surface are those of the cones.
    """
    vertices, triangles, part, step = [], [], [], []
    n_vertices, n_sides = 0, 24
    side = np.pi / n_sides
    fit = np.sqrt(side / np.tan(side))  # a tube's rings have the area of the circle
    for index, axis in enumerate(tree.axis_list):
        points, radii, nodes = tree.axis_points(index), tree.axis_radii(index), axis.wood
        moves = np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-9)
        if axis.attach >= 0:
            reach = np.linalg.norm(points - points[0], axis=1)
            inside = reach <= tree.skeleton.radius[axis.attach]
            first = min(np.flatnonzero(inside)[-1], len(points) - 2)
            moves[:first], moves[first] = False, True
        if moves.sum() < 2:
            continue
        points, radii, nodes = points[moves], radii[moves], nodes[moves]
        corners, faces = tube(points, fit * radii, n_sides)
        # The triangles between two rings, low ones then up ones, and those of the two ends
        between = np.repeat(nodes[1:], n_sides)
        step += [between, between, np.repeat(nodes[[1, -1]], n_sides)]
        part.append(np.full(len(faces), index))
        vertices.append(corners)
        triangles.append(faces + n_vertices)
        n_vertices += len(corners)
    n_axes = len(tree.axis_list)
    return PartMesh(
        np.concatenate(vertices),
        np.concatenate(triangles),
        np.concatenate(part),
        np.concatenate(step),
        np.arange(n_axes),
        np.zeros(n_axes, dtype=bool),
    )


def leaf_mesh(tree: MeasuredTree, area: float) -> PartMesh:
    """Leaves on the shoots of a tree, each a part of its own.

    A leaf every 25 mm along each axis where no way on to a tip is longer than 0.5 m, each a
    golden angle further round: a rule of lengths alone, which a scan knows better than the
    diameters of its twigs. Its stalk and blade leave the shoot at 45 degrees towards the tip; the
    blade is a flat rhomb twice as long as wide that faces up as far as its direction lets it.

    `area` is that of one side of a blade, m2.
    """
    spacing, shoot, stalk = 0.025, 0.5, 0.03
    golden = np.pi * (3.0 - np.sqrt(5.0))
    to_tip, length = tree.skeleton.reach(), tree.skeleton.edge_length
    places, along, axes, steps, turns = [], [], [], [], []
    for index, axis in enumerate(tree.axis_list):
        points, nodes = tree.axis_points(index), axis.nodes
        if len(points) < 2:
            continue
        line = Line(points)
        at = np.arange(spacing, line.along[-1], spacing)
        left = to_tip[nodes]
        if axis.attach >= 0:
            left = np.append(left[0] + length[nodes[0]], left)
        at = at[np.interp(at, line.along, left) < shoot]
        row = np.searchsorted(line.along, at)
        places.append(line.at(at))
        along.append(np.diff(points, axis=0)[row - 1])
        axes.append(np.full(len(at), index))
        steps.append(nodes[row - (len(points) - len(nodes))])
        turns.append(golden * np.arange(len(at)))
    way = unit(np.concatenate(along))
    corners = _blades(np.concatenate(places), way, np.concatenate(turns)[:, None], area, stalk)
    n = len(way)
    quads = 4 * np.arange(n)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    number = np.repeat(np.arange(n), 2)
    return PartMesh(
        corners.reshape(-1, 3),
        quads.reshape(-1, 3),
        number,
        np.concatenate(steps)[number],
        np.concatenate(axes),
        np.ones(n, dtype=bool),
    )


def _blades(
    base: np.ndarray, way: np.ndarray, turn: np.ndarray, area: float, stalk: float
) -> np.ndarray:
    """Corners of the blades on places of shoots that run along `way`, (n, 4, 3)."""
    first, second = np.moveaxis(tangent_basis(way), 1, 0)
    out = np.cos(turn) * first + np.sin(turn) * second
    blade = (out + way) / np.sqrt(2.0)
    # Across the blade and level, so that it faces up; of one that stands upright, round the shoot
    side = np.cross(blade, [0.0, 0.0, 1.0])
    is_upright = np.linalg.norm(side, axis=1) < 1e-6
    side[is_upright] = np.cross(blade, way)[is_upright]
    side = unit(side)
    width = np.sqrt(area)
    foot = base + stalk * blade
    middle, tip = foot + width * blade, foot + 2 * width * blade
    return np.stack([foot, middle + width / 2 * side, tip, middle - width / 2 * side], axis=1)
