"""The exact surface of a rendered scene's target tree, sampled densely, and what the photos see.

The generator's trees are unions of tapered tubes around their skeletons, rendered without any
displacement, so ``truth/skeleton.csv`` holds the exact surface; the shipped ``truth/cloud.ply``
samples it every 5 mm only, which is too coarse to judge at 5 mm, and serves for all other things.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import Label, wood_mask
from cherrypicker.pointcloud import read_cloud
from cherrypicker.poses import Poses, read_poses
from cherrypicker.skeleton import read_skeleton_csv
from cherrypicker_lab.orchard.scene.mesh import two_across

# Distance between samples of the surface, m: moves a distance of 5 mm by less than 0.1 mm
STEP_M = 0.0015
# Surface as near to another thing (a ring around the stem) cannot be told from it
APART_M = 0.015
# A tube's first edge starts at its parent's axis, whose radius says nothing about it
_NEW_TUBE_RATIO = 1.4
# Radii are searched in bins of this ratio: the nearest axis is then that of the nearest surface
_BIN_RATIO = 1.4
# A surface turned further away from a camera than this gives it no texture
MAX_FACING_DEG = 80.0
# What lies this much behind the nearest surface of its pixel is hidden
_HIDDEN_M = 0.01


@dataclass
class TrueSurface:
    """Samples of the target tree's surface, metric frame."""

    # points, normals: (n, 3) float64: positions (m) and outward unit normals
    points: np.ndarray
    normals: np.ndarray
    area: np.ndarray  # (n,): surface that each sample stands for, m2
    radius: np.ndarray  # (n,): radius of the wood, m
    is_trunk: np.ndarray  # (n,) bool
    n_views: np.ndarray  # (n,) int: photos that see the sample
    others: np.ndarray  # (m, 3): samples of all other surfaces: ground, boards, markers, neighbours

    def select(self, index: np.ndarray) -> TrueSurface:
        """Return some of the samples, with all other things."""
        names = ("points", "normals", "area", "radius", "is_trunk", "n_views")
        return TrueSurface(**{name: getattr(self, name)[index] for name in names},
                           others=self.others)  # fmt: skip


def load_true_surface(truth: str | os.PathLike, *, step: float = STEP_M) -> TrueSurface:
    """Sample the true surface of a scene every `step` m and count the photos that see each sample.

    Samples within 15 mm of another thing than the ground are left out: a sleeve around the stem
    hides it. ``{scene}/truth`` has ``skeleton.csv``, ``poses.npz`` and ``cloud.ply``; a
    `StageError` is raised if one of them is missing or broken.
    """
    truth = Path(truth)
    skeleton = read_skeleton_csv(truth / "skeleton.csv")
    cloud = read_cloud(truth / "cloud.ply", required=("label", "tree"))
    is_target = wood_mask(cloud["label"]) & (cloud["tree"] == 0)
    others = cloud.points[~is_target]
    surface = sample_skeleton(skeleton, step=step)
    surface.others = others
    things = cloud.points[~is_target & (cloud["label"] != Label.GROUND)]
    if len(things):
        gap = cKDTree(things).query(surface.points, distance_upper_bound=APART_M)[0]
        surface = surface.select(~np.isfinite(gap))
    poses = read_poses(truth / "poses.npz")
    surface.n_views = count_views(surface, poses, step=step)
    return surface


def sample_skeleton(skeleton, *, step: float = STEP_M) -> TrueSurface:
    """Sample the union of the tapered tubes around a skeleton's edges (m) every `step` m.

    The radius of an edge that starts a new axis is its outer node's. Parts inside other tubes and
    open ends are left out; ``n_views`` is 0, ``others`` empty.
    """
    child = np.flatnonzero(skeleton.parent >= 0)
    start, end = skeleton.points[skeleton.parent[child]], skeleton.points[child]
    start_radius, end_radius = start_of_tubes(skeleton, child)[1], skeleton.radius[child]
    length = np.linalg.norm(end - start, axis=1)
    kept = length > 1e-6
    edges = (start[kept], end[kept], start_radius[kept], end_radius[kept], length[kept])
    points, normals, radius, area, edge = _sample_tubes(*edges, step)
    keep = tubes_distance(points, *edges[:4], step) > -np.maximum(0.03 * radius, 0.0003)
    label = skeleton.label[child][kept][edge[keep]]
    return TrueSurface(
        points=points[keep],
        normals=normals[keep],
        area=area[keep],
        radius=radius[keep],
        is_trunk=label == Label.TRUNK,
        n_views=np.zeros(int(keep.sum()), dtype=np.int64),
        others=np.empty((0, 3)),
    )


