"""Figures of the stages that only a scan from photos goes through; they live inside the report."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from PIL import Image

from cherrypicker.classes import Label
from cherrypicker.evidence.coverage import voxel_centers
from cherrypicker.geometry.similarity import moved
from cherrypicker.mvs.depth_rasters import read_depth_raster
from cherrypicker.photos import UNREADABLE
from cherrypicker.placement.footprint import Footprint
from cherrypicker.pointcloud import PointCloud
from cherrypicker.poses import Poses
from cherrypicker.report.figures import HEIGHT_SHARES, cloud_colors, tile_grid, tree_grid, view_grid
from cherrypicker.report.raster import side_views
from cherrypicker.report.style import (
    COLOR,
    DPI,
    GREY,
    LAYOUT,
    LINE,
    MARK,
    SKY_SHARE,
    SKY_TINT,
)
from cherrypicker.skeleton.model import Skeleton


def camera_figure(poses: Poses, cloud: PointCloud, target: np.ndarray, width_px: int) -> Figure:
    """Where the registered photos were taken, from above and from the front.

    Poses and the stem's foot, `target` (3,), are in the cloud's frame.
    """
    centers = poses.centers
    reach = LAYOUT["arrow"] * np.median(np.linalg.norm(centers - target, axis=1))
    ahead = centers + reach * poses.forward
    box = np.vstack([centers, ahead, target[None]])
    views = side_views(box, kinds=("top", "front"))
    title = f"{len(poses)} registered photos"
    figure, panels = view_grid(views, cloud.unit, width_px, title)
    colors = cloud_colors(cloud)
    for panel in panels:
        panel.points(cloud.points, colors, size=1)
        panel.lines(centers, ahead, colors=COLOR["camera"], lw=LINE["thin"])
        panel.marks(centers, MARK["camera"], COLOR["camera"], zorder=3, linewidths=None)
        cross: dict = {"marker": "+", "zorder": 4, "linewidths": None}
        panel.marks(target[None], MARK["stem"], COLOR["root"], **cross)
    return figure


def alignment_figure(
    aligned: PointCloud, poses: Poses, roi: Footprint | None, width_px: int
) -> Figure:
    """The aligned cloud with z = 0, its cameras, and the region `roi` that the crop kept.

    It reaches twice as far as the cameras.
    """
    low, high = poses.centers.min(axis=0), poses.centers.max(axis=0)
    middle, reach = (low + high) / 2, high - low
    inside = (np.abs(aligned.points - middle)[:, :2] < reach[:2]).all(axis=1)
    z = np.quantile(aligned.points[inside, 2], HEIGHT_SHARES) if inside.any() else low[2:]
    box = np.vstack([middle - reach, middle + reach, [*middle[:2], z[0]], [*middle[:2], z[-1]]])
    box[:2, 2] = middle[2]
    views = side_views(box, kinds=("front", "side", "top"))
    figure, panels = view_grid(views, "arbitrary", width_px, "Aligned cloud and region of interest")
    colors = cloud_colors(aligned)
    for panel in panels:
        axes_, view, _ = panel
        panel.points(aligned.points, colors, size=1)
        style: dict = {"zorder": 3, "linewidths": None}
        panel.marks(poses.centers, MARK["camera_aligned"], COLOR["camera"], **style)
        if view.name != "top":
            axes_.axhline(0, color=COLOR["level"], lw=LINE["thin"])
        if roi is None:
            continue
        border: dict = {"fill": False, "color": COLOR["level"], "lw": LINE["border"]}
        if view.name != "top":
            for limit in roi.limits()[:, 0 if view.name == "front" else 1]:
                axes_.axvline(limit, color=COLOR["level"], lw=LINE["thin"], ls=":")
        elif roi.box is None:
            axes_.add_patch(Circle(tuple(roi.center_xy), roi.radius, **border))
        else:
            axes_.add_patch(Rectangle(roi.box[0], *np.ptp(roi.box, axis=0), **border))
    return figure


def coverage_figure(coverage: dict, align: dict, width_px: int) -> Figure:
    """How many photos frame the region, and how many depth maps hold something there; front view.

    ``align.json`` is the way from COLMAP's frame, that of the coverage, to the aligned one.
    """
    center, radius = np.array(coverage["region"]["center"]), coverage["region"]["radius"]
    centers = voxel_centers(center, radius, np.array(coverage["cells"]), coverage["n_across"])
    centers = moved(centers, np.array(align["transform"]))
    size = coverage["voxel_size"]
    low = centers.min(axis=0)
    column, row = (np.round((centers[:, k] - low[k]) / size).astype(int) for k in (0, 2))
    figsize = width_px / DPI, LAYOUT["coverage_height"] * width_px / DPI
    figure = Figure(figsize=figsize, dpi=DPI, layout="constrained")
    titles = {"n_framing": "photos that frame it", "n_holding": "depth maps that hold something"}
    extent = (low[0], low[0] + size * (column.max() + 1), low[2], low[2] + size * (row.max() + 1))
    for panel, (name, title) in zip(figure.subplots(1, 2), titles.items()):
        picture = np.full((row.max() + 1, column.max() + 1), np.nan)
        np.fmax.at(picture, (row, column), np.array(coverage[name], dtype=float))
        drawn = panel.imshow(picture, origin="lower", extent=extent, cmap="viridis")
        panel.axhline(0, color=COLOR["level"], lw=LINE["thin"])
        panel.set_title(f"{title}, most along the view")
        figure.colorbar(drawn, ax=panel, shrink=LAYOUT["bar"])
    return figure


def denoise_figure(cropped: PointCloud, removed_by: np.ndarray, width_px: int) -> Figure:
    """What the filters removed, `removed_by` (n_cropped,) above 0, over what they kept."""
    removed = removed_by > 0
    denoised = cropped.select(~removed)
    views = side_views(denoised.points, kinds=("front", "top"))
    title = (
        f"Denoising removed {removed.sum():,} of {len(cropped):,} points "
        f"({removed.mean():.1%}), drawn in red"
    )
    figure, panels = view_grid(views, "arbitrary", width_px, title)
    # Pale, so that red stands out
    colors = GREY["paled"] + (1 - GREY["paled"]) * cloud_colors(denoised)
    for panel in panels:
        panel.points(denoised.points, colors, size=1)
        panel.points(cropped.points[removed], to_rgb(COLOR["camera"]), size=1)
    return figure


def contraction_figure(
    cloud: PointCloud, contracted: PointCloud, skeleton: Skeleton, width_px: int
) -> Figure:
    """The contracted points over the wood they came from."""
    title = "Contracted points over the wood"
    figure, panels = tree_grid(skeleton, width_px, title, cloud=cloud)
    for panel in panels:
        for label, color in ((Label.BRANCH, COLOR["branch"]), (Label.TRUNK, COLOR["trunk"])):
            panel.points(contracted.points[contracted["label"] == label], to_rgb(color))
    return figure


def example_figure(
    photos: list[Path], sky_folder: Path | None, depth_folder: Path | None
) -> Figure | None:
    """Three photos with their sky masks and depth maps; None where no photo can be read.

    Sky masks are ``{stem}.png`` in their folder; for the depths' see
    `cherrypicker.mvs.depth_rasters`.
    """
    picked = [photos[i] for i in np.linspace(0, len(photos) - 1, 5).astype(int)[1:-1]]
    rows = []
    for path in dict.fromkeys(picked):
        photo = _thumbnail(path)
        if photo is None:
            continue
        tiles: list[tuple] = [(path.name, photo, {}, None)]
        mask = _thumbnail(sky_folder / f"{path.stem}.png", "L") if sky_folder else None
        if mask is not None:
            image, sky = (
                np.asarray(each, dtype=np.float32) / 255.0
                for each in (photo, mask.resize(photo.size))
            )
            share = SKY_SHARE * sky[..., None]
            tinted = np.clip(image * (1 - share) + share * np.array(SKY_TINT), 0, 1)
            tiles.append(("sky mask", tinted, {}, None))
        depth = read_depth_raster(depth_folder, path.name) if depth_folder else None
        if depth is not None:
            tiles.append(("depth map", *_depth_tile(depth), None))
        rows.append(tiles)
    if not rows:
        return None
    wide, tall = rows[0][0][1].size
    side = LAYOUT["tile"] * min(1.0, wide / tall)  # a portrait's height, not its width
    return tile_grid(rows, (side, side * tall / wide + LAYOUT["tile_heading"]))


def _thumbnail(path: Path, mode: str = "RGB") -> Image.Image | None:
    """The image at tile size, as stored (EXIF orientation not applied); None if unreadable."""
    try:
        with Image.open(path) as image:
            side = int(LAYOUT["tile_px"])
            image.draft(mode, (side, side))
            tile = image.convert(mode)
            tile.thumbnail((side, side))
            return tile
    except UNREADABLE:
        return None


def _depth_tile(depth: np.ndarray) -> tuple[np.ndarray, dict]:
    step = max(max(depth.shape) // int(2 * LAYOUT["tile_px"]), 1)
    depth = depth[::step, ::step]
    if not (depth > 0).any():
        return np.zeros((*depth.shape, 3)), {}
    return np.divide(1.0, depth, where=depth > 0, out=np.full(depth.shape, np.nan)), {}


def marker_crops(scale: dict, poses: Poses, lenses: Any) -> list:
    """Choose the photos that show each used marker largest: three at most, of three markers.

    In ``scale.json`` markers have ``corners`` (4, 3) in the frame of `poses` and ``images``.
    Returns, per marker, its id, the photo's name and the corners in its pixels, (4, 2), of each
    photo.
    """
    chosen = []
    for marker in [m for m in scale.get("markers") or () if m.get("used") and m.get("corners")][:3]:
        crops = []
        for view in poses:
            in_camera = np.array(marker["corners"]) @ view.R.T + view.t
            if view.name in marker["images"] and (in_camera[:, 2] > 0).all():
                crops.append((marker["id"], view.name, lenses.to_photo(view.name, in_camera)))
        crops.sort(key=lambda crop: (-np.ptp(crop[2], axis=0).prod(), crop[1]))
        chosen.append(crops[:3])
    return chosen


def marker_figure(scale: dict, poses: Poses, lenses: Any, photos: list[Path]) -> Figure | None:
    """The markers as the photos show them, see `marker_crops`; None where no photo shows any."""
    paths = {path.name: path for path in photos}
    rows = [
        [
            tile
            for marker, name, corners in crops
            if (tile := _marker_tile(f"marker {marker}: {name}", paths.get(name), corners))
        ]
        for crops in marker_crops(scale, poses, lenses)
    ]
    return tile_grid(rows, (LAYOUT["marker_width"], LAYOUT["marker_height"]))


def _marker_tile(title: str, path: Path | None, corners: np.ndarray) -> tuple | None:
    """A tile of `tile_grid` around the corners; None of a missing or unreadable photo."""
    if path is None:
        return None
    middle = corners.mean(axis=0)
    half = np.ptp(corners, axis=0).max()
    try:
        with Image.open(path) as image:
            low = np.maximum(np.floor(middle - half), 0).astype(int)
            high = np.minimum(np.ceil(middle + half), image.size).astype(int)
            if (high - low < 2).any():
                return None
            zoom = LAYOUT["marker_px"] / float((high - low).max())
            wide, tall = (max(int(round(side * zoom)), 1) for side in high - low)
            tile = image.convert("RGB").crop((*low, *high)).resize((wide, tall))
    except UNREADABLE:
        return None
    return title, tile, {}, (np.vstack([corners, corners[:1]]) - low) * zoom - 0.5
