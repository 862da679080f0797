"""Readers of clouds, arrays, graphs and models, with valid files to spoil."""

import numpy as np
import pycolmap
import torch
from finished_tree import write_finished_tree
from fuzz_bench import Reader
from reliability_scene import table_of, write_ply
from workspace import small_tree

from cherrypicker.accuracy.digitised import read_digitised
from cherrypicker.batch.resources import count_points
from cherrypicker.batch.trees import Tree
from cherrypicker.formats.measured import read_measured_tree
from cherrypicker.formats.mtg import write_mtg
from cherrypicker.intake.clouds import import_cloud
from cherrypicker.lens import read_model
from cherrypicker.limbs.files import read_orchard, write_orchard
from cherrypicker.limbs.growth import Limbs
from cherrypicker.limbs.orchard import Orchard
from cherrypicker.limbs.tubes import Limb, Tube
from cherrypicker.mvs.workspace import read_map, write_map
from cherrypicker.pointcloud import PointCloud, read_cloud, write_cloud
from cherrypicker.poses import Poses, read_poses, write_poses
from cherrypicker.segmentation.dgcnn import Dgcnn, load_weights
from cherrypicker.sfm.database import copy_database
from cherrypicker.skeleton import (
    Skeleton,
    read_skeleton,
    write_skeleton_graphml,
)
from cherrypicker.skeleton.csv_table import read_skeleton_csv
from cherrypicker.sky.colors import SkyColors, read_sky_colors, write_sky_colors
from cherrypicker.sky.unet import SkyUNet
from cherrypicker.sky.unet import load_weights as load_sky_weights
from cherrypicker_lab.training.segmentation.weights import save_weights
from cherrypicker_lab.training.sky.training import save_weights as save_sky_weights


def _cloud(n_points=60):
    cloud = small_tree(0, n_points=400).select(np.arange(n_points))
    colors = np.linspace(0, 1, 3 * n_points).reshape(-1, 3)
    return PointCloud(cloud.points, colors, fields=cloud.fields)


def _plys(folder):
    cloud = _cloud()
    write_cloud(folder / "own.ply", cloud)
    for encoding in ("ascii", "binary_big_endian"):
        write_ply(folder / f"{encoding}.ply", table_of(cloud), encoding)
    return sorted(folder.glob("*.ply"))


def _las(folder):
    import laspy

    cloud = _cloud()
    for version, kind, suffix in (("1.2", 2, "las"), ("1.4", 7, "las"), ("1.4", 7, "laz")):
        header = laspy.LasHeader(version=version, point_format=kind)
        header.scales = np.full(3, 1e-4)
        las = laspy.LasData(header)
        las.xyz = cloud.points
        las.red, las.green, las.blue = (cloud.colors * 65535).astype(np.uint16).T
        las.write(folder / f"{version}.{suffix}")
    return sorted(folder.glob("1.*"))


def _texts(folder):
    points = _cloud(20).points
    rows = [" ".join(f"{value:.4f}" for value in point) for point in points]
    (folder / "a.xyz").write_text("\n".join(rows))
    (folder / "b.csv").write_text(
        "x,y,z,r,g,b\n" + "".join(f"{row.replace(' ', ',')},10,200,30\n" for row in rows)
    )
    return [folder / "a.xyz", folder / "b.csv"]


def _skeleton():
    points = np.array([[0, 0, 0], [0, 0, 0.5], [0, 0, 1], [0.3, 0, 0.7], [0.5, 0, 0.9]])
    parent = np.array([-1, 0, 1, 1, 3])
    fields = {"n_points": np.arange(5), "gap": np.array([0, 0, 0, 1, 0])}
    return Skeleton(points, parent, np.linspace(0.03, 0.01, 5), np.ones(5), fields)


def _skeletons(folder):
    write_skeleton_graphml(folder / "skeleton.graphml", _skeleton())
    return [folder / "skeleton.graphml"]


def _skeleton_tables(folder):
    rows = ["id,parent,x,y,z,radius,order,label", "1,-1,0,0,0,0.03,0,1", "2,1,0,0,0.5,,0,1"]
    (folder / "a.csv").write_text("\n".join([*rows, "3,2,0.1,0,0.7,0.01,1,2", ""]))
    return [folder / "a.csv"]


