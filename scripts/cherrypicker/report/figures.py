"""The figures that every tree has: cloud, labels, skeleton, topology, trunk sections, thumbnail.

Each function returns a Matplotlib figure; `png_of` gives equal bytes for equal input.
"""

from io import BytesIO
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch
from PIL import Image, ImageOps

from cherrypicker.classes import Label, wood_mask
from cherrypicker.geometry.stem_slabs import cut_slab
from cherrypicker.pointcloud import PointCloud
from cherrypicker.report.raster import AXES, View, side_views, splat
from cherrypicker.report.style import (
    CLASS_COLORS,
    COLOR,
    DPI,
    FONT,
    GREY,
    HIGH_COLOR,
    LAYOUT,
    LINE,
    LOW_COLOR,
    MARK,
    ORDER_COLORS,
)
from cherrypicker.skeleton import node_order
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.traits.trunk import SPAN_M
from cherrypicker.units import unit_name

_MAX_DRAWN = 1_000_000  # points of a cloud: no pixel of a page misses more
HEIGHT_SHARES = (0.001, 0.999)  # of the points' heights that are drawn, or told by colour
# A legend below the panels
_BELOW: dict = {"loc": "outside lower center", "fontsize": FONT["note"], "frameon": False}


def order_color(order: int) -> str:
    """Colour of a branch order."""
    return ORDER_COLORS[int(order) % len(ORDER_COLORS)]


def png_of(figure: Figure, width_px: float) -> bytes:
    """A figure as PNG of about this width, its margins cut off (a thumbnail's canvas is kept)."""
    figure.set_dpi(width_px / figure.get_size_inches()[0])
    canvas, stream = FigureCanvasAgg(figure), BytesIO()
    canvas.draw()  # once: savefig with a tight box draws a second time, to measure
    image = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
    if figure.get_layout_engine() is not None:
        drawn = image.crop(ImageOps.invert(image).getbbox())
        image = ImageOps.expand(drawn, round(LAYOUT["pad"] * figure.dpi), "white")
    image.save(stream, format="PNG")
    return stream.getvalue()


class Panel(NamedTuple):
    """A view of a figure."""

    axes: Axes
    view: View
    width: int  # px across

    def points(
        self, points: np.ndarray, colors: np.ndarray | tuple[float, ...], size: int = 2
    ) -> None:
        """Draw points, `size` px wide; of a big cloud every few, which no pixel misses."""
        step = 1 + len(points) // _MAX_DRAWN
        if isinstance(colors, np.ndarray):
            colors = colors[::step]
        image = splat(points[::step], colors, self.view, self.width, size)
        (left, bottom), (right, top) = self.view.low, self.view.high
        extent = (left, right, bottom, top)
        self.axes.imshow(np.clip(image, 0, 1), extent=extent, interpolation="nearest", zorder=0)

    def marks(self, points: np.ndarray, size: float, color: str, **style: Any) -> None:
        """Draw points (n, 3) as marks of an area in pt²."""
        flat = self.view.flatten(points)
        style = {"linewidths": 0, "zorder": 2} | style
        self.axes.scatter(flat[:, 0], flat[:, 1], s=size, color=color, **style)

    def lines(self, start: np.ndarray, end: np.ndarray, **style: Any) -> None:
        """Draw lines between points (n, 3)."""
        flat = [self.view.flatten(points) for points in (start, end)]
        self.axes.add_collection(LineCollection(list(np.stack(flat, axis=1)), **style))

    def edges(self, skeleton: Skeleton, nodes: Any = slice(1, None), **style: Any) -> None:
        """Draw a skeleton's lines that end at some nodes."""
        self.lines(skeleton.points[skeleton.parent[nodes]], skeleton.points[nodes], **style)

    def wood(
        self, skeleton: Skeleton, color: str, nodes: Any = slice(1, None), **style: Any
    ) -> None:
        """Draw them as thick as their radii say."""
        thick = skeleton.radius / max(skeleton.radius[1:].max(), 1e-9)
        thick = LINE["least_wood"] + LINE["most_wood"] * thick
        self.edges(skeleton, nodes, linewidths=thick[nodes], colors=color, **style)