def start_of_tubes(skeleton, child):
    """Which nodes' edges start a tube of their own, and the radius where each edge starts."""
    parent, end = skeleton.parent[child], skeleton.radius[child]
    order = skeleton.fields.get("order", np.zeros(len(skeleton), dtype=int))
    is_new = (order[child] != order[parent]) | (skeleton.radius[parent] > _NEW_TUBE_RATIO * end)
    return is_new, np.where(is_new, end, skeleton.radius[parent])


def _sample_tubes(start, end, start_radius, end_radius, length, step):
    """Rings of samples around every edge; positions, normals, radii, areas and edge indices."""
    n_along = np.maximum(np.ceil(length / step).astype(int), 1)
    ring_edge = np.repeat(np.arange(len(length)), n_along)
    along = (_count_up(n_along) + 0.5) / n_along[ring_edge]
    ring_radius = start_radius[ring_edge] * (1 - along) + end_radius[ring_edge] * along
    n_around = np.maximum(np.ceil(2 * np.pi * ring_radius / step).astype(int), 8)
    ring = np.repeat(np.arange(len(ring_edge)), n_around)
    edge = ring_edge[ring]
    # neighbouring rings are turned by the golden angle, so that samples do not line up
    angle = 2 * np.pi * _count_up(n_around) / n_around[ring] + 2.399963 * ring
    tangent = (end - start) / length[:, None]
    u, v = two_across(tangent)
    normal = np.cos(angle)[:, None] * u[edge] + np.sin(angle)[:, None] * v[edge]
    radius = ring_radius[ring]
    center = start[edge] + along[ring, None] * (end - start)[edge]
    area = 2 * np.pi * radius / n_around[ring] * (length / n_along)[edge]
    return center + radius[:, None] * normal, normal, radius, area, edge


def _count_up(counts: np.ndarray) -> np.ndarray:
    """0 .. n-1 for each n of ``counts``, joined."""
    ends = np.cumsum(counts)
    return np.arange(ends[-1]) - np.repeat(ends - counts, counts)


def tubes_distance(points, start, end, start_radius, end_radius, step) -> np.ndarray:
    """Signed distance of points (n, 3) to a union of tubes, negative inside, inf if far outside.

    Exact to a few hundredths of a millimetre outside and near the surface; deep inside it is a
    lower bound of the depth.
    """
    length = np.linalg.norm(end - start, axis=1)
    n = np.maximum(np.ceil(length / step).astype(int), 1)
    edge = np.repeat(np.arange(len(n)), n)
    along = (_count_up(n) + 0.5) / n[edge]
    axis = start[edge] + along[:, None] * (end - start)[edge]
    radius = start_radius[edge] * (1 - along) + end_radius[edge] * along
    bins = np.floor(np.log(radius) / np.log(_BIN_RATIO)).astype(int)
    distance = np.full(len(points), np.inf)
    for value in np.unique(bins):
        mine = bins == value
        reach = 1.05 * radius[mine].max() + step
        found, nearest = cKDTree(axis[mine]).query(points, distance_upper_bound=reach, workers=-1)
        hit = np.isfinite(found)
        gap = found[hit] - radius[mine][nearest[hit]]
        distance[hit] = np.minimum(distance[hit], gap)
    return distance


def count_views(surface: TrueSurface, poses: Poses, *, step: float = STEP_M) -> np.ndarray:
    """Photos in which each sample is in frame, turned to the camera and not hidden, (n,) int64.

    A sample is hidden by wood of the same tree that is at least 10 mm nearer in its pixel; other
    trees and things are taken to hide nothing (photographers walk around them).
    """
    n_views = np.zeros(len(surface.points), dtype=np.int64)
    least = np.cos(np.radians(MAX_FACING_DEG))
    for i in range(len(poses)):
        uv, depth = poses[i].project(surface.points)
        size = np.array([poses.width[i], poses.height[i]])
        inside = (depth > 0.05) & (uv >= 0).all(axis=1) & (uv < size).all(axis=1)
        if not inside.any():
            continue
        rays = poses.centers[i] - surface.points[inside]
        facing = np.einsum("ij,ij->i", rays, surface.normals[inside])
        faces = facing > least * np.linalg.norm(rays, axis=1)
        # two samples or more must fall on a cell, else surfaces are full of holes
        per_metre = poses.K[i, 0, 0] / np.median(depth[inside])
        cell = max(1, round(2 * step * per_metre))
        column, row = (uv[inside] // cell).astype(int).T
        nearest = np.full((size[1] // cell + 1, size[0] // cell + 1), np.inf)
        np.minimum.at(nearest, (row, column), depth[inside])
        seen = faces & (depth[inside] < nearest[row, column] + _HIDDEN_M)
        n_views[np.flatnonzero(inside)[seen]] += 1
    return n_views
