"""Silhouettes of a tree's parts from the directions of the sky, by parallel rays."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cherrypicker.light.mesh import PartMesh
from cherrypicker.progress import Progress

N_RAYS = 200_000  # a direction: within 0.02 % of the light by a million, on bare demo trees


@dataclass
class Silhouettes:
    """Areas that parts show to the directions, in the square of the mesh's unit."""

    lit: np.ndarray  # (n_directions, n_parts): what nothing stands before
    own: np.ndarray  # (n_directions, n_parts): as if each part stood alone
    step_share: np.ndarray  # (n_steps,): the one over the other by step of the skeleton


class _Hits(NamedTuple):
    """Where the rays of one direction meet the mesh, by ray and from near to far."""

    ray: np.ndarray  # (n_hits,) int64
    triangle: np.ndarray  # (n_hits,) int64
    is_before_neighbors: np.ndarray  # (n_hits,) bool
    cell_area: float


def cast_silhouettes(
    mesh: PartMesh,
    directions: np.ndarray,
    *,
    row_step: np.ndarray | None = None,
    seed: int = 0,
    threads: int = 1,
) -> Silhouettes:
    """Cast rays from each direction onto a mesh, one in each cell of a grid over its silhouette.

    A neighbour in the row is a copy of the mesh: it stands before a place where the ray, shifted
    back by the way to the neighbour, hits the mesh itself sooner.

    Parameters
    ----------
    directions : ndarray of shape (n, 3), float64
        Unit vectors towards the light.
    row_step : ndarray of shape (3,), optional
        Way from one tree of the row to the next; ten stand on either side. Without it the tree
        stands alone.
    seed : int, default 0
        Of the places of the rays within their cells.
    """
    n_parts, n_steps = len(mesh.axis), mesh.step.max() + 1
    lit, own = np.zeros((2, len(directions), n_parts))
    lit_step, own_step = np.zeros((2, n_steps))
    found = _cast(mesh, mesh.part, directions, row_step, seed, threads)
    for number, hits in enumerate(found):
        is_lit = hits.is_before_neighbors & np.append(True, np.diff(hits.ray) > 0)
        part, step = mesh.part[hits.triangle], mesh.step[hits.triangle]
        own[number] = hits.cell_area * np.bincount(part, minlength=n_parts)
        lit[number] = hits.cell_area * np.bincount(part[is_lit], minlength=n_parts)
        own_step += np.bincount(step, minlength=n_steps)
        lit_step += np.bincount(step[is_lit], minlength=n_steps)
    return Silhouettes(lit, own, np.where(own_step > 0, lit_step / np.maximum(own_step, 1), 1.0))


def cast_cuts(
    mesh: PartMesh,
    directions: np.ndarray,
    cut_of_step: np.ndarray,
    weights: np.ndarray,
    *,
    row_step: np.ndarray | None = None,
    threads: int = 1,
) -> tuple[np.ndarray, np.ndarray]:
    """What parts show to the directions before any cut and after each, from the same rays.

    The neighbours in the row stay as they are.

    Parameters
    ----------
    mesh, directions, row_step, threads
        As of `cast_silhouettes`.
    cut_of_step : ndarray of shape (n_steps,), int64
        With which cut, from 0, each step of the skeleton goes; their number for what stays.
    weights : ndarray of shape (n_sums, n_directions), float64
        What comes from each direction onto a surface across it, for each sum over the directions.

    Returns
    -------
    lit, own : ndarray of shape (n_sums, n_cuts + 1, n_parts) and (n_cuts + 1, n_parts), float64
        As of `Silhouettes`, summed over the directions, what is lit with their weights.
    """
    n_cuts, n_parts = int(cut_of_step.max()), len(mesh.axis)
    goes = cut_of_step[mesh.step]
    lit, own = np.zeros((len(weights), n_cuts + 2, n_parts)), np.zeros((n_cuts + 2, n_parts))
    group = mesh.part * (n_cuts + 1) + goes
    found = _cast(mesh, group, directions, row_step, 0, threads)
    for hits, weight in zip(found, weights.T, strict=True):
        part, cut, near = mesh.part[hits.triangle], goes[hits.triangle], hits.is_before_neighbors
        seen = _changes(own.shape, hits.ray[near], part[near], cut[near])
        lit += hits.cell_area * weight[:, None, None] * seen
        of_part = hits.ray * n_parts + part
        order = np.argsort(of_part, kind="stable")
        own += hits.cell_area * _changes(own.shape, of_part[order], part[order], cut[order])
    return lit.cumsum(axis=1)[:, :-1], own.cumsum(axis=0)[:-1]


def _changes(
    shape: tuple[int, ...], key: np.ndarray, part: np.ndarray, cut: np.ndarray
) -> np.ndarray:
    """Rays more that meet each part with each cut, (n_cuts + 2, n_parts).

    A place comes to light with the last cut of what lies before it, and goes with its own. The
    places (n,) lie by ascending key, and of one key from near to far.
    """
    # The last cut of what lies before each: the keys' runs lie apart by more than all cuts
    run = np.cumsum(np.append(0, np.diff(key) > 0)) * shape[0]
    before = np.append(0, np.maximum.accumulate(run + cut + 1)[:-1]) - run
    comes = np.maximum(before, 0)
    rows = comes <= cut
    at = np.concatenate([comes[rows], cut[rows] + 1]) * shape[1]
    signs = np.repeat([1.0, -1.0], np.count_nonzero(rows))
    flat = np.bincount(at + np.tile(part[rows], 2), signs, minlength=shape[0] * shape[1])
    return flat.reshape(shape)


def _cast(
    mesh: PartMesh,
    group: np.ndarray,
    directions: np.ndarray,
    row_step: np.ndarray | None,
    seed: int,
    threads: int,
) -> Iterator[_Hits]:
    """The first place of each group of triangles on each ray, a direction after the other."""
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
    ways = [] if row_step is None else [k * row_step for k in range(-10, 11) if k]
    with Progress(len(directions), "directions of the sky") as progress:
        for direction in directions:
            across = np.linalg.svd(direction[None])[2][1:]  # (2, 3)
            seen = mesh.vertices @ across.T
            low, size = seen.min(axis=0), np.ptp(seen, axis=0)
            count = np.ceil(size / np.sqrt(size.prod() / N_RAYS)).astype(int)
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
            key = ray.astype(np.int64) * (group.max() + 1) + group[triangle]
            order = np.lexsort([depth, key])
            order = order[np.append(True, np.diff(key[order]) > 0)]
            order = order[np.lexsort([depth[order], ray[order]])]
            free = np.full(len(starts), np.inf)  # how far each ray comes past the neighbours
            for way in ways:
                if (np.abs(across @ way) < size).all():
                    # From so far that the neighbour, too, lies before the ray
                    back = abs(way @ direction)
                    hit = scene.cast_rays(rays(starts - way + back * direction), nthreads=threads)
                    free = np.minimum(free, hit["t_hit"].numpy() - back)
            rows = ray[order].astype(np.int64)
            is_before = depth[order] <= free[rows]
            yield _Hits(rows, triangle[order], is_before, float((size / count).prod()))
            progress.step()
