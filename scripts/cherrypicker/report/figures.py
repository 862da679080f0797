"""The figures that every tree has: cloud, labels, skeleton, topology, trunk sections, thumbnail.

Each function returns a Matplotlib figure; `save_figure` writes it with equal bytes for equal input.
"""

from __future__ import annotations

import os
from io import BytesIO

import matplotlib
from matplotlib.axes import Axes

from cherrypicker.pointcloud import PointCloud
from cherrypicker.report.raster import View
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.skeleton.topology import Topology

matplotlib.use("Agg")

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch

from cherrypicker.classes import Label, wood_mask
from cherrypicker.files import atomic_path
from cherrypicker.report.colors import CLASS_COLORS
from cherrypicker.report.raster import heights_as_colors, side_views, splat
from cherrypicker.skeleton import axes, node_order
from cherrypicker.units import unit_name

__all__ = [
    "cloud_figure",
    "label_figure",
    "order_color",
    "save_figure",
    "skeleton_figure",
    "thumbnail",
    "topology_figure",
    "trunk_figure",
    "view_grid",
    "write_png",
]

DPI = 100
THUMBNAIL_PX = 240
_GREY = 0.78
_ORDER_COLORS = ("#5b3a1e", "#c2571a", "#2b7a3d", "#2368a8", "#8a3fa0", "#c43b6b", "#4f9da6")
_MIN_VIEW_ASPECT, _MAX_VIEW_ASPECT = 0.15, 2.2
_MAX_DRAWN = 1_000_000


def order_color(order: int) -> str:
    """Colour of a branch order; they repeat after seven."""
    return _ORDER_COLORS[int(order) % len(_ORDER_COLORS)]


def save_figure(figure: Figure, path: str | os.PathLike, width_px: int) -> None:
    """Write a figure as PNG of about this width, atomically."""
    with atomic_path(path) as temporary:
        write_png(figure, temporary, width_px)


def write_png(figure: Figure, target: BytesIO | str | os.PathLike, width_px: int) -> None:
    """Write a figure to a path or stream, its margins cut off (a thumbnail's canvas is kept)."""
    tight: dict = {} if figure.get_layout_engine() is None else {"bbox_inches": "tight"}
    dpi = width_px / figure.get_size_inches()[0]
    figure.savefig(target, format="png", dpi=dpi, pad_inches=0.1, **tight)


def view_grid(views: list[View], unit: str, width_px: int, title: str = "") -> tuple[Figure, list]:
    """A figure with one panel a view, side by side at one scale of height.

    Returns
    -------
    figure : matplotlib.figure.Figure
    panels : list of (Axes, View, int)
        Axes, view and the px across of the panel.
    """
    ratios = [1.0 / min(max(view.aspect, _MIN_VIEW_ASPECT), _MAX_VIEW_ASPECT) for view in views]
    width = width_px / DPI
    height = min(max((width - 0.7 * len(views)) / sum(ratios), 2.5), 0.8 * width)
    figure = Figure(figsize=(width, height + 0.75), dpi=DPI, layout="constrained")
    drawn = figure.subplots(1, len(views), width_ratios=ratios, squeeze=False)[0]
    panels = []
    total = sum(ratios)
    for axes_, view, ratio in zip(drawn, views, ratios, strict=True):
        axes_.set_xlim(view.low[0], view.high[0])
        axes_.set_ylim(view.low[1], view.high[1])
        axes_.set_aspect("equal")
        names = {"front": "xz", "side": "yz", "top": "xy"}.get(view.name, "  ")
        axes_.set_xlabel(f"{names[0]} [{unit_name(unit)}]")
        axes_.set_ylabel(f"{names[1]} [{unit_name(unit)}]")
        axes_.set_title(view.name, fontsize=10)
        axes_.tick_params(labelsize=8)
        panels.append((axes_, view, max(int(width_px * ratio / total), 200)))
    if title:
        figure.suptitle(title, fontsize=12)
    return figure, panels


