"""The report of one tree: a single HTML file that needs no network."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from operator import itemgetter

from matplotlib.figure import Figure
from PIL import Image

import cherrypicker
from cherrypicker.mvs.undistort import UndistortedPhotos
from cherrypicker.report.accuracy import accuracy_section
from cherrypicker.report.bearing import node_wood
from cherrypicker.report.branches import (
    BEARING_COLUMNS,
    LIGHT_COLUMNS,
    branch_facts,
    branch_table,
    limb_sums,
)
from cherrypicker.report.cameras import camera_views
from cherrypicker.report.edit_file import edit_file
from cherrypicker.report.figures import order_color, write_png
from cherrypicker.report.pruning import cuts_by_axis, pruning_figure, pruning_section
from cherrypicker.report.scaffold import limb_section
from cherrypicker.report.stages import photo_section, scan_sections
from cherrypicker.report.style import DPI
from cherrypicker.report.text import data_url, page_template, script_json, told, with_uncertainty
from cherrypicker.report.viewer import module_map, viewer_data
from cherrypicker.traits.flags import advice_for
from cherrypicker.traits.table import TRAITS
from cherrypicker.units import unit_name

_ZOOM = 1.5  # of a figure's own px that are drawn at most
_JPEG_QUALITY, _JPEG_PAYS = 85, 0.5  # a figure is a JPEG where it takes under half of its PNG
_OF_FAILED = "Change what is named and run again: the part and this page are made anew."
_JPEG = b"\xff\xd8"  # how such a file begins
_FILES = (
    *("traits.json", "branches.csv", "limbs.csv"),
    *("skeleton.graphml", "topology.graphml", "skeleton.swc", "skeleton.ply"),
    *("segmented.ply", "contracted.ply"),
)


@dataclass(frozen=True)
class ReportOptions:
    """How much a page shows; the fields are the config keys of ``report``."""

    viewer_points: int = 300_000
    figure_width_px: int = 1400
    n_examples: int = 3


def render_report(
    about: Mapping[str, str],
    data: dict,
    figures: list,
    options: ReportOptions,
    *,
    seed: int = 0,
) -> str:
    """Render the report.

    Parameters
    ----------
    about : mapping of str to str
        ``tree``, ``date`` and ``series``.
    data : dict
        What the tree has, as `cherrypicker.report.tree` loads it by its `FILES`, None for what it
        has not; ``photos`` (list of Path), ``lacking`` (sequence of str) and ``foot`` (ndarray of
        shape (3,)).
    figures : list of tuple (bytes, str)
        PNG and caption of the figures that every tree has.

    Returns
    -------
    str
        The page. All text from data is escaped.
    """
    traits, cloud = data["traits"], data["segmented"]
    unit = traits.get("unit", cloud.unit)
    width_px = options.figure_width_px
    sections = scan_sections(data, width_px=width_px, n_examples=options.n_examples)
    verdict = photo_section(data)
    for item in [*sections, *([verdict] if verdict else [])]:
        item["figures"] = [_embedded(width_px, *figure) for figure in item["figures"]]
    sky_shares = data["light_axes"] or {}
    cuts = cuts_by_axis(data["cuts"] or ())
    branches = []
    for row in data["branches"]:
        light, cut = sky_shares.get(row["branch_id"]), cuts.get(row["branch_id"])
        facts = branch_facts(row | {"sky_share": light, "cuts": cut}, unit)
        branches.append({"facts": facts, "there": row.get("p_exists"), "light": light})
    pruning = pruning_section(data["pruning"], data["cuts"])
    if pruning and data["cuts"]:
        drawn = pruning_figure(data["skeleton"], data["cuts"], 2 * width_px // 3)
        pruning["figure"] = _embedded(width_px, drawn, "What goes in red; the numbers of the cuts.")
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
        seed=seed,
    )
    measured = data["measures"]["measures"] if data["measures"] else ()
    return page_template("report.html.j2").render(
        about=about,
        is_from_photos=bool(data["sparse"]),
        warnings=_warnings(data),
        traits=traits,
        trait_rows=_trait_rows(traits, unit),
        trunk=TRAITS["trunk_diameter_m"],
        flags=[str(flag).split(":")[0] for flag in traits.get("flags", [])],
        order_color=order_color,
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
        light=limb_sums(
            [column for column in LIGHT_COLUMNS if column.name in (data["light"] or {})],
            data["light"],
        ),
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
        ],
        version=cherrypicker.__version__,
    )


def _embedded(width_px: int, figure: Figure | bytes, caption: str, name: str = "") -> dict:
    """A figure for the page: of photos or points a JPEG, which is smaller, any other as it is."""
    if isinstance(figure, Figure):
        stream = io.BytesIO()
        write_png(figure, stream, min(width_px, _ZOOM * DPI * figure.get_size_inches()[0]))
        figure = stream.getvalue()
    if not figure.startswith(_JPEG):
        stream = io.BytesIO()
        with Image.open(io.BytesIO(figure)) as image:
            image.convert("RGB").save(stream, "JPEG", quality=_JPEG_QUALITY, subsampling=0)
        if len(stream.getvalue()) < _JPEG_PAYS * len(figure):
            figure = stream.getvalue()
    kind = "image/jpeg" if figure.startswith(_JPEG) else "image/png"
    return {"src": data_url(kind, figure), "caption": caption, "id": name}


def _cameras(data: dict) -> list[dict]:
    """The cameras of a scan from photos; the photos that were judged have a figure of their own."""
    poses, check = data["metric_poses"], data["photo_check"] or {}
    if poses is None:
        return []
    judged = [photo for photo in check.get("photos", ()) if photo["share_right"] is not None]
    pictures = {}
    if judged:
        best, worst = (find(judged, key=itemgetter("share_right"))["name"] for find in (max, min))
        pictures = {best: "best_photo", worst: "worst_photo"}
    read = None
    if data["cameras"] and data["photos"]:
        read = UndistortedPhotos(data["cameras"], data["photos"]).read
    return camera_views(poses, read, pictures)


def _warnings(data: dict) -> list[dict]:
    """What failed, the traits' flags with what the choice of the target doubts, the stages' own."""
    stages = ("sparse", "align_report", "crop_report", "scale", "contract_report")
    found = [str(line) for name in stages for line in (data[name] or {}).get("warnings") or ()]
    lines = [*map(str, data["traits"].get("flags", [])), *dict.fromkeys(found)]
    failed = [{"text": line, "advice": _OF_FAILED} for line in data["lacking"]]
    return failed + [{"text": line, "advice": advice_for(line)} for line in lines]


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
