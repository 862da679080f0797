"""Laser scans of real trees with what truth comes with them: weak labels, or none but "all wood".

The labels come from skeletons that other tools fitted to the same clouds, so they hold where those
do; a scan of one tree cut free has no ground and no things, so that every label but trunk and
branch is wrong there.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import Label
from cherrypicker.pointcloud import PointCloud, read_cloud
from cherrypicker.skeleton.axes import node_order
from cherrypicker.skeleton.csv_table import read_skeleton_csv

STEP = 0.25  # of a node's radius at least: how finely an edge is sampled
MOST_STEPS = 200


@dataclass(frozen=True)
class Scan:
    """A published laser scan of a leafless tree or branch."""

    cloud: str  # PLY below the folder of the clouds
    unit_m: float = 1.0  # length of the file's unit
    # "label" for a field of the cloud, a CSV of a skeleton (id, parent, x, y, z, radius), or ""
    # where nothing but "all of it is wood" is known
    truth: str = ""


SCANS = (
    Scan("archi/Tree_2_dense_qsmlabel.ply", truth="label"),
    Scan("archi/Tree_1_point_cloud.ply", truth="archi/Tree_1_qsm_skeleton.csv"),
    Scan("plantscan3d/puu1.ply", 0.001, "plantscan3d/puu1_skeleton.csv"),
    *(
        Scan(f"adtree/{name}.ply")
        for name in (
            "Lille_11", "Lille_2", "Paris_Luxembourg_1", "tree1", "tree13", "tree33", "tree7"
        )
    ),
    *(Scan(f"vezy_branches/{n}.ply") for n in ("A1B2", "A3B4", "A4B5", "A5B8", "A6B10", "A6B9")),
)  # fmt: skip


def wood_by_order(points, skeleton):
    """Trunk where the nearest wood surface of a skeleton is of order 0, else branch, (n,) uint8.

    The points (n, 3) are in the skeleton's frame.
    """
    order = node_order(skeleton)
    nodes = np.arange(1, len(skeleton))
    wanted = skeleton.edge_length[nodes] / np.maximum(STEP * skeleton.radius[nodes], 1e-4)
    steps = np.clip(np.ceil(wanted), 1, MOST_STEPS).astype(int)
    rows = np.repeat(nodes, steps)
    share = (np.arange(steps.sum()) - np.repeat(np.cumsum(steps) - steps, steps)) / steps[rows - 1]
    start, end = skeleton.points[rows], skeleton.points[skeleton.parent[rows]]
    places = start + share[:, None] * (end - start)
    distance, nearest = cKDTree(places).query(points, k=8, workers=1)
    off = distance - skeleton.radius[rows][nearest]
    best = np.take_along_axis(nearest, np.abs(off).argmin(axis=1)[:, None], axis=1)[:, 0]
    return np.where(order[rows[best]] == 0, Label.TRUNK, Label.BRANCH).astype(np.uint8)


def read_scan(scan, folder):
    """The cloud of a scan in metres and its weak labels (n,) uint8, or None where it has none.

    Raises a `StageError` if a file is missing or broken.
    """
    folder = Path(folder)
    cloud = read_cloud(folder / scan.cloud)
    points = cloud.points * scan.unit_m
    metric = PointCloud(points - points.min(axis=0), colors=cloud.colors)
    if scan.truth == "label":
        return metric, cloud["label"].astype(np.uint8)
    if not scan.truth:
        return metric, None
    return metric, wood_by_order(points, read_skeleton_csv(folder / scan.truth, scan.unit_m))