def view_grid(
    views: list[View], unit: str, width_px: int, title: str
) -> tuple[Figure, list[Panel]]:
    """A figure with one panel a view, side by side at one scale of height."""
    low, high = LAYOUT["least_aspect"], LAYOUT["most_aspect"]
    ratios = [1.0 / min(max(view.aspect, low), high) for view in views]
    width, total = width_px / DPI, sum(ratios)
    height = max((width - LAYOUT["axis"] * len(views)) / total, LAYOUT["least_height"])
    height = min(height, LAYOUT["most_height"] * width) + LAYOUT["heading"]
    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    drawn = figure.subplots(1, len(views), width_ratios=ratios, squeeze=False)[0]
    panels = []
    for axes_, view, ratio in zip(drawn, views, ratios, strict=True):
        across, up = ("xyz"[at] for at in AXES[view.name][:2])
        (left, bottom), (right, top) = view.low, view.high
        axes_.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
        axes_.set_xlabel(f"{across} [{unit_name(unit)}]")
        axes_.set_ylabel(f"{up} [{unit_name(unit)}]")
        axes_.set_title(view.name, fontsize=FONT["panel"])
        axes_.tick_params(labelsize=FONT["note"])
        panel_px = int(max(width_px * ratio / total, LAYOUT["least_panel_px"]))
        panels.append(Panel(axes_, view, panel_px))
    figure.suptitle(title, fontsize=FONT["title"])
    return figure, panels


def tree_grid(
    skeleton: Skeleton,
    width_px: int,
    title: str,
    *,
    cloud: PointCloud | None = None,
) -> tuple[Figure, list[Panel]]:
    """A figure of the tree from two sides, with the wood of a cloud in grey where one is given."""
    views = side_views(tree_box(skeleton), kinds=("front", "side"))
    figure, panels = view_grid(views, skeleton.unit, width_px, title)
    if cloud is not None:
        wood = cloud.points[wood_mask(cloud["label"])]
        for panel in panels:
            panel.points(wood, (GREY["wood"],) * 3)
    return figure, panels


def tile_grid(rows: list[list[tuple]], size: tuple[float, float]) -> Figure | None:
    """Pictures in rows; rows without any are left out, None where no row has one.

    A tile is its title, picture, style of `Axes.imshow`, and an outline over it in its pixels,
    (n, 2) or None. Its ``size`` is width and height in inches.
    """
    rows = [row for row in rows if row]
    if not rows:
        return None
    shape = len(rows), max(map(len, rows))
    figsize = size[0] * shape[1], size[1] * shape[0]
    figure = Figure(figsize=figsize, dpi=DPI, layout="constrained")
    for panels, tiles in zip(figure.subplots(*shape, squeeze=False), rows, strict=True):
        for panel in panels:
            panel.set_axis_off()
        for panel, (title, image, style, outline) in zip(panels, tiles, strict=False):
            panel.imshow(image, interpolation="nearest", **style)
            if outline is not None:
                panel.plot(*outline.T, color=COLOR["corner"], lw=LINE["border"])
            # Names come from the user's files: no mathtext in them
            panel.set_title(title, fontsize=FONT["tile"], parse_math=False)
    return figure


def cloud_colors(cloud: PointCloud) -> np.ndarray:
    """The cloud's colours; where it has none dark below and light above, (n, 3) float32."""
    if cloud.colors is not None:
        return cloud.colors
    z = cloud.points[:, 2]
    low, high = np.quantile(z, HEIGHT_SHARES)
    share = np.clip((z - low) / max(high - low, 1e-9), 0, 1)[:, None]
    colors = (1 - share) * np.array(LOW_COLOR) + share * np.array(HIGH_COLOR)
    return colors.astype(np.float32)


def class_colors(labels: np.ndarray) -> np.ndarray:
    """RGB per point by class, (n, 3) float32."""
    table = np.full((256, 3), CLASS_COLORS[Label.UNLABELLED], dtype=np.float32)
    table[list(CLASS_COLORS)] = list(CLASS_COLORS.values())
    return table[labels]


def tree_box(skeleton: Skeleton) -> np.ndarray:
    """Points that span the tree: its skeleton, widened by its radii."""
    spread = skeleton.radius[:, None]
    return np.vstack([skeleton.points - spread, skeleton.points + spread])


def cloud_figure(
    cloud: PointCloud,
    skeleton: Skeleton,
    width_px: int,
    colors: np.ndarray | None = None,
    title: str = "Point cloud",
) -> Figure:
    """The segmented cloud, in its own colours if no others are given.

    The tree from two sides, the scene from above.
    """
    colors = cloud_colors(cloud) if colors is None else colors
    views = side_views(tree_box(skeleton), kinds=("front", "side"))
    views += side_views(cloud.points, kinds=("top",))
    figure, panels = view_grid(views, cloud.unit, width_px, title)
    for panel in panels:
        panel.points(cloud.points, colors)
    return figure


def label_figure(cloud: PointCloud, skeleton: Skeleton, width_px: int) -> Figure:
    """The segmented cloud by class."""
    labels = cloud["label"]
    figure = cloud_figure(cloud, skeleton, width_px, class_colors(labels), "Classes")
    handles = [
        Patch(color=color, label=f"{Label(label).title} ({(labels == label).mean():.1%})")
        for label, color in CLASS_COLORS.items()
        if (labels == label).any()
    ]
    figure.legend(handles=handles, ncols=5, **_BELOW)
    return figure


