"""Load everything a tree has, draw its figures and write its report."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cherrypicker.files import read_json, write_text
from cherrypicker.lens import PhotoLenses
from cherrypicker.pointcloud import read_cloud
from cherrypicker.poses import read_poses
from cherrypicker.report import figures as draw
from cherrypicker.report.page import read_branches, render_report
from cherrypicker.skeleton import read_skeleton, read_topology

__all__ = ["report_tree"]

logger = logging.getLogger(__name__)

_CAPTIONS = {
    "cloud": "The labelled cloud in its own colours (by height where it has none).",
    "label": "Classes of the points.",
    "skeleton": "Skeleton over the wood points; lines as thick as the radii say.",
    "topology": "Branch orders, junctions and tips.",
    "trunk": "Sections of the trunk with the fitted circle (red); dashed where the skeleton's "
    "radius stands in for a fit.",
}
_THUMBNAIL_PX = 240


def report_tree(
    tree: str,
    traits: str | os.PathLike,
    branches: str | os.PathLike,
    skeleton: str | os.PathLike,
    topology: str | os.PathLike,
    segmented: str | os.PathLike,
    contracted: str | os.PathLike,
    *,
    report: str | os.PathLike,
    cloud_figure: str | os.PathLike,
    label_figure: str | os.PathLike,
    skeleton_figure: str | os.PathLike,
    topology_figure: str | os.PathLike,
    trunk_figure: str | os.PathLike,
    thumbnail_figure: str | os.PathLike,
    photos: Sequence = (),
    date: str = "",
    series: str = "",
    viewer_points: int,
    figure_width_px: int,
    n_examples: int,
    seed: int = 0,
    **scan_files: Any,
) -> None:
    """Write a tree's report and its figures.

    Parameters
    ----------
    tree : str
        The tree's id.
    traits, branches, skeleton, topology, segmented, contracted : path-like
        The tree's results.
    report : path-like
        HTML to write.
    cloud_figure, ..., thumbnail_figure : path-like
        PNG files to write.
    photos : sequence of path-like
    date, series : str
        As in the table of trees.
    viewer_points, figure_width_px, n_examples, seed : int
        Config keys of ``report``, and the seed.
    **scan_files
        Paths of ``sparse``, ``align_report``, ``crop_report``, ``denoise_report``, ``scale``,
        ``contract_report``, ``target``, ``poses``, ``cameras``, ``metric_poses``, ``aligned``,
        ``aligned_poses``, ``cropped``, ``denoised``, ``sky_colors``, ``depth``,
        ``coverage``; None or
        empty for what the tree does not have.

    Raises
    ------
    StageError
        If an input is missing or broken.
    """
    numbers = read_json(traits)
    cloud = read_cloud(segmented, required=("label",))
    graph, folded = read_skeleton(skeleton), read_topology(topology)
    scan = _load_scan(photos, {**scan_files, "contracted": contracted})
    width = figure_width_px
    logger.info("drawing figures of %s points", f"{len(cloud):,}")
    drawn = {
        "cloud": (draw.cloud_figure(cloud, graph, width), cloud_figure),
        "label": (draw.label_figure(cloud, graph, width), label_figure),
        "skeleton": (draw.skeleton_figure(cloud, graph, width), skeleton_figure),
        "topology": (draw.topology_figure(cloud, graph, folded, width), topology_figure),
        "trunk": (draw.trunk_figure(cloud, numbers, width), trunk_figure),
    }
    for figure, path in drawn.values():
        draw.save_figure(figure, path, width)
    draw.save_figure(draw.thumbnail(cloud, graph, _THUMBNAIL_PX), thumbnail_figure, _THUMBNAIL_PX)
    page = render_report(
        {"tree": tree, "date": date, "series": series},
        numbers,
        read_branches(branches),
        cloud,
        graph,
        [(Path(path).read_bytes(), _CAPTIONS[name]) for name, (_, path) in drawn.items()],
        scan,
        np.asarray(numbers.get("foot", graph.points[0]), dtype=np.float64),
        options={
            "viewer_points": viewer_points,
            "figure_width_px": figure_width_px,
            "n_examples": n_examples,
        },
        seed=seed,
    )
    write_text(report, page)
    logger.info("report of %.1f MB", len(page) / 1e6)


def _load_scan(photos: Sequence, files: dict) -> dict:
    """Load what the tree has; inputs that a ready cloud lacks stay None."""

    def load(name: str, read: Callable) -> Any:
        path = files.get(name)
        return read(path) if path else None

    sky, depth = files.get("sky_colors"), files.get("depth")
    poses, cameras = load("poses", read_poses), files.get("cameras")
    return {
        "photos": [Path(path) for path in photos],
        "sparse": load("sparse", read_json),
        "align": load("align_report", read_json),
        "crop": load("crop_report", read_json),
        "denoise": load("denoise_report", read_json),
        "scale": load("scale", read_json),
        "contract": load("contract_report", read_json),
        "target": load("target", read_json),
        "poses": load("metric_poses", read_poses),
        "aligned_poses": load("aligned_poses", read_poses),
        "aligned": load("aligned", read_cloud),
        "cropped": load("cropped", read_cloud),
        "denoised": load("denoised", read_cloud),
        "contracted": load("contracted", read_cloud),
        "colmap_poses": poses,
        "lenses": PhotoLenses(Path(cameras).parent, poses.names) if poses and cameras else None,
        "sky_folder": Path(sky).parent / "sky" if sky else None,
        "coverage": load("coverage", read_json),
        "dense_folder": Path(depth).parent if depth else None,
    }
