"""Points on the surface of a tree: tapered tubes sampled as such, without a mesh."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from cherrypicker.geometry.directions import unit
from cherrypicker_lab.orchard.grow.tree import relative_radius
from cherrypicker_lab.orchard.scene.mesh import across

INSIDE = 0.98  # nearer to another axis than this share of its radius is inside its wood


@dataclass
class TubeSample:
    """Samples of a tree's surface."""

    # points, normals: (n, 3) float64: positions (m, tree's frame) and outward unit normals
    points: np.ndarray
    normals: np.ndarray
    axis: np.ndarray  # (n,) int64: axis of the tree that each sample lies on
    # radius, s: (n,) float64: radius of the wood and arc length from the axis' start, m
    radius: np.ndarray
    s: np.ndarray
    angle: np.ndarray  # (n,) float64: position around the axis, radians
    tangents: np.ndarray  # (n, 3) float64: unit direction of the axis

    def __len__(self):
        return len(self.points)

    def select(self, keep):
        """Rows of a mask or an index array."""
        return TubeSample(**{name: values[keep] for name, values in vars(self).items()})


def _segments(tree):
    """All segments of the axes, end to end, and the axis and the node that each starts from."""
    names = ("a", "b", "ra", "rb", "ua", "ub", "ta", "tb", "s", "axis", "row")
    table = {k: [] for k in names}
    n_nodes = 0
    for i, axis in enumerate(tree.axes):
        t = axis.tangents
        for key, values in (("", axis.points), ("r", axis.radii), ("u", across(t)), ("t", t)):
            table[f"{key}a"].append(values[:-1])
            table[f"{key}b"].append(values[1:])
        table["s"].append(axis.arclength[:-1])
        table["axis"].append(np.full(len(t) - 1, i))
        table["row"].append(n_nodes + np.arange(len(t) - 1))
        n_nodes += len(t)
    return {k: np.concatenate(v) for k, v in table.items()}


def _sections(tree):
    """Sections of all axes' nodes, end to end (n, k); one column of ones where all are circles."""
    k = max((a.section.shape[1] for a in tree.axes if a.section is not None), default=1)
    round_wood = [np.ones((len(a.points), k)) if a.section is None else a.section
                  for a in tree.axes]  # fmt: skip
    return np.concatenate(round_wood)


def _domes(rng, tree, density):
    """Hemispheres on the axes' ends, discs where they were cut."""
    ends = np.array([a.points[-1] for a in tree.axes])
    radii = np.array([a.radii[-1] for a in tree.axes])
    along = np.array([a.tangents[-1] for a in tree.axes])
    is_cut = np.array([a.is_cut for a in tree.axes])
    n = rng.poisson(np.where(is_cut, 1.0, 2.0) * np.pi * radii**2 * density)
    axis = np.repeat(np.arange(len(tree.axes)), n)
    normals = unit(rng.normal(size=(len(axis), 3)))
    facing = np.einsum("ij,ij->i", normals, along[axis])
    normals -= (facing - np.abs(facing))[:, None] * along[axis]  # mirrored to the outer half
    off, flat = normals.copy(), np.flatnonzero(is_cut[axis])
    height, normals[flat] = np.abs(facing[flat]), along[axis[flat]]
    off[flat] -= height[:, None] * normals[flat]
    # heights over the rim of an even hemisphere are even, as are squared distances on an even disc
    off[flat] *= (np.sqrt(height) / np.linalg.norm(off[flat], axis=1))[:, None]
    points = ends[axis] + radii[axis, None] * off
    s = np.array([a.arclength[-1] for a in tree.axes])[axis]
    return TubeSample(points, normals, axis, radii[axis], s, np.zeros(len(axis)), along[axis])


