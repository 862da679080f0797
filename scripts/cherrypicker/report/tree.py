"""Load everything a tree has, draw its figures and write its report."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cherrypicker.files import read_json, write_text
from cherrypicker.pointcloud import read_cloud
from cherrypicker.poses import read_poses
from cherrypicker.pruning.table import CUT_COLUMNS
from cherrypicker.report import figures as draw
from cherrypicker.report.bearing import read_pieces, read_sky_shares
from cherrypicker.report.page import ReportOptions, render_report
from cherrypicker.report.style import LAYOUT
from cherrypicker.skeleton import read_skeleton
from cherrypicker.traits.branches import read_branches
from cherrypicker.traits.table import LIMB_COLUMNS

logger = logging.getLogger(__name__)


class _File(NamedTuple):
    """A file that the report reads: how, what it is, and whether every tree has it."""

    read: Callable[[str], Any]
    text: str
    is_needed: bool = False


#: What the report is made of, by the name of the rule's input.
FILES = {
    "traits": _File(read_json, "traits.json", True),
    "branches": _File(read_branches, "branches.csv", True),
    "limbs": _File(partial(read_branches, columns=LIMB_COLUMNS), "limbs.csv"),
    "skeleton": _File(read_skeleton, "skeleton.graphml", True),
    "segmented": _File(partial(read_cloud, required=("label",)), "labelled cloud", True),
    "contracted": _File(read_cloud, "contracted points", True),
    "contract_report": _File(read_json, "contract.json"),
    "removed": _File(partial(read_cloud, may_be_empty=True), "points that were taken out"),
    "target": _File(read_json, "target.json"),
    "sparse": _File(read_json, "sfm/report.json of a scan from photos"),
    "align_report": _File(read_json, "align.json"),
    "crop_report": _File(read_json, "crop.json"),
    "denoise_report": _File(read_json, "denoise.json"),
    "scale": _File(read_json, "scale.json"),
    "poses": _File(read_poses, "poses in COLMAP's frame"),
    "cameras": _File(lambda path: Path(path).parent, "cameras.bin in the sparse model's folder"),
    "metric_poses": _File(read_poses, "poses in the segmented cloud's frame"),
    "aligned": _File(read_cloud, "aligned cloud"),
    "aligned_poses": _File(read_poses, "poses in the aligned cloud's frame"),
    "cropped": _File(read_cloud, "cropped cloud"),
    "denoised": _File(read_cloud, "denoised cloud"),
    "sky_masks": _File(Path, "folder of sky masks"),
    "depth": _File(Path, "folder of the depths of each photo"),
    "coverage": _File(read_json, "dense/coverage.json"),
    "edits": _File(lambda path: Path(path).read_text("utf-8"), "hand corrections that it holds"),
    "photo_check": _File(read_json, "photo_check.json"),
    "light": _File(read_json, "light.json"),
    "light_axes": _File(read_sky_shares, "light.csv"),
    "pruning": _File(read_json, "pruning.json"),
    "cuts": _File(partial(read_branches, columns=CUT_COLUMNS), "pruning.csv"),
    "bearing": _File(read_json, "bearing.json"),
    "bearing_pieces": _File(read_pieces, "bearing.csv"),
    "measures": _File(read_json, "measures.json of a tree that was measured by hand"),
    "worst_photo": _File(lambda path: Path(path).read_bytes(), "photo_check/worst.jpg"),
    "best_photo": _File(lambda path: Path(path).read_bytes(), "photo_check/best.jpg"),
}
#: The figures that every tree has, and what stands below them on the page.
CAPTIONS = {
    "cloud": "The labelled cloud in its own colours (by height where it has none).",
    "label": "Classes of the points.",
    "skeleton": "Skeleton over the wood points; lines as thick as the radii say.",
    "topology": "Branch orders, junctions and tips.",
    "trunk": "Sections of the trunk with the fitted circle (red); dashed where the skeleton's "
    "radius stands in for a fit.",
}


def report_tree(
    about: Mapping[str, str],
    report: str | os.PathLike,
    files: Mapping[str, Any],
    options: ReportOptions,
    *,
    photos: Sequence = (),
    lacking: Sequence[str] = (),
    seed: int = 0,
) -> None:
    """Write a tree's report and its figures.

    Parameters
    ----------
    about : mapping of str to str
        ``tree``, ``date`` and ``series``, as in the table of trees.
    files : mapping of str to path-like
        By `FILES`, None or empty for what the tree does not have; and ``cloud_figure``, ...,
        ``thumbnail_figure``, the PNG files to write.
    photos : sequence of path-like
    lacking : sequence of str
        Which parts of the page failed and why, a line each.

    Raises
    ------
    StageError
        If an input is missing or broken.
    """
    data: dict[str, Any] = {
        name: file.read(files[name]) if files.get(name) else None for name, file in FILES.items()
    }
    data["photos"], data["lacking"] = [Path(path) for path in photos], lacking
    cloud, skeleton, traits = data["segmented"], data["skeleton"], data["traits"]
    data["foot"] = np.asarray(traits.get("foot", skeleton.points[0]), dtype=np.float64)
    width = options.figure_width_px
    logger.info("drawing figures of %s points", f"{len(cloud):,}")
    drawn = {
        "cloud": draw.cloud_figure(cloud, skeleton, width),
        "label": draw.label_figure(cloud, skeleton, width),
        "skeleton": draw.skeleton_figure(cloud, skeleton, width),
        "topology": draw.topology_figure(skeleton, width),
        "trunk": draw.trunk_figure(cloud, traits, width),
    }
    for name, figure in drawn.items():
        draw.save_figure(figure, files[f"{name}_figure"], width)
    small = draw.thumbnail(cloud, skeleton)
    draw.save_figure(small, files["thumbnail_figure"], int(LAYOUT["thumbnail_px"]))
    figures = [(Path(files[f"{name}_figure"]).read_bytes(), CAPTIONS[name]) for name in drawn]
    page = render_report(about, data, figures, options, seed=seed)
    write_text(report, page)
    logger.info("report of %.1f MB", len(page) / 1e6)
