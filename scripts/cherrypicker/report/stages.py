"""What the report says about each stage: facts, tables and figures from the stages' own reports.

Stages that a tree did not go through have no section; a report that lacks a fact is shown without.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from cherrypicker.lens import PhotoLenses
from cherrypicker.placement.footprint import Footprint
from cherrypicker.report.marker_figure import marker_figure
from cherrypicker.report.stage_figures import (
    alignment_figure,
    camera_figure,
    contraction_figure,
    coverage_figure,
    denoise_figure,
    example_figure,
)
from cherrypicker.units import unit_name

logger = logging.getLogger(__name__)

_SOURCES = {
    "region": "what the cameras look at",
    "camera_box": "the box of the cameras and of what lies before them",
    "cameras": "the box of the cameras",
}


def section(name: str, facts: Sequence = (), tables: Sequence = (), figures: Sequence = ()) -> dict:
    """A section of the page; facts without a value are left out.

    A figure is drawn or JPEG bytes, its caption and, where something refers to it, its id.
    """
    return {
        "name": name,
        "facts": [(key, value) for key, value in facts if value not in (None, "")],
        "tables": [table for table in tables if table["rows"]],
        "figures": [figure for figure in figures if figure[0] is not None],
    }


def table(caption: str, head: list[str], rows: list, *, is_open: bool = False) -> dict:
    """A table that the reader can open."""
    return {"caption": caption, "head": head, "rows": rows, "open": is_open}


def scan_sections(data: dict, *, width_px: int, n_examples: int) -> list:
    """Sections on everything between the photos and the traits.

    Parameters
    ----------
    data : dict
        See `cherrypicker.report.page.render_report`.
    """
    sections = []
    if data["sparse"]:
        sections.append(_sparse(data, width_px))
    if data["photos"] and n_examples:
        sections.append(_examples(data, n_examples))
    if data["align_report"]:
        sections.append(_aligned(data, width_px))
    if data["align_report"] and data["coverage"]:
        sections.append(_covered(data, width_px))
    if data["denoise_report"]:
        sections.append(_denoised(data, width_px))
    if data["scale"]:
        sections.append(_scaled(data))
    if data["target"]:
        sections.append(_target(data["target"]))
    sections.append(_contracted(data, width_px))
    return sections


def _sparse(data: dict, width_px: int) -> dict:
    report = data["sparse"]
    error = report.get("camera_error_px") or {}
    facts = [
        ("Photos used", f"{report.get('n_registered')} of {report.get('n_photos')}"),
        ("Left out for their cameras' errors", report.get("n_left_out")),
        ("Median error of a camera at the tree", _number(error.get("median"), 2, " px")),
        ("Sparse points", _count(report.get("n_points"))),
        ("Mean track length", _number(report.get("mean_track_length"), 1)),
        ("Mean reprojection error", _number(report.get("mean_reprojection_error_px"), 2, " px")),
        ("Mapper", report.get("mapper")),
    ]
    photos = report.get("photos") or {}
    head = ["photo", "reason", "features", "matches"]
    tables = []
    for key, title in (("reason", "photos are not used"), ("doubt", "used photos are doubtful")):
        rows = [
            [name, info[key], info.get("n_features", ""), info.get("n_matches", "")]
            for name, info in sorted(photos.items())
            if info.get(key)
        ]
        tables.append(table(f"{len(rows)} {title}", head, rows, is_open=True))
    figures = []
    if data["metric_poses"] is not None:
        figure = camera_figure(data["metric_poses"], data["segmented"], data["foot"], width_px)
        figures.append((figure, "Registered photos and the way they look; the cross is the stem."))
    return section("Photos and sparse model", facts, tables, figures)


def _examples(data: dict, n_examples: int) -> dict:
    registered = set(data["metric_poses"].names) if data["metric_poses"] is not None else set()
    photos = [path for path in data["photos"] if path.name in registered] or data["photos"]
    figure = example_figure(photos, data["sky_masks"], data["depth"], n_examples)
    caption = "Example photos with their sky masks (blue) and depth maps (near is bright)."
    return section("Sky and depth", figures=[(figure, caption)])


def _gravity(report: dict) -> str | None:
    """How many photos state gravity, and how well they agree; None where it is not used."""
    if not report.get("gravity_is_used"):
        return None
    return f"{report['gravity_n_photos']}, to {_number(report['gravity_spread_deg'], 1, '°')}"


def _aligned(data: dict, width_px: int) -> dict:
    report, crop = data["align_report"], data["crop_report"] or {}
    facts = [
        ("Up decided by", report.get("up_from")),
        ("Up to the ground's normal", _number(report.get("up_to_ground_deg"), 2, "°")),
        ("Up to the cameras' up", _number(report.get("up_to_cameras_deg"), 2, "°")),
        ("Photos whose gravity is used", _gravity(report)),
        ("Region of interest", _SOURCES.get(str(crop.get("source")))),
        ("Points kept by the crop", _kept(crop.get("n_kept"), crop.get("n_points"))),
    ]
    figures = []
    if data["aligned"] is not None and data["aligned_poses"] is not None:
        roi = Footprint.from_dict(crop) if crop else None
        figure = alignment_figure(data["aligned"], data["aligned_poses"], roi, width_px)
        figures.append(
            (figure, "Aligned cloud: ground at z = 0, the region that was kept, cameras.")
        )
    return section("Alignment and crop", facts, figures=figures)


def _covered(data: dict, width_px: int) -> dict:
    """The region of interest in voxels; nothing where the cameras look at no common place."""
    coverage = data["coverage"]
    if coverage.get("region") is None:
        return section("Coverage", [("Region", "the cameras look at no common place")])
    framing, holding = (np.array(coverage[f"n_{name}"]) for name in ("framing", "holding"))
    facts = [
        ("Voxels of the region", _count(len(framing))),
        ("Photos that frame a voxel, median", _number(float(np.median(framing)), 0)),
        ("Voxels that three photos or more frame", f"{100 * np.mean(framing >= 3):.0f} %"),
        ("Voxels with something in a depth map", f"{100 * np.mean(holding > 0):.0f} %"),
    ]
    figure = coverage_figure(coverage, data["align_report"], width_px)
    caption = "The place that the cameras look at: the more photos frame a part, the surer it is."
    return section("Coverage", facts, figures=[(figure, caption)])


def _denoised(data: dict, width_px: int) -> dict:
    report = data["denoise_report"]
    facts = [
        ("Removed as outliers", _kept(report.get("n_removed_statistical"), report.get("n_input"))),
        ("Points of a sky colour", _count(report.get("n_sky_colored"))),
        ("of these spared by the photos", _count(report.get("n_kept_by_photos"))),
        ("Removed as sky", _kept(report.get("n_removed_sky"), report.get("n_input"))),
        ("Left", _kept(report.get("n_output"), report.get("n_input"))),
    ]
    figures = []
    if data["cropped"] is not None and data["denoised"] is not None:
        figure = denoise_figure(data["cropped"], data["denoised"], width_px)
        figures.append((figure, "Points that the filters removed (red)."))
    return section("Denoising", facts, figures=figures)


def _scaled(data: dict) -> dict:
    scale = data["scale"]
    is_metric = scale.get("unit", "m") == "m"
    value, spread = scale.get("scale"), scale.get("scale_std")
    shown = _number(value, 6) if is_metric else "none: lengths are in arbitrary units"
    if is_metric and value and spread:
        shown = f"{value:.6g} ± {spread:.2g} m per unit ({100 * spread / value:.2f} %)"
    facts = [
        ("Scale", shown),
        ("From", scale.get("mode")),
        ("Photos with a marker", scale.get("n_images") or None),
        ("Rays", scale.get("n_rays") or None),
        ("Markers that the table does not name", _ids(scale.get("other_markers"))),
        ("Places where one may stand", _ids(scale.get("unsolved_markers"))),
        ("False reads", _ids(scale.get("false_reads"))),
    ]
    rows = [_marker_row(marker) for marker in scale.get("markers") or []]
    head = ["marker", "used", "side [m]", "sides in the model's units", "RMS error [px]"]
    head += ["sightings that agree", "remarks"]
    tables = [table(f"{len(rows)} marker(s)", head, rows, is_open=True)]
    known = [_reference_row(one) for one in scale.get("references") or []]
    heads = ["known length", "used", "length [m]", "scale [m per unit]", "off the others' scale"]
    tables.append(table(f"{len(known)} known length(s)", [*heads, "remarks"], known, is_open=True))
    figures = []
    if data["poses"] is not None and data["cameras"] is not None:
        lenses = PhotoLenses(data["cameras"], data["poses"].names)
        figure = marker_figure(scale, data["poses"], lenses, data["photos"])
        figures.append((figure, "Markers with the corners in 3D drawn back into the photos (red)."))
    return section("Scale", facts, tables, figures)


def _ids(found: list[dict] | None) -> str | None:
    """Ids of what was read as markers, with the number of photos."""
    return ", ".join(f"{one['id']} ({one['n_images']} photos)" for one in found or ()) or None


def _reference_row(one: dict) -> list:
    """A known length, and what the others say about it."""
    check, scale = one.get("check"), one.get("scale")
    off = check and (
        f"{100 * check['difference']:+.2f} ± {100 * check['difference_std']:.2f} % "
        f"({', '.join(check['against'])})"
    )
    return [
        one.get("name"),
        "yes" if one.get("used") else "no",
        _number(one.get("length_m"), 4) or "",
        f"{scale:.6g} ± {one['scale_std']:.2g}" if scale else "",
        off or "",
        "; ".join(str(flag) for flag in one.get("flags") or []),
    ]


def _marker_row(marker: dict) -> list:
    sides = [float(side) for side in marker.get("side_lengths") or []]
    return [
        marker.get("id"),
        "yes" if marker.get("used", True) else "no",
        _number(marker.get("side_m"), 4),
        ", ".join(f"{side:.5g}" for side in sides),
        _number(marker.get("rms_reprojection_px"), 3) or "",
        f"{marker.get('n_inliers', '')} of {marker.get('n_detections', '')}",
        "; ".join(str(flag) for flag in marker.get("flags") or []),
    ]


def _target(report: dict) -> dict:
    length = unit_name(report.get("unit", "m"))
    margin, other = report.get("margin"), report.get("runner_up")
    by = "crop.target_xy" if report.get("source") == "config" else "its wood"
    facts = [
        ("Chosen by", by),
        ("Runner-up", _place(other["base"], length) if other else "none"),
        ("Lead over it", f"{100 * margin:.0f} % of the score" if other and margin else None),
    ]
    rows = [
        [
            "target" if one.get("is_target") else "",
            _place(one["base"], length),
            _count(one["mass"]),
            _number(one["height"], 2),
            _number(one["distance"], 2) or "–",
            _number(one["score"], 2),
            ", ".join(f"{value:g}" for value in one["crop_target_xy"]),
        ]
        for one in report.get("candidates") or []
    ]
    head = ["", "foot", "wood [voxels]", f"height [{length}]", f"off the middle [{length}]"]
    head += ["score", "crop.target_xy"]
    caption = f"{len(rows)} candidate(s): wood near what the cameras look at, times its height"
    return section("Target", facts, [table(caption, head, rows, is_open=len(rows) > 1)])


def _place(base: list[float], length: str) -> str:
    return f"x {base[0]:.2f}, y {base[1]:.2f} {length}"


def _contracted(data: dict, width_px: int) -> dict:
    report = data["contract_report"] or {}
    facts = [
        ("Method", report.get("method")),
        ("Iterations", report.get("n_iterations") or report.get("iterations")),
        ("Contracted points", _count(len(data["contracted"]))),
    ]
    facts = [(name, value) for name, value in facts if not isinstance(value, dict | list)]
    figure = contraction_figure(data["segmented"], data["contracted"], data["skeleton"], width_px)
    return section("Contraction", facts, figures=[(figure, "Contracted points over the wood.")])


def photo_section(data: dict) -> dict | None:
    """What the photos say of the skeleton; None without photos."""
    check = data["photo_check"]
    if not check:
        return None
    length = unit_name(check["unit"])

    def of(part: str, whole: str) -> str:
        return f"{check[part]:.2f} of {check[whole]:.2f} {length}"

    facts = [
        ("Precision by the photos", _number(check["photo_precision"], 3)),
        ("Recall by the photos", _number(check["photo_recall"], 3)),
        ("Skeleton that has sky behind it in the photos", of("judged_length", "length")),
        ("Skeleton that is likely not there", of("refuted_length", "length")),
        ("Thin wood that the skeleton lacks", f"{check['missing_length']:.2f} {length}"),
        ("of this not in the cloud either", f"{check['missing_from_cloud_length']:.2f} {length}"),
        ("Likely missing where no sky is behind", f"{check['unseen_length']:.2f} {length}"),
    ]
    if before := check["before"]:
        facts += [
            ("Dropped, for it is likely not there", f"{before['dropped_length']:.2f} {length}"),
            ("Precision by the photos before", _number(before["photo_precision"], 3)),
        ]
    head = ["", *(f"{what} [{length}]" for what in ("length", "judged", "refuted"))]
    tables = []
    for caption, key in (("By order", "by_order"), ("By radius, mm", "by_radius_mm")):
        rows = [[name, *(f"{v:.2f}" for v in each.values())] for name, each in check[key].items()]
        tables.append(table(caption, head, rows))
    layers = [
        [f"{layer['from']:.2f} to {layer['to']:.2f}", f"{layer['length']:.2f}"]
        for layer in reversed(check["missing_by_height"])
    ]
    tables.append(table("Missing wood by height", [f"z [{length}]", f"length [{length}]"], layers))
    stands = [
        [
            f"{stand['azimuth_deg']}",
            f"{stand['distance']:.1f}",
            f"{stand['height']:.1f}",
            ", ".join(f"{value:.2f}" for value in stand["at"]),
            f"{stand['unsure_length']:.2f}",
        ]
        for stand in check["photograph_again"]
    ]
    if stands:
        head = ["azimuth [°]", f"from the stem [{length}]", f"height [{length}]"]
        head += [f"look at x, y, z [{length}]", f"would tell [{length}]"]
        caption = "Photograph here again: what is unsure would stand before the sky"
        tables.insert(0, table(caption, head, stands, is_open=True))
    if silent := _silent(check["photos"]):
        caption = "Photos whose word counts little: off, blurred, or their mask is wrong"
        tables.append(table(caption, ["photo", "clear sky says [log]"], silent))
    pictures = [
        (
            data[f"{which}_photo"],
            f"The {which} photo, and the skeleton over it: green where wood is likely there, blue "
            "where the photos cannot tell, red where it is likely not; orange is thin wood that "
            "the skeleton lacks, purple what was more likely not there and is dropped.",
            f"{which}_photo",
        )
        for which in ("worst", "best")
    ]
    return section("What the photos say", facts, tables, pictures)


def _silent(photos: list[dict]) -> list[list[str]]:
    """Photos that know less than a third of what half of them do, those that know least first."""
    known = [photo["word_of_clear_sky"] for photo in photos]
    limit = float(np.median(known)) / 3 if known else 0.0
    rows = sorted(zip(known, (photo["name"] for photo in photos), strict=True), reverse=True)
    return [[name, f"{word:.1f}"] for word, name in rows if word > limit]


def _number(value: float | None, decimals: int, unit: str = "") -> str | None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        return None
    return f"{value:,.{decimals}f}{unit}"


def _count(value: int | None) -> str | None:
    return f"{value:,}" if isinstance(value, int) and not isinstance(value, bool) else None


def _kept(part: int | None, whole: int | None) -> str | None:
    if not isinstance(part, int) or not isinstance(whole, int) or not whole:
        return None
    return f"{part:,} of {whole:,} ({100 * part / whole:.1f} %)"