def skeleton_figure(cloud: PointCloud, skeleton: Skeleton, width_px: int) -> Figure:
    """The skeleton over the wood it was made from, its lines as thick as its radii say."""
    figure, panels = tree_grid(skeleton, width_px, "Skeleton over the wood", cloud=cloud)
    for panel in panels:
        panel.wood(skeleton, COLOR["fit"], capstyle="round")
    return figure


def topology_figure(skeleton: Skeleton, width_px: int) -> Figure:
    """Branch orders by colour, with root, junctions and tips."""
    orders = node_order(skeleton)
    figure, panels = tree_grid(skeleton, width_px, "Topology by branch order")
    colors = [order_color(order) for order in orders[1:]]
    n_children = skeleton.n_children[1:]
    kinds = {"junction": n_children > 1, "tip": n_children == 0}
    places = {kind: skeleton.points[1:][is_so] for kind, is_so in kinds.items()}
    places["root"] = skeleton.points[:1]
    for panel in panels:
        panel.edges(skeleton, colors=colors, linewidths=LINE["order"])
        for kind, points in places.items():
            style: dict = {"marker": "s" if kind == "root" else "o", "label": kind, "zorder": 3}
            panel.marks(points, MARK[kind], COLOR[kind], **style)
    handles: list[Artist] = [
        Patch(color=order_color(k), label=f"order {k}") for k in np.unique(orders)
    ]
    handles += panels[0].axes.get_legend_handles_labels()[0]
    figure.legend(handles=handles, ncols=9, **_BELOW)
    return figure


def trunk_figure(cloud: PointCloud, traits: dict, width_px: int) -> Figure:
    """The stem's points across its axis at every measured height, with the fitted circle."""
    sections = traits["trunk_sections"]
    n_columns = int(LAYOUT["sections_a_row"])
    n_rows = -(-len(sections) // n_columns)
    side = width_px / DPI / n_columns
    height = (side + LAYOUT["section_heading"]) * n_rows + LAYOUT["sections_heading"]
    figure = Figure(figsize=(width_px / DPI, height), dpi=DPI, layout="constrained")
    panels = figure.subplots(n_rows, n_columns, squeeze=False).ravel()
    for panel in panels[len(sections) :]:
        panel.set_axis_off()
    labels = cloud["label"]
    unit = unit_name(cloud.unit)
    for panel, section in zip(panels, sections, strict=False):
        center, axis = np.array(section["center"]), np.array(section["axis"])
        across = section["diameter_m"] or SPAN_M
        local, rows, _ = cut_slab(cloud.points, center, axis, SPAN_M, 2 * across)
        view = View("top", np.full(2, -across), np.full(2, across))
        drawn = Panel(panel, view, int(width_px / n_columns))
        drawn.points(local, class_colors(labels[rows]))
        style = "-" if section["source"] == "points" else "--"
        circle: dict = {"fill": False, "color": COLOR["fit"], "lw": LINE["circle"]}
        panel.add_patch(Circle((0, 0), across / 2, ls=style, **circle))
        panel.set(xlim=(-across, across), ylim=(-across, across), aspect="equal")
        panel.tick_params(labelsize=FONT["fine"])
        panel.set_title(
            f"at {section['height_m']:.2f} {unit}: diameter {section['diameter_m']:.4f} {unit}\n"
            f"arc {section['arc_deg']:.0f}°, scatter {section['residual_m']:.4f} {unit}, "
            f"{section['n_points']} points",
            fontsize=FONT["note"],
        )
    figure.suptitle("Trunk sections", fontsize=FONT["title"])
    return figure


def thumbnail(cloud: PointCloud, skeleton: Skeleton) -> Figure:
    """A small front view: wood in its colours, the skeleton's orders on it."""
    (view,) = side_views(tree_box(skeleton), kinds=("front",))
    width_px = int(LAYOUT["thumbnail_px"])
    aspect = min(view.aspect, LAYOUT["thumbnail_aspect"])
    figure = Figure(figsize=(width_px / DPI, width_px * aspect / DPI), dpi=DPI)
    axes_ = figure.add_axes((0, 0, 1, 1))
    axes_.set_axis_off()
    axes_.set(xlim=(view.low[0], view.high[0]), ylim=(view.low[1], view.high[1]), aspect="equal")
    panel = Panel(axes_, view, width_px)
    panel.points(cloud.points[wood_mask(cloud["label"])], (GREY["wood"],) * 3, size=1)
    orders = node_order(skeleton)
    colors = [order_color(order) for order in orders[1:]]
    panel.edges(skeleton, colors=colors, linewidths=LINE["thin"])
    return figure
