"""A tree's report: everything it has is loaded, drawn and put on one page that needs no network."""

import io
import logging
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib.figure import Figure
from PIL import Image

import cherrypicker
from cherrypicker.files import atomic_path, read_json, write_text
from cherrypicker.mvs.undistort import UndistortedPhotos
from cherrypicker.pointcloud import read_cloud
from cherrypicker.poses import read_poses
from cherrypicker.pruning.table import CUT_COLUMNS
from cherrypicker.report import figures as draw
from cherrypicker.report.accuracy import accuracy_section
from cherrypicker.report.branches import (
    BEARING_COLUMNS,
    LIGHT_COLUMNS,
    PIECE_COLUMNS,
    SKY_COLUMNS,
    branch_facts,
    branch_table,
    limb_sums,
    node_wood,
)
from cherrypicker.report.cameras import camera_views
from cherrypicker.report.edit_file import edit_file
from cherrypicker.report.pruning import cuts_by_axis, pruning_figure, pruning_section
from cherrypicker.report.scaffold import limb_section
from cherrypicker.report.stages import photo_section, scan_sections
from cherrypicker.report.style import DPI, LAYOUT
from cherrypicker.report.text import data_url, page_template, script_json, told, with_uncertainty
from cherrypicker.report.viewer import module_map, viewer_data
from cherrypicker.skeleton import read_skeleton
from cherrypicker.traits.branches import read_branches
from cherrypicker.traits.flags import advice_for
from cherrypicker.traits.table import LIMB_COLUMNS, TRAITS
from cherrypicker.units import unit_name

logger = logging.getLogger(__name__)
_OF_FAILED = "Change what is named and run again: the part and this page are made anew."
_JPEG = b"\xff\xd8"  # how such a file begins
_FILES = (
    *("traits.json", "branches.csv", "limbs.csv"),
    *("skeleton.graphml", "topology.graphml", "skeleton.swc", "skeleton.ply"),
    *("segmented.ply", "contracted.ply"),
)


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
    "contracted": _File(partial(read_cloud, required=("label",)), "contracted points", True),
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
    "denoised_by": _File(Path, "denoise.npz"),
    "sky_masks": _File(Path, "folder of sky masks"),
    "depth": _File(Path, "folder of the depths of each photo"),
    "coverage": _File(read_json, "dense/coverage.json"),
    "edits": _File(lambda path: Path(path).read_text("utf-8"), "hand corrections that it holds"),
    "photo_check": _File(read_json, "photo_check.json"),
    "light": _File(read_json, "light.json"),
    "light_axes": _File(partial(read_branches, columns=SKY_COLUMNS), "light.csv"),
    "pruning": _File(read_json, "pruning.json"),
    "cuts": _File(partial(read_branches, columns=CUT_COLUMNS), "pruning.csv"),
    "bearing": _File(read_json, "bearing.json"),
    "bearing_pieces": _File(partial(read_branches, columns=PIECE_COLUMNS), "bearing.csv"),
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


@dataclass(frozen=True)
class ReportOptions:
    """How much a page shows; the fields are the config keys of ``report``, and ``seed``."""

    viewer_points: int = 300_000
    figure_width_px: int = 1400
    seed: int = 0