def sample_tubes(rng, tree, density, *, widen=0.0):
    """Spread points evenly over the surface of a tree, in its frame, m.

    A Poisson process: the number of points on a piece of surface has the mean area times density,
    which is in points a square metre. An axis counts as wider by `widen` (m): thin wood gets more
    points than its area. What lies inside the wood of another axis (a child's start inside its
    parent, crossing branches) is left out.
    """
    g = _segments(tree)
    length = np.linalg.norm(g["b"] - g["a"], axis=1)
    slant = np.hypot(length, g["ra"] - g["rb"])
    n = rng.poisson(np.pi * (g["ra"] + g["rb"] + 2 * widen) * slant * density)
    at = np.repeat(np.arange(len(n)), n)
    # the wider end of a cone's piece has more of its area
    ra, rb, v = g["ra"][at], g["rb"][at], rng.random(len(at))
    difference = rb - ra
    flat = np.abs(difference) < 1e-9
    root = np.sqrt(ra**2 + v * (rb**2 - ra**2))
    t = np.where(flat, v, (root - ra) / np.where(flat, 1.0, difference))
    angle = rng.uniform(0, 2 * np.pi, len(at))

    def blend(name):
        return (1 - t)[:, None] * g[f"{name}a"][at] + t[:, None] * g[f"{name}b"][at]

    centre, tangent, u = blend(""), blend("t"), blend("u")
    tangent = unit(tangent)
    u -= np.einsum("ij,ij->i", u, tangent)[:, None] * tangent
    u = unit(u)
    out = np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * np.cross(tangent, u)
    radius = ra + t * difference
    outline, slant_around = relative_radius(_sections(tree), g["row"][at], t, angle)
    around = np.cross(tangent, out)
    slope = (difference / np.maximum(length[at], 1e-9))[:, None]
    normals = unit(out - (slant_around / outline)[:, None] * around - slope * tangent)
    tubes = TubeSample(
        centre + (radius * outline)[:, None] * out, normals, g["axis"][at], radius,
        g["s"][at] + t * length[at], angle, tangent,
    )  # fmt: skip
    domes = _domes(rng, tree, density)
    joined = TubeSample(**{k: np.concatenate([v, vars(domes)[k]]) for k, v in vars(tubes).items()})
    return joined.select(~inside_wood(tree, joined.points, joined.axis))


def inside_wood(tree, points, axis):
    """Whether points lie inside the wood of an axis other than their own, (n,) bool.

    The points (n, 3) are in the tree's frame, m; `axis` (n,) is that of each, -1 for none.
    """
    g = _segments(tree)
    low = points.min(axis=0) - 1e-6
    cell = 0.02
    size = np.floor((points.max(axis=0) - low) / cell).astype(np.int64) + 1
    index = np.floor((points - low) / cell).astype(np.int64)
    key = (index[:, 0] * size[1] + index[:, 1]) * size[2] + index[:, 2]
    order = np.argsort(key, kind="stable")
    inside = np.zeros(len(points), np.bool_)
    cells, first = np.unique(key[order], return_index=True)
    _mark_inside(
        points, np.asarray(axis, np.int64), order, cells, np.append(first, len(points)), low,
        cell, size, g["a"], g["b"], INSIDE * g["ra"], INSIDE * g["rb"], g["axis"], g["row"],
        g["ua"], g["ta"], _sections(tree), inside,
    )  # fmt: skip
    return inside


@njit(cache=True)
def _mark_inside(
    points, owner, order, cells, first, low, cell, size, a, b, ra, rb, axis, row, across, along,
    section, inside,
):  # fmt: skip
    n_angles = section.shape[1]
    for k in range(len(a)):
        outline = section[row[k]]
        reach = max(ra[k], rb[k]) * outline.max()
        lo, hi = np.empty(3, np.int64), np.empty(3, np.int64)
        for c in range(3):
            lo[c] = max(int(np.floor((min(a[k, c], b[k, c]) - reach - low[c]) / cell)), 0)
            top = int(np.floor((max(a[k, c], b[k, c]) + reach - low[c]) / cell))
            hi[c] = min(top, size[c] - 1)
        d = b[k] - a[k]
        length2 = max(d[0] ** 2 + d[1] ** 2 + d[2] ** 2, 1e-18)
        for i in range(lo[0], hi[0] + 1):
            for j in range(lo[1], hi[1] + 1):
                begin = (i * size[1] + j) * size[2]
                start = np.searchsorted(cells, begin + lo[2])
                stop = np.searchsorted(cells, begin + hi[2], side="right")
                if start >= stop:
                    continue
                for n in order[first[start] : first[stop]]:
                    if inside[n] or owner[n] == axis[k]:
                        continue
                    x, y, z = points[n, 0] - a[k, 0], points[n, 1] - a[k, 1], points[n, 2] - a[k, 2]
                    t = min(max((x * d[0] + y * d[1] + z * d[2]) / length2, 0.0), 1.0)
                    x, y, z = x - t * d[0], y - t * d[1], z - t * d[2]
                    r = ra[k] + t * (rb[k] - ra[k])
                    if n_angles > 1:
                        u, w = across[k], along[k]
                        beside = (
                            x * (w[1] * u[2] - w[2] * u[1]) + y * (w[2] * u[0] - w[0] * u[2])
                            + z * (w[0] * u[1] - w[1] * u[0])
                        )  # fmt: skip
                        angle = np.arctan2(beside, x * u[0] + y * u[1] + z * u[2])
                        r *= outline[int(round(angle / (2 * np.pi) * n_angles)) % n_angles]
                    if x * x + y * y + z * z < r * r:
                        inside[n] = True
