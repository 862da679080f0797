"""Write a scene's ground truth in the layout that the evaluation reads."""

import csv
from pathlib import Path

import numpy as np

from cherrypicker.files import atomic_path, csv_text, write_json, write_text
from cherrypicker.geometry.hulls import reach_around, width_of
from cherrypicker.pointcloud import write_cloud
from cherrypicker.poses import write_poses
from cherrypicker_lab.orchard.scene.mesh import NO_TREE
from cherrypicker_lab.orchard.seen.sampling import sample_scene

GENERATOR_VERSION = 3  # raised whenever a seed gives another scene: caches are named by it
TRUNK_HEIGHT_M = 0.30


def tree_traits(tree):
    """Exact traits of a tree (metres, foot at the origin).

    They are `height_m`, `trunk_diameter_m` at `trunk_height_m`, `total_length_m`,
    `total_length_5mm_m` (radius of 5 mm and more), `n_tips`, `n_junctions`, `length_by_order_m` and
    `crown_width_m`.
    """
    skeleton = tree.skeleton()
    lengths, children, orders = skeleton.edge_length, skeleton.n_children, skeleton.fields["order"]
    stem = tree.axes[0]
    up = np.maximum.accumulate(stem.points[:, 2])
    return {
        "height_m": float((skeleton.points[:, 2] + skeleton.radius).max()),
        "trunk_diameter_m": float(2 * np.interp(TRUNK_HEIGHT_M, up, stem.radii)),
        "trunk_height_m": TRUNK_HEIGHT_M,
        "total_length_m": float(lengths.sum()),
        "total_length_5mm_m": float(lengths[skeleton.radius >= 0.005].sum()),
        "n_tips": int((children == 0).sum()),
        "n_junctions": int((children > 1).sum()),
        "crown_width_m": width_of_wood(skeleton.points, skeleton.radius),
        "length_by_order_m": {str(k): float(lengths[orders == k].sum()) for k in np.unique(orders)},
    }


def width_of_wood(points, radii):
    """Crown width as the trait defines it, of wood's surface: nodes (n, 3) with radii (n,)."""
    angle = np.radians(np.arange(0.0, 360.0, 10.0))
    around = np.column_stack([np.cos(angle), np.sin(angle)])
    outline = points[:, None, :2] + radii[:, None, None] * around
    return width_of(reach_around(outline.reshape(-1, 2)))


def write_skeleton(path, skeleton):
    """Write a `Skeleton` with ``order`` as the table that `skeleton.read_skeleton_csv` reads."""
    with atomic_path(path) as partial, open(partial, "w", newline="") as handle:
        out = csv.writer(handle, lineterminator="\n")
        out.writerow(["id", "parent", "x", "y", "z", "radius", "order", "label"])
        nodes = skeleton.parent, skeleton.points, skeleton.radius, skeleton.fields["order"]
        for i, (parent, p, r, order, label) in enumerate(zip(*nodes, skeleton.label)):
            xyz = [f"{v:.5f}" for v in p]
            out.writerow([i, parent, *xyz, f"{r:.5f}", order, label])


def write_buds(path, buds):
    """Write a `buds.Buds`: the middle of each, its length, m, and whether it ends its axis."""
    middle = buds.points + 0.5 * buds.length[:, None] * buds.directions
    last = np.zeros(int(buds.axis.max(initial=-1)) + 1)
    np.maximum.at(last, buds.axis, buds.s)
    columns = ("x", "y", "z", "length_m", "is_last")
    table = np.column_stack([middle, buds.length]).round(5).tolist()
    is_last = (buds.s == last[buds.axis]).astype(int).tolist()
    rows = [dict(zip(columns, (*row, end))) for row, end in zip(table, is_last)]
    write_text(path, csv_text(rows, columns))


def write_truth(folder, scene, poses, *, n_points=150_000, extent=3.0, name="", camera=None):
    """Write `poses.npz`, `skeleton.csv`, `cloud.ply`, `traits.json` and `scene.json` of a scene.

    Of a target with buds `buds.csv` too. The scene's `truth` folder is made if missing. The exact
    labelled surface cloud has `n_points` points within `extent` m around the stem. For the record,
    `name` is the preset that the scene came from, and the camera tells the distortion of the lens,
    which the poses of the photos do not tell.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    write_poses(folder / "poses.npz", poses)
    write_skeleton(folder / "skeleton.csv", scene.target.skeleton())
    if scene.target.buds is not None:
        write_buds(folder / "buds.csv", scene.target.buds)
    cloud = sample_scene(
        scene, n_points, exact=True, extent=extent, ground_share=0.3, is_colored=False
    )
    write_cloud(folder / "cloud.ply", cloud)
    write_json(folder / "traits.json", tree_traits(scene.target))
    write_json(
        folder / "scene.json",
        {
            "name": name,
            "seed": scene.seed,
            "generator_version": GENERATOR_VERSION,
            "habit": scene.target.habit,
            "sky": scene.light.sky,
            "markers": scene.markers,
            "stems": scene.offsets.tolist(),
            "options": {k: v for k, v in scene.options.items() if k != "markers"},
            "no_tree": NO_TREE,
            **(
                {"distortion": [camera.k1, camera.k2]}
                if camera and (camera.k1 or camera.k2)
                else {}
            ),
        },
    )
