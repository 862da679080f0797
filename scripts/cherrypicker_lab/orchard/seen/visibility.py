"""Which photos see a point of a scene, and from which of them it comes."""

import numpy as np
from numba import njit

CELL_PX = 4
OCCLUDER_RADIUS_M = 0.006
MARGIN_M = 0.005
LEAST_COSINE = np.cos(np.radians(80.0))


@njit(cache=True)
def _fill(buffers, rotations, offsets, focal, nodes, radii, width, height, cell):
    for c in range(len(rotations)):
        rows, columns = buffers.shape[1], buffers.shape[2]
        for n in range(len(nodes)):
            x, y, z = rotations[c] @ nodes[n] + offsets[c]
            if z < 0.1:
                continue
            u = (focal[c] * x / z + 0.5 * width[c]) / cell
            v = (focal[c] * y / z + 0.5 * height[c]) / cell
            reach = focal[c] * radii[n] / z / cell
            for row in range(max(int(v - reach), 0), min(int(v + reach) + 1, rows)):
                for column in range(max(int(u - reach), 0), min(int(u + reach) + 1, columns)):
                    if (row + 0.5 - v) ** 2 + (column + 0.5 - u) ** 2 > reach**2 + 0.1:
                        continue
                    buffers[c, row, column] = min(buffers[c, row, column], z)


@njit(cache=True)
def _choose(
    points, normals, rotations, offsets, centers, focal, width, height, buffers, cell, draws,
    margin, least,
):  # fmt: skip
    n_views = np.zeros(len(points), np.int64)
    chosen = np.full(len(points), -1, np.int64)
    for i in range(len(points)):
        total = 0.0
        draw = draws[i]
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        for c in range(len(rotations)):
            rx, ry, rz = centers[c, 0] - px, centers[c, 1] - py, centers[c, 2] - pz
            dot = rx * nx + ry * ny + rz * nz
            squared = rx * rx + ry * ry + rz * rz
            if dot <= 0 or dot * dot < least * least * squared:
                continue
            # the parts of one array one by one: a view of it costs more than the sum
            r, t = rotations, offsets
            z = r[c, 2, 0] * px + r[c, 2, 1] * py + r[c, 2, 2] * pz + t[c, 2]
            if z < 0.1:
                continue
            x = r[c, 0, 0] * px + r[c, 0, 1] * py + r[c, 0, 2] * pz + t[c, 0]
            y = r[c, 1, 0] * px + r[c, 1, 1] * py + r[c, 1, 2] * pz + t[c, 1]
            u = focal[c] * x / z + 0.5 * width[c]
            v = focal[c] * y / z + 0.5 * height[c]
            if u < 0 or v < 0 or u >= width[c] or v >= height[c]:
                continue
            if z > buffers[c, int(v / cell), int(u / cell)] + margin:
                continue
            n_views[i] += 1
            # one photo by weight, in one pass: the draw is stretched over what it still means
            weight = dot / (squared * np.sqrt(squared))
            total += weight
            share = weight / total
            if draw < share:
                chosen[i] = c
                draw = draw / share
            else:
                draw = (draw - share) / (1.0 - share)
    return n_views, chosen


def choose_views(rng, points, normals, poses, nodes, radii):
    """Count the photos that see each point and choose one of them.

    A photo sees a point that is in frame, turned to it by less than 80 degrees and not behind wood
    of at least 6 mm radius. It is chosen by the weight cos(angle) / distance^2, the number of its
    pixels that a piece of surface fills.

    Points (m) and unit normals are (n, 3), the poses pinholes with the principal point in the
    middle. Nodes (m, 3), one a centimetre, and radii (m,) are of all trees' skeletons, m. Both
    results are (n,) int64; the chosen photo is an index into `poses`, -1 where no photo sees the
    point.
    """
    focal = np.ascontiguousarray(poses.K[:, 0, 0])
    width, height = poses.width.astype(np.int64), poses.height.astype(np.int64)
    rotations = np.ascontiguousarray(poses.rotations)
    offsets = np.ascontiguousarray(poses.cam_from_world[:, :, 3])
    shape = (len(poses), int(height.max()) // CELL_PX + 1, int(width.max()) // CELL_PX + 1)
    buffers = np.full(shape, np.inf, np.float32)
    thick = radii >= OCCLUDER_RADIUS_M
    _fill(
        buffers, rotations, offsets, focal, np.ascontiguousarray(nodes[thick]), radii[thick],
        width, height, CELL_PX,
    )  # fmt: skip
    return _choose(
        np.ascontiguousarray(points), np.ascontiguousarray(normals), rotations, offsets,
        np.ascontiguousarray(poses.centers), focal, width, height, buffers, CELL_PX,
        rng.random(len(points)), MARGIN_M, LEAST_COSINE,
    )  # fmt: skip
