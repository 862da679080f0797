"""Voxels and samples of point sets: members and means, one point a voxel, farthest points."""

import numpy as np

from cherrypicker.compiled import compiled

LEAST_GROWTH = 1.05  # of voxels that leave too many points
# Points that `draw_evenly` leaves for each voxel of a block, and voxels across a block: of 1, 1.25,
# 1.5 and 2 points, 16 and 32 voxels (docs/lab/skeleton.md, Time and memory)
DRAWN_A_VOXEL, VOXELS_ACROSS_BLOCK = 1.5, 32
_DRAWS = 26  # the stream of draws: a cloud made with a seed may not be drawn by its own numbers


def thin_randomly(rows: np.ndarray, n_most: int, seed: int = 0) -> np.ndarray:
    """At most so many rows of an array, drawn at random and left in their order."""
    if len(rows) <= n_most:
        return rows
    return rows[np.sort(np.random.default_rng(seed).choice(len(rows), n_most, replace=False))]


def voxel_keys(points: np.ndarray, size: float) -> np.ndarray:
    """Number of the voxel of each point, (n_points,) int64, on a grid from the lowest corner."""
    cells = np.floor((points - points.min(axis=0)) / size).astype(np.int64)
    shape = cells.max(axis=0) + 1
    return (cells[:, 0] * shape[1] + cells[:, 1]) * shape[2] + cells[:, 2]


def voxel_sample(points: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Group points (n_points, 3) by the voxels of a cubic grid, whose edge has their unit.

    Returns
    -------
    centers : ndarray of shape (n_voxels, 3), float64
        Mean of the points of each voxel.
    inverse : ndarray of shape (n_points,), int64
        Voxel of each point.
    counts : ndarray of shape (n_voxels,), int64
    """
    keys = voxel_keys(points, size)
    _, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
    return voxel_mean(points, inverse, counts), inverse, counts


def voxel_mean(values: np.ndarray, inverse: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Mean over the voxels of `voxel_sample`, (n_points, C) to (n_voxels, C) float64."""
    sums = [np.bincount(inverse, column, len(counts)) for column in values.T]
    return np.stack(sums, axis=1) / counts[:, None]


def voxel_thin(points: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Thin points (n_points, 3) to one a voxel, whose edge has their unit.

    Returns
    -------
    means : ndarray of shape (n_kept, 3), float64
        Mean position of the points of each voxel: it averages the noise of the surface.
    source : ndarray of shape (n_kept,), int64
        Row of the point nearest to each mean, increasing.
    member : ndarray of shape (n_points,), int64
        Row in `means` that each point went into.
    """
    points = np.asarray(points, dtype=np.float64)
    means, member, count = voxel_sample(points, size)
    offset = np.square(points - means[member]).sum(axis=1)
    by_offset = np.lexsort((offset, member))
    source = by_offset[np.cumsum(count) - count]
    order = np.argsort(source)
    return means[order], source[order], np.argsort(order)[member]


def thin_to_limit(
    points: np.ndarray, size: float, max_points: int, *, by_chance: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """`voxel_thin` with voxels of `size`, enlarged until at most `max_points` are left.

    Points (n_points, 3) and size have one unit. With `by_chance`, where all points leave too many
    means, those that `draw_evenly` leaves are taken.

    Returns
    -------
    means, source, member : ndarray
        As `voxel_thin`; `member` is -1 where a point was not drawn.
    size : float
        The voxel edge that was used.
    """
    drawn, may_grow = np.arange(len(points)), not by_chance
    while (n_voxels := _count_voxels(points[drawn], size)) > max_points:
        if may_grow:  # points lie on surfaces: their number falls with the square of the voxel size
            size *= max(LEAST_GROWTH, float(np.sqrt(n_voxels / max_points)))
        if by_chance:
            drawn, may_grow = draw_evenly(points, size), True
    means, source, voxel = voxel_thin(points[drawn], size)
    member = np.full(len(points), -1)
    member[drawn] = voxel
    return means, drawn[source], member, size


def _count_voxels(points: np.ndarray, size: float) -> int:
    return 1 + int(np.count_nonzero(np.diff(np.sort(voxel_keys(points, size)))))


def draw_evenly(points: np.ndarray, size: float) -> np.ndarray:
    """Points drawn by chance, in each block at most ``DRAWN_A_VOXEL`` a voxel that is not empty.

    One point a voxel alone makes a dense noisy cloud noisier: voxels finer than the noise keep a
    point wherever there is one, and the few that err far count as much as the many that do not.
    What chance leaves of a block errs as its points did. A block is many voxels wide, so that
    whole sections with their noise lie in one and the clumps of a cloud from photos are not evened
    out; sparse wood keeps its points beside dense wood of another block.

    Returns
    -------
    ndarray of shape (n_drawn,), int64
        Rows of `points`, increasing; the same ones at every call.
    """
    points = np.asarray(points, dtype=np.float64)
    first = np.unique(voxel_keys(points, size), return_index=True)[1]
    _, block, count = voxel_sample(points, VOXELS_ACROSS_BLOCK * size)
    most = np.ceil(DRAWN_A_VOXEL * np.bincount(block[first], minlength=len(count)))
    by_block = np.lexsort((np.random.default_rng([0, _DRAWS]).random(len(points)), block))
    rank = np.arange(len(points)) - np.repeat(np.cumsum(count) - count, count)
    return np.sort(by_block[rank < most[block[by_block]]])


def majority_label(labels: np.ndarray, member: np.ndarray, n_nodes: int) -> np.ndarray:
    """Most frequent class of the points of each node or voxel (the smaller id on a tie)."""
    classes, column = np.unique(labels, return_inverse=True)
    votes = np.bincount(member * len(classes) + column, minlength=n_nodes * len(classes))
    votes = votes.reshape(n_nodes, len(classes))
    return classes[np.argmax(votes, axis=1)].astype(np.int64)


@compiled
def farthest_point_sample(
    points: np.ndarray, spacing: float, first: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Sample points (n_points, 3) greedily, each the farthest from those before.

    It starts at the row `first` and stops when every point lies within the spacing of a sample.

    Returns
    -------
    samples : ndarray of shape (n_samples,), int64
        Rows of the samples, in the order they were taken. Ties go to the lowest row.
    nearest : ndarray of shape (n_points,), int64
        Position in `samples` of each point's nearest sample.
    """
    samples, nearest = np.empty(len(points), np.int64), np.zeros(len(points), np.int64)
    distance = np.full(len(points), np.inf)
    far, n_samples = first, 0
    while n_samples < len(points):
        samples[n_samples] = at = far
        far = 0
        for row in range(len(points)):
            x, y = points[row, 0] - points[at, 0], points[row, 1] - points[at, 1]
            z = points[row, 2] - points[at, 2]
            squared = x * x + y * y + z * z
            if squared < distance[row]:
                distance[row], nearest[row] = squared, n_samples
            if distance[row] > distance[far]:
                far = row
        n_samples += 1
        if distance[far] <= spacing * spacing:
            break
    return samples[:n_samples], nearest
