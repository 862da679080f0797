"""Exact depth maps of a generated scene, by casting rays at its true surfaces.

The truth of any generated scene says what is needed: ``truth/skeleton.csv`` holds the target tree
as tapered tubes around its skeleton, which is how it was meshed, and ``truth/cloud.ply`` samples
the ground and all other things, which become a triangulated ground and a small square per sample.
So the target is exact to the width of a facet and its surroundings to the distance of the samples.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from scipy.spatial import Delaunay, cKDTree

from cherrypicker.classes import Label, wood_mask
from cherrypicker.formats.measured import MeasuredTree
from cherrypicker.light.mesh import wood_mesh
from cherrypicker.pointcloud import read_cloud
from cherrypicker.poses import View
from cherrypicker.skeleton import axes, read_skeleton_csv

#: Half the side of a sample's square, in distances to its neighbours: squares close the surface.
SQUARE_REACH = 0.8
#: Neighbours that a sample's plane is fitted to.
N_NEIGHBORS = 16
#: No triangle of the ground is longer, in median edges: it would bridge a hole.
LONGEST_EDGE = 8.0
#: Rows of rays cast at a time; bounds the memory.
ROWS_AT_A_TIME = 256


def ground_mesh(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangulate ground samples, (n, 3), over the plane; long triangles are left out."""
    if len(points) < 4:
        return np.empty((0, 3)), np.empty((0, 3), np.int64)
    faces = Delaunay(points[:, :2]).simplices.astype(np.int64)
    corners = points[faces]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    return points, faces[edges.max(axis=1) <= LONGEST_EDGE * np.median(edges)]


def square_mesh(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lay a square on the local plane of each surface sample, (n, 3)."""
    if len(points) <= N_NEIGHBORS:
        return np.empty((0, 3)), np.empty((0, 3), np.int64)
    distance, near = cKDTree(points).query(points, k=N_NEIGHBORS + 1)
    offsets = points[near] - points[near].mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))
    half = SQUARE_REACH * np.median(distance[:, 1:4], axis=1)[:, None]
    a, b = half * axes[:, :, 2], half * axes[:, :, 1]
    corners = np.stack([points - a - b, points + a - b, points + a + b, points - a + b], axis=1)
    first = 4 * np.arange(len(points))[:, None]
    faces = np.concatenate([first + [0, 1, 2], first + [0, 2, 3]])
    return corners.reshape(-1, 3), faces


class TrueScene:
    """The true surfaces of a generated scene, to cast rays at.

    They are made of ``skeleton.csv`` and ``cloud.ply`` in ``{scene}/truth``; a `StageError` is
    raised if one of the files is missing or broken.
    """

    def __init__(self, truth: str | os.PathLike):
        truth = Path(truth)
        cloud = read_cloud(truth / "cloud.ply", required=("label", "tree"))
        is_wood = wood_mask(cloud["label"])
        is_ground = cloud["label"] == Label.GROUND
        is_other = ~is_ground & ~(is_wood & (cloud["tree"] == 0))
        skeleton = read_skeleton_csv(truth / "skeleton.csv")
        wood = wood_mesh(MeasuredTree("", skeleton, axes(skeleton)))
        import open3d as o3d  # takes seconds to import

        self._o3d = o3d
        self._scene = o3d.t.geometry.RaycastingScene()
        for vertices, faces in (
            (wood.vertices, wood.triangles),
            ground_mesh(cloud.points[is_ground]),
            square_mesh(cloud.points[is_other]),
        ):
            if len(faces):
                self._scene.add_triangles(
                    o3d.core.Tensor(vertices.astype(np.float32)),
                    o3d.core.Tensor(faces.astype(np.uint32)),
                )

    def depth(self, view: View, threads: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Depth and normals that an undistorted photo with a true camera shows, both float32.

        The view is in the scene's metric frame; 0 threads are all. Depth (height, width) lies along
        the optical axis, normals (height, width, 3) are in the camera's frame, towards the camera;
        both are 0 where nothing is.
        """
        depth = np.zeros((view.height, view.width), np.float32)
        normals = np.zeros((view.height, view.width, 3), np.float32)
        columns = np.arange(view.width) + 0.5
        to_ray = np.linalg.inv(view.K)
        for top in range(0, view.height, ROWS_AT_A_TIME):
            rows = np.arange(top, min(top + ROWS_AT_A_TIME, view.height)) + 0.5
            x, y = np.meshgrid(columns, rows)
            in_camera = np.stack([x, y, np.ones_like(x)], axis=-1) @ to_ray.T
            rays = np.empty((*x.shape, 6), np.float32)
            rays[..., :3] = view.center
            rays[..., 3:] = in_camera @ view.R  # depth 1 along the optical axis
            hit = self._scene.cast_rays(self._o3d.core.Tensor(rays), nthreads=threads)
            found = hit["t_hit"].numpy()
            is_hit = np.isfinite(found)
            normal = hit["primitive_normals"].numpy() @ view.R.T.astype(np.float32)
            away = np.einsum("hwi,hwi->hw", normal, in_camera) > 0
            normal[away] *= -1
            band = slice(top, top + len(rows))
            depth[band] = np.where(is_hit, found, 0)
            normals[band] = np.where(is_hit[..., None], normal, 0)
        return depth, normals