def show_points(
    panel: tuple[Axes, View, int],
    points: np.ndarray,
    colors: np.ndarray | tuple[float, ...],
    *,
    size: int = 2,
    background: float = 1.0,
) -> None:
    """Draw points into a panel of `view_grid`; of a big cloud every few, which no pixel misses."""
    axes_, view, width = panel
    step = 1 + len(points) // _MAX_DRAWN
    if isinstance(colors, np.ndarray) and colors.ndim == 2:
        colors = colors[::step]
    image = splat(points[::step], colors, view, width, size=size, background=background)
    extent = (view.low[0], view.high[0], view.low[1], view.high[1])
    axes_.imshow(np.clip(image, 0, 1), extent=extent, interpolation="nearest", zorder=0)


def cloud_colors(cloud: PointCloud) -> np.ndarray:
    """The cloud's colours, or colours by height where it has none."""
    return heights_as_colors(cloud.points) if cloud.colors is None else cloud.colors


def class_colors(labels: np.ndarray) -> np.ndarray:
    """RGB per point by class, (n, 3) float32."""
    table = np.full((256, 3), CLASS_COLORS[Label.UNLABELLED], dtype=np.float32)
    for label, color in CLASS_COLORS.items():
        table[label] = color
    return table[labels]


def tree_box(cloud: PointCloud, skeleton: Skeleton) -> np.ndarray:
    """Points that span the tree: its skeleton, widened by its radii."""
    spread = np.maximum(skeleton.radius, 0.02)[:, None]
    return np.vstack([skeleton.points - spread, skeleton.points + spread])


def cloud_figure(cloud: PointCloud, skeleton: Skeleton, width_px: int) -> Figure:
    """The segmented cloud in its own colours: the tree from two sides, the scene from above."""
    box = tree_box(cloud, skeleton)
    views = side_views(box, margin=0.08, kinds=("front", "side"))
    views += side_views(cloud.points, kinds=("top",))
    figure, panels = view_grid(views, cloud.unit, width_px, "Point cloud")
    colors = cloud_colors(cloud)
    for panel in panels:
        show_points(panel, cloud.points, colors)
    return figure