def report_tree(
    about: Mapping[str, str],
    report: str | os.PathLike,
    files: Mapping[str, Any],
    options: ReportOptions,
    *,
    photos: Sequence = (),
    lacking: Sequence[str] = (),
) -> None:
    """Write a tree's report and its figures.

    ``about`` are ``tree``, ``date`` and ``series``, as in the table of trees. ``files`` are by
    `FILES`, None or empty for what the tree does not have; and ``cloud_figure``, ...,
    ``thumbnail_figure``, the PNG files to write. ``lacking`` tells which parts of the page failed
    and why, a line each.

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
    width = options.figure_width_px
    logger.info("drawing figures of %s points", f"{len(cloud):,}")
    drawn = {
        "cloud": draw.cloud_figure(cloud, skeleton, width),
        "label": draw.label_figure(cloud, skeleton, width),
        "skeleton": draw.skeleton_figure(cloud, skeleton, width),
        "topology": draw.topology_figure(skeleton, width),
        "trunk": draw.trunk_figure(cloud, traits, width),
    }
    pictures = {name: draw.png_of(figure, width) for name, figure in drawn.items()}
    figures = [(picture, CAPTIONS[name]) for name, picture in pictures.items()]
    small = draw.thumbnail(cloud, skeleton)
    pictures["thumbnail"] = draw.png_of(small, LAYOUT["thumbnail_px"])
    for name, picture in pictures.items():
        with atomic_path(files[f"{name}_figure"]) as temporary:
            temporary.write_bytes(picture)
    page = render_report(about, data, figures, options)
    write_text(report, page)
    logger.info("report of %.1f MB", len(page) / 1e6)


def render_report(
    about: Mapping[str, str], data: dict, figures: list, options: ReportOptions
) -> str:
    """Render the page; all text from data is escaped.

    The data are what the tree has by `FILES`, None for what it has not; ``photos`` (list of Path)
    and ``lacking`` (sequence of str). The figures are PNG and caption of those that every tree has.
    """
    traits, cloud = data["traits"], data["segmented"]
    unit = traits.get("unit", cloud.unit)
    width_px = options.figure_width_px
    sections = scan_sections(data, width_px)
    verdict = photo_section(data)
    for item in [*sections, *([verdict] if verdict else [])]:
        item["figures"] = [_embedded(width_px, *figure) for figure in item["figures"]]
    sky_shares = {row["branch_id"]: row["sky_share"] for row in data["light_axes"] or ()}
    cuts = cuts_by_axis(data["cuts"] or ())
    branches = []
    for row in data["branches"]:
        light, cut = sky_shares.get(row["branch_id"]), cuts.get(row["branch_id"])
        facts = branch_facts(row | {"sky_share": light, "cuts": cut}, unit)
        branches.append({"facts": facts, "there": row.get("p_exists"), "light": light})
    pruning = pruning_section(data["pruning"], data["cuts"])
    if pruning and data["cuts"]:
        drawn = pruning_figure(data["skeleton"], data["cuts"], 2 * width_px // 3)
        picture = draw.png_of(drawn, width_px)
        caption = "What goes in red; the numbers of the cuts."
        pruning["figure"] = _embedded(width_px, picture, caption)
    viewer = viewer_data(
        data["skeleton"],
        cloud,
        n_points=options.viewer_points,
        branches=branches,
        wood=node_wood(data["skeleton"], data["bearing_pieces"]),
        removed=data["removed"],
        cameras=_cameras(data),
        edits=edit_file(about["tree"], data["edits"] or ""),
        date=about["date"],
        seed=options.seed,
    )
    measured = data["measures"]["measures"] if data["measures"] else ()
    stages = ("sparse", "align_report", "crop_report", "scale", "contract_report")
    found = [str(line) for name in stages for line in (data[name] or {}).get("warnings") or ()]
    warnings = [*map(str, traits.get("flags", [])), *dict.fromkeys(found)]
    return page_template("report.html.j2").render(
        about=about,
        is_from_photos=bool(data["sparse"]),
        warnings=[{"text": line, "advice": _OF_FAILED} for line in data["lacking"]]
        + [{"text": line, "advice": advice_for(line)} for line in warnings],
        traits=traits,
        trait_rows=_trait_rows(traits, unit),
        trunk=TRAITS["trunk_diameter_m"],
        flags=[str(flag).split(":")[0] for flag in traits.get("flags", [])],
        order_color=draw.order_color,
        is_scale_known=unit == "m" and (data["scale"] or {}).get("scale_std"),
        is_metric=unit == "m",
        unit=unit_name(unit),
        viewer=script_json(viewer),
        modules=module_map(),
        branches=branch_table(data["branches"]),
        n_shown=f"{min(len(cloud), options.viewer_points):,}",
        n_points=f"{len(cloud):,}",
        figures=[_embedded(width_px, *figure) for figure in figures],
        scaffold=limb_section(traits, data["limbs"], data["skeleton"]),
        light=limb_sums(LIGHT_COLUMNS, data["light"]),
        pruning=pruning,
        bearing=limb_sums(BEARING_COLUMNS, data["bearing"]),
        verdict=verdict,
        accuracy=accuracy_section([{**pair, "tree": "", "href": ""} for pair in measured]),
        stages=sections,
        files=[
            *_FILES,
            *(
                f"{name}.{end}"
                for name in ("light", "pruning", "bearing")
                if data[name]
                for end in ("csv", "json")
            ),
            *(["buds.csv"] if "bud_noise_m" in (data["bearing"] or ()) else []),
        ],
        version=cherrypicker.__version__,
    )


def _embedded(width_px: int, figure: Figure | bytes, caption: str, name: str = "") -> dict:
    """A figure for the page: a JPEG as it is, any other as WebP that loses nothing."""
    if isinstance(figure, Figure):
        figure = draw.png_of(figure, min(width_px, DPI * figure.get_size_inches()[0]))
    if figure.startswith(_JPEG):
        return {"src": data_url("image/jpeg", figure), "caption": caption, "id": name}
    with Image.open(io.BytesIO(figure)) as image, io.BytesIO() as stream:
        image.save(stream, "WEBP", lossless=True)
        return {"src": data_url("image/webp", stream.getvalue()), "caption": caption, "id": name}


def _cameras(data: dict) -> list[dict]:
    """The cameras of a scan from photos; the photos that were judged have a figure of their own."""
    poses, check = data["metric_poses"], data["photo_check"] or {}
    if poses is None:
        return []
    pictures = {check[name]: f"{name}_photo" for name in ("best", "worst") if name in check}
    read = None
    if data["cameras"] and data["photos"]:
        read = UndistortedPhotos(data["cameras"], data["photos"]).read
    return camera_views(poses, read, pictures)


def _trait_rows(traits: dict, unit: str) -> list[tuple[str, str, str]]:
    """Title, value and interval of what stands below "Traits"."""
    rows = []
    for name, trait in TRAITS.items():
        if trait.is_shown:
            interval = traits.get(f"{name}_ci90") or ()
            ends = [with_uncertainty(end, None, trait, unit).split(" ")[0] for end in interval]
            shown, between = told(traits, name, unit), " to ".join(ends)
            if name in traits.get("at_least", ()):
                shown, between = f"at least {shown}", f"{ends[0]} and more" if ends else ""
            rows.append((trait.title, shown, between))
    return rows