def _digitised(folder):
    write_finished_tree(folder / "tree")
    write_mtg(folder / "tree.mtg", read_measured_tree(folder / "tree"))
    (folder / "b.csv").write_text("id;parent;x;y;z;diameter\n1;;0;0;0;0,06\n2;1;0;0;0,5;0,05\n")
    return [folder / "tree.mtg", folder / "b.csv"]


def _poses(folder):
    n = 3
    pose = np.tile(np.eye(3, 4), (n, 1, 1))
    K = np.tile(np.diag([300.0, 300.0, 1.0]), (n, 1, 1))
    names = np.array([f"photo {i}.jpg" for i in range(n)])
    write_poses(folder / "poses.npz", Poses(names, pose, K, np.full(n, 320), np.full(n, 240)))
    return [folder / "poses.npz"]


def _limbs(folder):
    tube = Tube(np.linspace([0, 0, 0], [0, 0, 1.0], 4), np.full(4, 0.02))
    limbs = Limbs([Limb(tube, -1), Limb(tube, 0)], np.zeros(7, np.int64), 0.01, 0.002, 0.9)
    owner, rows = np.array([0] * 7 + [1, -1]), np.arange(7)
    bases = np.array([[0.0, 0, 0], [1, 0, 0]])
    orchard = Orchard(owner, rows, 0.01, bases, [rows, rows[:0]], [limbs, None])
    write_orchard(folder / "limbs.npz", orchard)
    return [folder / "limbs.npz"]


def _sky_colors(folder):
    colors = SkyColors(np.full((4, 3), 0.5, np.float32), np.zeros(4, np.int32), np.ones(1), 9)
    write_sky_colors(folder / "sky_colors.npz", colors)
    return [folder / "sky_colors.npz"]


def _maps(folder):
    write_map(folder / "depth.bin", np.ones((6, 8)))
    write_map(folder / "normal.bin", np.ones((6, 8, 3)))
    return [folder / "depth.bin", folder / "normal.bin"]


def _synthetic(folder):
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_frames_per_rig, options.num_points3D = 1, 3, 12
    database = pycolmap.Database.open(folder / "database.db")
    model = pycolmap.synthesize_dataset(options, database)
    database.close()
    return model


def _models(folder):
    _synthetic(folder).write_binary(folder)
    return sorted(folder.glob("*.bin"))


def _databases(folder):
    _synthetic(folder)
    return [folder / "database.db"]


def _sky_weights(folder):
    torch.manual_seed(0)
    save_sky_weights(folder / "sky.npz", SkyUNet((2, 3)))
    return [folder / "sky.npz"]


def _cloud_weights(folder):
    torch.manual_seed(0)
    network = Dgcnn(width=4, embedding=4, scales=(0, 1), k=2)
    save_weights(folder / "dgcnn.pt", network, {"voxel_size_m": 0.01})
    return [folder / "dgcnn.pt"]


def read_map_of(path):
    return read_map(path, (8, 6), 3 if b"&3&" in path.read_bytes()[:12] else 1)


def read_model_of(path):
    return read_model(path.parent)


def copied_database(path):
    return copy_database(path, path.with_name("copy.db"))


def read_labelled(path):
    return read_cloud(path, required=("label",))


def imported(path):
    return import_cloud(path, scale="none")


def size_at_the_start(path):
    """What Snakemake's own process reads of a ready cloud, which must not stop the batch."""
    return count_points(path), Tree("a", cloud=str(path)).has_labelled_cloud()


READERS = [
    Reader("ply", imported, _plys),
    Reader("own_ply", read_labelled, _plys),
    Reader("las", imported, _las, needs="laspy"),
    Reader("text_cloud", imported, _texts),
    Reader("cloud_at_the_start", size_at_the_start, lambda folder: _plys(folder) + _las(folder)),
    Reader("skeleton", read_skeleton, _skeletons),
    Reader("skeleton_table", read_skeleton_csv, _skeleton_tables),
    Reader("digitised", read_digitised, _digitised),
    Reader("poses", read_poses, _poses),
    Reader("limbs", read_orchard, _limbs),
    Reader("sky_colors", read_sky_colors, _sky_colors),
    Reader("map", read_map_of, _maps),
    Reader("model", read_model_of, _models),
    Reader("sky_weights", load_sky_weights, _sky_weights),
    Reader("cloud_weights", load_weights, _cloud_weights),
    Reader("database", copied_database, _databases),
]
