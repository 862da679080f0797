"""The truth of a generated scene in the place of a stage's output, in the stage's own format.

Each function writes into results that were taken over what a stage would have written there, from
the scene's ``truth``, so that the stages after it are due and run on. It returns its files.
"""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from cherrypicker.classes import Label, wood_mask
from cherrypicker.errors import StageError
from cherrypicker.files import read_json, write_json
from cherrypicker.geometry.similarity import moved
from cherrypicker.mvs.depth_rasters import write_depth_raster
from cherrypicker.mvs.workspace import Workspace
from cherrypicker.pointcloud import read_cloud, write_cloud
from cherrypicker.poses import read_poses, write_poses
from cherrypicker.progress import Progress
from cherrypicker.skeleton import (
    read_skeleton_csv,
    write_skeleton_graphml,
    write_topology_graphml,
)
from cherrypicker_lab.dense.true_cameras import triangulate_true_cameras
from cherrypicker_lab.dense.true_depth import TrueScene
from cherrypicker_lab.dense.truth import sample_skeleton
from cherrypicker_lab.evaluation import at_surface, cameras_beside_truth

#: Distance between samples of the true tree's surface, m.
SURFACE_STEP_M = 0.003

_MODEL = ("cameras.bin", "images.bin", "points3D.bin", "frames.bin", "rigs.bin")
#: Gigabytes that no rung needs: depth maps are made anew or replaced, and fused before later rungs.
_LEFT_BEHIND = ("stereo",)


def take_over(source: Path, target: Path) -> None:
    """Copy the results of a tree, with their times: only what the truth replaces is newer.

    Raises a `StageError` when there are none.
    """
    if not source.is_dir():
        raise StageError("the tree has no results", file=source)
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(source, target, ignore=shutil.ignore_patterns(*_LEFT_BEHIND))


def place_true_poses(
    results: Path, photos: Path, truth: Path, *, seed: int, threads: int
) -> list[Path]:
    """Put the scene's cameras in the place of the sparse model.

    The points are triangulated from the photos' own matches with these cameras held fixed: the
    stereo starts from them, and they must not come from the true surface. Raises a `StageError`
    when a photo has no true pose, or the results as found are not complete.
    """
    model, database = results / "sfm/model", results / "sfm/database.db"
    if not database.is_file():
        raise StageError("the tree's results are not complete", file=database)
    triangulate_true_cameras(
        database, photos, truth / "poses.npz", model, seed=seed, threads=threads
    )
    write_poses(results / "poses.npz", read_poses(truth / "poses.npz"))
    return [results / "poses.npz", *(model / name for name in _MODEL)]


def place_true_depth(results: Path, truth: Path, *, threads: int) -> list[Path]:
    """Put the true depth of every pixel in the place of the depth maps.

    Raises a `StageError` when the results or the truth are not complete.
    """
    workspace, scene = Workspace(results / "dense"), TrueScene(truth)
    shares = {}
    with Progress(len(workspace.views), "true depth maps") as bar:
        for view in workspace.views:
            depth, normals = scene.depth(view, threads)
            workspace.write_maps(view, "geometric", depth, normals)
            write_depth_raster(results / "depth", view.name, depth)
            shares[view.name] = float((depth > 0).mean())
            bar.step()
    workspace.write_fusion_config()
    manifest = {"backend": "truth", "options": {}, "maps": list(shares), "share_with_depth": shares}
    write_json(results / "dense/depth.json", manifest)
    return [results / "dense/depth.json"]


def place_true_labels(results: Path, truth: Path) -> list[Path]:
    """Give every point of ``metric.ply`` the class of the true surface that it lies on.

    Points further than `evaluation.REACH_M` from all of them are unlabelled. Raises a `StageError`
    when the results or the truth are not complete.
    """
    cloud = read_cloud(results / "metric.ply")
    placed = moved(cloud.points, _to_truth(results, truth))
    tree = sample_skeleton(read_skeleton_csv(truth / "skeleton.csv"), step=SURFACE_STEP_M)
    kinds = np.where(tree.is_trunk, Label.TRUNK, Label.BRANCH).astype(np.uint8)
    exact = read_cloud(truth / "cloud.ply", required=("label", "tree"))
    exact = exact.select(~(wood_mask(exact["label"]) & (exact["tree"] == 0)))
    surface = np.vstack([tree.points, exact.points])
    label = at_surface(placed, surface, np.r_[kinds, exact["label"]], Label.UNLABELLED)
    fields = {"label": label, "confidence": np.ones(len(cloud), np.float32)}
    cloud.fields = {**cloud.fields, **fields}
    write_cloud(results / "segmented.ply", cloud)
    return [results / "segmented.ply"]


def place_true_skeleton(results: Path, truth: Path) -> list[Path]:
    """Put the true tree in the place of the skeleton and its topology.

    Raises a `StageError` when the results or the truth are not complete.
    """
    frame = _to_truth(results, truth)
    grown = read_skeleton_csv(truth / "skeleton.csv")
    points = (grown.points - frame[:3, 3]) @ frame[:3, :3]
    skeleton = replace(grown, points=points, frame="metric")
    files = [results / "skeleton.graphml", results / "topology.graphml"]
    write_skeleton_graphml(files[0], skeleton)
    write_topology_graphml(files[1], skeleton)
    return files


def _to_truth(results: Path, truth: Path) -> np.ndarray:
    """The rigid motion (4, 4) from the tree's metric frame to the scene's."""
    if read_json(results / "metric.json").get("unit", "m") != "m":
        raise StageError("the tree has no scale in metres", file=results / "metric.json")
    return cameras_beside_truth(results, truth)["frame"]
