"""A small finished tree as a results folder: four laterals, one of them on another."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cherrypicker.classes import Label
from cherrypicker.files import write_json, write_text
from cherrypicker.pointcloud import PointCloud, write_cloud
from cherrypicker.skeleton import Skeleton, axes, write_skeleton_graphml
from cherrypicker.traits.branches import branch_rows, branches_csv

# Of each axis: node that it hangs on, first and last place, radii there, nodes
_LIMBS = [
    (-1, (0, 0, 0), (0.05, 0, 1.4), 0.03, 0.012, 60),
    (20, None, (0.5, 0.1, 0.9), 0.010, 0.004, 30),
    (30, None, (-0.4, 0.3, 1.1), 0.012, 0.005, 25),
    (40, None, (-0.1, -0.5, 1.3), 0.008, 0.003, 30),
    (75, None, (0.45, -0.3, 0.85), 0.004, 0.002, 15),
]
WIDER = 1.1  # what the photos make of the second axis's diameters


def small_skeleton() -> Skeleton:
    """Curved axes that hang on one another, none straight."""
    points, parent, radius = [], [], []
    for foot, first, last, thick, thin, count in _LIMBS:
        start = np.array(points[foot] if first is None else first, float)
        share = np.linspace(0.0, 1.0, count + (foot >= 0))[int(foot >= 0) :, None]
        bend = 0.06 * np.sin(np.pi * share) * np.array([0.3, -0.5, 0.8])
        parent += [foot, *range(len(points), len(points) + count - 1)]
        points += list(start + share * (np.array(last) - start) + bend)
        radius += list(thick + share[:, 0] * (thin - thick))
    label = [int(Label.TRUNK)] * _LIMBS[0][-1]
    label += [int(Label.BRANCH)] * (len(points) - len(label))
    fields = {"arc_deg": np.full(len(points), 180.0), "n_points": np.full(len(points), 50)}
    return Skeleton(points, parent, radius, label, fields)


def surface_cloud(skeleton: Skeleton, seed: int = 0) -> tuple[PointCloud, np.ndarray]:
    """Points on the tubes, with ground, and the axis that each is of (-1 for the ground)."""
    rng = np.random.default_rng(seed)
    points, owner = (
        [rng.uniform((-0.5, -0.5, -0.01), (0.5, 0.5, 0.0), (500, 3))],
        [np.full(500, -1)],
    )
    for index, axis in enumerate(axes(skeleton)):
        nodes = axis.nodes[1:]
        rows = rng.choice(nodes, 400)
        share = rng.random(400)[:, None]
        ends = skeleton.points[rows], skeleton.points[skeleton.parent[rows]]
        across = np.cross(ends[1] - ends[0], rng.normal(size=(400, 3)))
        across /= np.linalg.norm(across, axis=1)[:, None]
        points.append(
            ends[0] + share * (ends[1] - ends[0]) + skeleton.radius[rows][:, None] * across
        )
        owner.append(np.full(400, index))
    owner = np.concatenate(owner)
    label = np.where(owner < 0, Label.GROUND, np.where(owner == 0, Label.TRUNK, Label.BRANCH))
    cloud = PointCloud(np.concatenate(points), fields={"label": label.astype(np.uint8)})
    return cloud, owner


def write_finished_tree(folder: Path) -> Skeleton:
    """Write what the exports and pages read of a tree's results."""
    folder.mkdir(parents=True)
    skeleton = small_skeleton()
    axis_list = axes(skeleton)
    widths = 2 * WIDER * skeleton.radius[axis_list[1].nodes]
    shown = {"branch_id": 1, "diameter": widths.mean(), "diameter_se": 1e-5}
    seen = {"branches": [shown | {"widths": widths.tolist()}]}
    rows = branch_rows(skeleton, axis_list, 0.0, photo_check=seen)
    write_skeleton_graphml(folder / "skeleton.graphml", skeleton)
    write_json(folder / "photo_check.json", seen)
    write_text(folder / "branches.csv", branches_csv(rows))
    write_cloud(folder / "segmented.ply", surface_cloud(skeleton)[0])
    volume = sum(row["volume_m3"] for row in rows)
    length = float(skeleton.edge_length.sum())
    write_json(folder / "traits.json", {"wood_volume_m3": volume, "total_length_m": length})
    write_text(folder / "report.html", f"<title>{folder.name}</title>")
    return skeleton