def label_figure(cloud: PointCloud, skeleton: Skeleton, width_px: int) -> Figure:
    """The segmented cloud by class."""
    box = tree_box(cloud, skeleton)
    views = side_views(box, margin=0.08, kinds=("front", "side"))
    views += side_views(cloud.points, kinds=("top",))
    figure, panels = view_grid(views, cloud.unit, width_px, "Classes")
    labels = cloud["label"]
    colors = class_colors(labels)
    for panel in panels:
        show_points(panel, cloud.points, colors)
    present = [label for label in CLASS_COLORS if (labels == label).any()]
    handles = [
        Patch(
            color=CLASS_COLORS[label],
            label=f"{Label(label).title} ({(labels == label).mean():.1%})",
        )
        for label in present
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    return figure


def _edge_lines(skeleton: Skeleton, view: View) -> list[np.ndarray]:
    flat, _ = view.flatten(skeleton.points)
    return list(np.stack([flat[skeleton.parent[1:]], flat[1:]], axis=1))


def skeleton_figure(cloud: PointCloud, skeleton: Skeleton, width_px: int) -> Figure:
    """The skeleton over the wood it was made from, its lines as thick as its radii say."""
    wood = cloud.points[wood_mask(cloud["label"])]
    views = side_views(tree_box(cloud, skeleton), kinds=("front", "side"))
    figure, panels = view_grid(views, cloud.unit, width_px, "Skeleton over the wood")
    radius = skeleton.radius[1:]
    for panel in panels:
        show_points(panel, wood, (_GREY,) * 3)
        lines = LineCollection(
            _edge_lines(skeleton, panel[1]),
            linewidths=0.6 + 2.4 * radius / max(radius.max(), 1e-9),
            colors="#b3261e",
            capstyle="round",
        )
        panel[0].add_collection(lines)
    return figure


def topology_figure(
    cloud: PointCloud, skeleton: Skeleton, topology: Topology, width_px: int
) -> Figure:
    """Branch orders by colour, with root, junctions and tips."""
    orders = node_order(skeleton, axes(skeleton))
    views = side_views(tree_box(cloud, skeleton), kinds=("front", "side"))
    figure, panels = view_grid(views, cloud.unit, width_px, "Topology by branch order")
    colors = [order_color(order) for order in orders[1:]]
    kinds = np.array(topology.kind)
    marks = (("junction", "o", "#202020", 9), ("tip", "o", "#f2a33a", 6), ("root", "s", "k", 40))
    for axes_, view, _ in panels:
        axes_.add_collection(
            LineCollection(_edge_lines(skeleton, view), colors=colors, linewidths=1.6)
        )
        flat, _ = view.flatten(topology.points)
        for kind, marker, color, size in marks:
            chosen = flat[kinds == kind]
            axes_.scatter(
                *chosen.T, marker=marker, s=size, color=color, zorder=3, linewidths=0, label=kind
            )
    handles = [Patch(color=order_color(k), label=f"order {k}") for k in np.unique(orders)]
    handles += panels[0][0].get_legend_handles_labels()[0]
    figure.legend(handles=handles, loc="outside lower center", ncols=9, fontsize=8, frameon=False)
    return figure


def trunk_figure(
    cloud: PointCloud, traits: dict, width_px: int, *, half_height: float = 0.05
) -> Figure:
    """The stem's points across its axis at every measured height, with the fitted circle."""
    sections = traits["trunk_sections"]
    n_columns = min(len(sections), 4)
    n_rows = -(-len(sections) // n_columns)
    side = width_px / DPI / 4
    size = (4 * side, (side + 0.5) * n_rows + 0.4)
    figure = Figure(figsize=size, dpi=DPI, layout="constrained")
    panels = figure.subplots(n_rows, 4, squeeze=False).ravel()
    for panel in panels[len(sections) :]:
        panel.set_axis_off()
    labels = cloud["label"]
    unit = unit_name(cloud.unit)
    for panel, section in zip(panels, sections, strict=False):
        center, radius = np.array(section["center"]), section["diameter_m"] / 2
        reach = 1.8 * radius + 0.01
        flat, near = _section_points(
            cloud.points, center, np.array(section["axis"]), reach, half_height
        )
        colors = class_colors(labels[near])
        if len(flat) > 6000:
            step = len(flat) // 6000 + 1
            flat, colors = flat[::step], colors[::step]
        panel.scatter(*flat.T, s=2, c=colors, linewidths=0)
        style = "-" if section["source"] == "points" else "--"
        panel.add_patch(Circle((0, 0), radius, fill=False, color="#b3261e", lw=1.4, ls=style))
        panel.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
        panel.tick_params(labelsize=7)
        panel.set_title(
            f"at {section['height_m']:.2f} {unit}: diameter {section['diameter_m']:.4f} {unit}\n"
            f"arc {section['arc_deg']:.0f}°, scatter {section['residual_m']:.4f} {unit}, "
            f"{section['n_points']} points",
            fontsize=8,
        )
    figure.suptitle("Trunk sections", fontsize=12)
    return figure


def _section_points(
    points: np.ndarray, center: np.ndarray, axis: np.ndarray, reach: float, half_height: float
) -> tuple[np.ndarray, np.ndarray]:
    near = np.flatnonzero((np.abs(points - center) <= 1.5 * reach + half_height).all(axis=1))
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    u = np.cross(axis, helper)
    u /= np.linalg.norm(u)
    local = (points[near] - center) @ np.stack([u, np.cross(axis, u), axis], axis=1)
    inside = (np.abs(local[:, 2]) <= half_height) & (np.abs(local[:, :2]) <= reach).all(axis=1)
    return local[inside, :2], near[inside]


def thumbnail(cloud: PointCloud, skeleton: Skeleton, width_px: int = THUMBNAIL_PX) -> Figure:
    """A small front view: wood in its colours, the skeleton's orders on it."""
    (view,) = side_views(tree_box(cloud, skeleton), kinds=("front",))
    aspect = min(view.aspect, 3.0)
    figure = Figure(figsize=(width_px / DPI, width_px * aspect / DPI), dpi=DPI)
    axes_ = figure.add_axes((0, 0, 1, 1))
    axes_.set_axis_off()
    wood = cloud.points[wood_mask(cloud["label"])]
    axes_.set(xlim=(view.low[0], view.high[0]), ylim=(view.low[1], view.high[1]), aspect="equal")
    show_points((axes_, view, width_px), wood, (_GREY,) * 3, size=1)
    orders = node_order(skeleton, axes(skeleton))
    colors = [order_color(order) for order in orders[1:]]
    axes_.add_collection(LineCollection(_edge_lines(skeleton, view), colors=colors, linewidths=1.0))
    return figure
