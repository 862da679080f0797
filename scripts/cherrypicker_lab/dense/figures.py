"""The benchmark's figures: bars by wood, time over megapixels, depth maps, errors of clouds."""

from __future__ import annotations

import os

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from cherrypicker.files import atomic_path
from cherrypicker.mvs.workspace import Workspace
from cherrypicker.photos import read_photo
from cherrypicker.pointcloud import read_cloud
from cherrypicker.report.raster import side_views, splat
from cherrypicker_lab.dense.results import (
    BACKEND_NAMES,
    CAMERA_NAMES,
    CLASS_NAMES,
    Result,
    at_full_size,
)
from cherrypicker_lab.dense.surface import CLASSES

COLORS = {"cpu": "#1b7f5c", "sgbm": "#c2571a", "sgbm_sky": "#dd9a62", "cuda": "#3b5bab"}
DPI = 100
_ERROR_LIMIT_MM = 20.0
_PICTURE_WIDTH = 420


def save(figure: Figure, path: str | os.PathLike) -> None:
    """Write a figure as PNG, atomically and without a date."""
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=DPI, metadata={"Software": None})


def _groups(results: list[Result]) -> dict[tuple, list[Result]]:
    """Runs by scan and cameras, in order."""
    groups = {}
    for result in results:
        groups.setdefault((result.scan, result.cameras), []).append(result)
    return groups


def score_figure(results: list[Result]) -> Figure:
    """F1 at three tolerances and completeness by wood at 10 mm, one row a scan and its cameras."""
    groups = _groups([r for r in at_full_size(results) if r.scores is not None])
    figure = Figure(figsize=(10, 2.4 * len(groups) + 0.4), layout="constrained")
    axes = figure.subplots(len(groups), 2, width_ratios=(1, 1.7), squeeze=False, sharey=True)
    names = [name for name in CLASSES]
    for (left, right), ((scan, cameras), group) in zip(axes, groups.items()):
        for i, result in enumerate(group):
            scores = result.scores
            f1 = [scores["all"][t]["f1"] for t in ("5mm", "10mm", "20mm")]
            recall = [scores[name]["10mm"]["completeness"] for name in names]
            shift = (i - (len(group) - 1) / 2) * 0.8 / len(group)
            style = {"width": 0.75 / len(group), "color": COLORS[result.backend]}
            bars = left.bar(np.arange(3) + shift, f1, label=BACKEND_NAMES[result.backend], **style)
            left.bar_label(bars, fmt="%.2f", fontsize=7)
            known = [k for k, value in enumerate(recall) if value is not None]
            bars = right.bar(np.array(known) + shift, [recall[k] for k in known], **style)
            right.bar_label(bars, fmt="%.2f", fontsize=7)
        left.set_xticks(range(3), ["5 mm", "10 mm", "20 mm"])
        right.set_xticks(range(len(names)), [CLASS_NAMES[name] for name in names], fontsize=8)
        left.set_title(f"{scan}, cameras {CAMERA_NAMES[cameras]}: F1", fontsize=9, loc="left")
        right.set_title("completeness at 10 mm by wood", fontsize=9, loc="left")
        left.set_ylim(0, 1.1)
    axes[0, 0].legend(fontsize=7, loc="lower right")
    return figure


def time_figure(results: list[Result]) -> Figure:
    """CPU seconds over megapixels of all references, and memory over the size of a photo."""
    figure = Figure(figsize=(10, 3.8), layout="constrained")
    time, memory = figure.subplots(1, 2)
    for backend in BACKEND_NAMES:
        runs = [r.measured for r in results if r.backend == backend]
        if not runs:
            continue
        size = np.array([run["megapixels"] for run in runs])
        cpu = np.array([run["depth"]["cpu_s"] for run in runs])
        slope = float((size * cpu).sum() / (size**2).sum())
        label = f"{BACKEND_NAMES[backend]}: {slope:.1f} CPU s a megapixel"
        time.plot([0, size.max()], [0, slope * size.max()], color=COLORS[backend], lw=1)
        time.scatter(size, cpu, color=COLORS[backend], s=22, label=label, zorder=3)
        each = [run["megapixels_per_photo"] for run in runs]
        peak = [run["depth"]["peak_mb"] for run in runs]
        memory.scatter(each, peak, color=COLORS[backend], s=22)
    time.set(xlabel="megapixels of all references", ylabel="CPU seconds of the depth maps")
    memory.set(xlabel="megapixels of a photo", ylabel="peak memory, MB")
    for axes in (time, memory):
        axes.set_xlim(left=0)
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
    time.legend(fontsize=8)
    return figure


def depth_figure(group: list[Result]) -> Figure:
    """A photo beside the depth map of each backend, of the scan's middle view."""
    spaces = [Workspace(result.folder / "dense") for result in group]
    views = spaces[0].views
    view = views[len(views) // 2]
    maps = [_depth_or_zeros(space, view) for space in spaces]
    known = np.concatenate([depth[depth > 0] for depth in maps])
    low, high = np.quantile(known, [0.02, 0.9]) if len(known) else (0.0, 1.0)
    height = 3.2 * view.height / view.width + 0.4
    figure = Figure(figsize=(3.2 * (len(group) + 1), height), layout="constrained")
    axes = figure.subplots(1, len(group) + 1)
    axes[0].imshow(read_photo(spaces[0].photo_path(view)))
    axes[0].set_title(f"{group[0].scan}, {view.name}", fontsize=9)
    for ax, result, depth in zip(axes[1:], group, maps):
        ax.imshow(np.where(depth > 0, depth, np.nan), cmap="turbo_r", vmin=low, vmax=high)
        ax.set_title(
            f"{BACKEND_NAMES[result.backend]}: depth at {100 * (depth > 0).mean():.0f} %",
            fontsize=9,
        )
    for ax in axes:
        ax.set_axis_off()
    return figure


def _depth_or_zeros(space: Workspace, view) -> np.ndarray:
    """Depth map of a view, zeros where the view was left out."""
    if space.has_maps(view, "geometric"):
        return space.read_depth(view, "geometric")
    return np.zeros((view.height, view.width), dtype=np.float32)


def error_figure(group: list[Result]) -> Figure:
    """The cloud of each backend from the front, coloured by its distance to the true surface."""
    clouds = [read_cloud(result.folder / "scored.ply", required=("error",)) for result in group]
    view = side_views(np.vstack([cloud.points for cloud in clouds]), kinds=("front",))[0]
    figure = Figure(figsize=(4.2 * len(group) + 0.8, 4.2 * view.aspect + 0.4), layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, len(group)))
    norm, colormap = Normalize(0, _ERROR_LIMIT_MM), colormaps["turbo"]
    for ax, result, cloud in zip(axes, group, clouds):
        colors = colormap(norm(1000 * cloud["error"]))[:, :3]
        # the worst are drawn last, so that floaters show before and behind the wood
        order = np.argsort(cloud["error"], kind="stable")
        flat = cloud.points[order].copy()
        flat[:, 1] = -np.arange(len(flat))
        ax.imshow(splat(flat, colors[order], view, _PICTURE_WIDTH, size=1))
        f1 = result.scores["all"]["10mm"]["f1"]
        ax.set_title(f"{BACKEND_NAMES[result.backend]}: F1 at 10 mm {f1:.3f}", fontsize=9)
        ax.set_axis_off()
    bar = ScalarMappable(norm=norm, cmap=colormap)
    figure.colorbar(bar, ax=axes.tolist(), shrink=0.7, label="distance to the surface, mm")
    return figure
