"""Silhouettes of a tree's parts from the directions of the sky, by parallel rays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cherrypicker.light.mesh import PartMesh
from cherrypicker.progress import Progress


@dataclass
class Silhouettes:
    """Areas that parts show to the directions, in the square of the mesh's unit."""

    lit: np.ndarray  # (n_directions, n_parts): what nothing stands before
    own: np.ndarray  # (n_directions, n_parts): as if each part stood alone
    step_share: np.ndarray  # (n_steps,): the one over the other by step of the skeleton


def cast_silhouettes(
    mesh: PartMesh,
    directions: np.ndarray,
    *,
    row_step: np.ndarray | None = None,
    n_rays: int = 200_000,
    seed: int = 0,
    threads: int = 1,
) -> Silhouettes:
    """Cast rays from each direction onto a mesh, one in each cell of a grid over its silhouette.

    A neighbour in the row is a copy of the mesh: it stands before a place where the ray, shifted
    back by the way to the neighbour, hits the mesh itself sooner.

    Parameters
    ----------
    mesh : PartMesh
    directions : ndarray of shape (n, 3), float64
        Unit vectors towards the light.
    row_step : ndarray of shape (3,), optional
        Way from one tree of the row to the next; ten stand on either side. Without it the tree
        stands alone.
    n_rays : int, default 200,000
        Cells of the grid, a direction.
    seed : int, default 0
        Of the places of the rays within their cells.
    threads : int, default 1
    """
    import open3d  # takes seconds

    def tensor(array: np.ndarray) -> open3d.core.Tensor:
        return open3d.core.Tensor.from_numpy(array)

    def rays(starts: np.ndarray) -> open3d.core.Tensor:
        lines = np.empty((len(starts), 6), dtype=np.float32)
        lines[:, :3], lines[:, 3:] = starts, -direction
        return tensor(lines)

    scene = open3d.t.geometry.RaycastingScene(nthreads=threads)
    scene.add_triangles(
        tensor(mesh.vertices.astype(np.float32)), tensor(mesh.triangles.astype(np.uint32))
    )
    rng = np.random.default_rng(seed)
    n_parts, n_steps = len(mesh.axis), mesh.step.max() + 1
    lit, own = np.zeros((2, len(directions), n_parts))
    lit_step, own_step = np.zeros((2, n_steps))
    ways = [] if row_step is None else [k * row_step for k in range(-10, 11) if k]
    with Progress(len(directions), "directions of the sky") as progress:
        for number, direction in enumerate(directions):
            across = np.linalg.svd(direction[None])[2][1:]  # (2, 3)
            seen = mesh.vertices @ across.T
            low, size = seen.min(axis=0), np.ptp(seen, axis=0)
            count = np.ceil(size / np.sqrt(size.prod() / n_rays)).astype(int)
            grid = np.indices(count, dtype=np.float32).reshape(2, -1)
            grid += rng.random(grid.shape, dtype=np.float32)
            sides = (size / count)[:, None] * across
            corner = low @ across + (0.01 + (mesh.vertices @ direction).max()) * direction
            starts = grid.T @ sides.astype(np.float32) + corner.astype(np.float32)
            starts = starts[scene.test_occlusions(rays(starts), nthreads=threads).numpy()]
            found = scene.list_intersections(rays(starts), nthreads=threads)
            ray, depth, triangle = (
                found[name].numpy() for name in ("ray_ids", "t_hit", "primitive_ids")
            )
            # The first place of each part on each ray
            key = ray.astype(np.int64) * n_parts + mesh.part[triangle]
            order = np.lexsort([depth, key])
            order = order[np.append(True, np.diff(key[order]) > 0)]
            ray, depth, triangle = ray[order], depth[order], triangle[order]
            free = np.full(len(starts), np.inf)  # how far each ray comes
            np.minimum.at(free, ray, depth)
            for way in ways:
                if (np.abs(across @ way) < size).all():
                    # From so far that the neighbour, too, lies before the ray
                    back = abs(way @ direction)
                    hit = scene.cast_rays(rays(starts - way + back * direction), nthreads=threads)
                    free[hit["t_hit"].numpy() - back < free] = -np.inf
            is_lit = depth <= free[ray]
            part, step = mesh.part[triangle], mesh.step[triangle]
            cell_area = (size / count).prod()
            own[number] = cell_area * np.bincount(part, minlength=n_parts)
            lit[number] = cell_area * np.bincount(part[is_lit], minlength=n_parts)
            own_step += np.bincount(step, minlength=n_steps)
            lit_step += np.bincount(step[is_lit], minlength=n_steps)
            progress.step()
    return Silhouettes(lit, own, np.where(own_step > 0, lit_step / np.maximum(own_step, 1), 1.0))
