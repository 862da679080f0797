"""What the report says about each stage: facts, tables and figures from the stages' own reports.

Stages that a tree did not go through have no section; a report that lacks a fact is shown without.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cherrypicker.lens import Lenses
from cherrypicker.placement.footprint import Footprint
from cherrypicker.report import stage_figures as draw
from cherrypicker.report.text import tell, tell_all
from cherrypicker.units import unit_name
from cherrypicker.wood.removed import read_removed_by

_SOURCES = {
    "region": "what the cameras look at",
    "camera_box": "the box of the cameras and of what lies before them",
    "cameras": "the box of the cameras",
}


def section(
    name: str,
    report: Mapping[str, Any],
    facts: Mapping[str, str],
    tables: Sequence[dict] = (),
    figures: Sequence[tuple] = (),
) -> dict:
    """A section of the page, without what there is not.

    What is told of a stage's report are ``facts``, as formats for `tell_all`; the tables are from
    `table`. A figure is a drawn one or JPEG bytes, its caption and, where something refers to it,
    its id.
    """
    return {
        "name": name,
        "facts": tell_all(facts, report),
        "tables": [table for table in tables if table["rows"]],
        "figures": [figure for figure in figures if figure[0] is not None],
    }


def table(
    caption: str, columns: Mapping[str, str], records: Sequence[Mapping], *, is_open: bool = False
) -> dict:
    """A table that the reader can open: its columns are formats for `tell` by their heads."""
    rows = [[tell(text, record) for text in columns.values()] for record in records]
    return {"caption": caption, "head": list(columns), "rows": rows, "open": is_open}


def scan_sections(data: dict, width_px: int) -> list:
    """Sections on all between photos and traits; `data` as of `cherrypicker.report.tree`."""
    found = [
        data["sparse"] and _sparse(data, width_px),
        data["photos"] and _examples(data),
        data["align_report"] and _aligned(data, width_px),
        data["align_report"] and data["coverage"] and _covered(data, width_px),
        data["denoise_report"] and _denoised(data, width_px),
        data["scale"] and _scaled(data),
        data["target"] and _target(data["target"]),
        _contracted(data, width_px),
    ]
    return [one for one in found if one]


def _sparse(data: dict, width_px: int) -> dict:
    report = data["sparse"]
    facts = {
        "Photos used": "{n_registered} of {n_photos}",
        "Left out for their cameras' errors": "{n_left_out}",
        "Median error of a camera at the tree": "{camera_error_px[median]:,.2f} px",
        "Sparse points": "{n_points:,}",
        "Mean track length": "{mean_track_length:,.1f}",
        "Mean reprojection error": "{mean_reprojection_error_px:,.2f} px",
    }
    photos = [{"name": name, **info} for name, info in sorted((report.get("photos") or {}).items())]
    tables = []
    for key, title in (("reason", "photos are not used"), ("doubt", "used photos are doubtful")):
        found = [photo for photo in photos if photo.get(key)]
        columns = {"photo": "{name}", "reason": f"{{{key}}}"}
        columns |= {"features": "{n_features}", "matches": "{n_matches}"}
        tables.append(table(f"{len(found)} {title}", columns, found, is_open=True))
    figure, poses = None, data["metric_poses"]
    if poses is not None:
        foot = np.array(data["traits"]["foot"])
        figure = draw.camera_figure(poses, data["segmented"], foot, width_px)
    caption = "Registered photos and the way they look; the cross is the stem."
    return section("Photos and sparse model", report, facts, tables, [(figure, caption)])


def _examples(data: dict) -> dict:
    registered = set(data["metric_poses"].names) if data["metric_poses"] is not None else set()
    photos = [path for path in data["photos"] if path.name in registered] or data["photos"]
    figure = draw.example_figure(photos, data["sky_masks"], data["depth"])
    caption = "Example photos with their sky masks (blue) and depth maps (near is bright)."
    return section("Sky and depth", {}, {}, figures=[(figure, caption)])


def _aligned(data: dict, width_px: int) -> dict:
    report, crop = data["align_report"], data["crop_report"] or {}
    gravity = "{gravity_n_photos}, to {gravity_spread_deg:,.1f}°"
    facts = {
        "Up decided by": "{up_from}",
        "Up to the ground's normal": "{up_to_ground_deg:,.2f}°",
        "Up to the cameras' up": "{up_to_cameras_deg:,.2f}°",
        "Photos whose gravity is used": gravity if report.get("gravity_is_used") else "",
        "Region of interest": _SOURCES.get(str(crop.get("source")), ""),
        "Points kept by the crop": _share(crop, "n_kept", "n_points"),
    }
    figure, cloud, poses = None, data["aligned"], data["aligned_poses"]
    if cloud is not None and poses is not None:
        roi = Footprint.from_dict(crop) if crop else None
        figure = draw.alignment_figure(cloud, poses, roi, width_px)
    caption = "Aligned cloud: ground at z = 0, the region that was kept, cameras."
    return section("Alignment and crop", report, facts, figures=[(figure, caption)])


def _covered(data: dict, width_px: int) -> dict:
    """The region of interest in voxels; nothing where the cameras look at no common place."""
    coverage = data["coverage"]
    if coverage.get("region") is None:
        return section("Coverage", {}, {"Region": "the cameras look at no common place"})
    framing, holding = (np.array(coverage[f"n_{name}"]) for name in ("framing", "holding"))
    facts = {
        "Voxels of the region": f"{len(framing):,}",
        "Photos that frame a voxel, median": f"{np.median(framing):,.0f}",
        "Voxels that three photos or more frame": f"{100 * np.mean(framing >= 3):.0f} %",
        "Voxels with something in a depth map": f"{100 * np.mean(holding > 0):.0f} %",
    }
    figure = draw.coverage_figure(coverage, data["align_report"], width_px)
    caption = "The place that the cameras look at: the more photos frame a part, the surer it is."
    return section("Coverage", {}, facts, figures=[(figure, caption)])


def _denoised(data: dict, width_px: int) -> dict:
    report = data["denoise_report"]
    facts = {
        "Removed as outliers": _share(report, "n_removed_statistical", "n_input"),
        "Points of a sky colour": "{n_sky_colored:,}",
        "of these spared by the photos": "{n_kept_by_photos:,}",
        "Removed as sky": _share(report, "n_removed_sky", "n_input"),
        "Left": _share(report, "n_output", "n_input"),
    }
    figure, before, removed = None, data["cropped"], data["denoised_by"]
    if before is not None and removed is not None:
        figure = draw.denoise_figure(before, read_removed_by(removed, before), width_px)
    caption = "Points that the filters removed (red)."
    return section("Denoising", report, facts, figures=[(figure, caption)])


def _share(report: Mapping[str, Any], part: str, whole: str) -> str:
    """A count and its share of another; empty where the report lacks either."""
    if report.get(part) is None or not report.get(whole):
        return ""
    return f"{report[part]:,} of {report[whole]:,} ({100 * report[part] / report[whole]:.1f} %)"


def _scaled(data: dict) -> dict:
    scale = data["scale"]
    value, spread = scale.get("scale"), scale.get("scale_std")
    told = "{scale:,.6f}"
    if scale.get("unit", "m") != "m":
        told = "none: lengths are in arbitrary units"
    elif value and spread:
        told = f"{{scale:.6g}} ± {{scale_std:.2g}} m per unit ({100 * spread / value:.2f} %)"
    ids = {
        name: ", ".join(f"{one['id']} ({one['n_images']} photos)" for one in scale.get(name) or ())
        for name in ("other_markers", "unsolved_markers", "false_reads")
    }
    facts = {
        "Scale": told,
        "From": "{mode}",
        "Photos with a marker": "{n_images}",
        "Rays": "{n_rays}",
        "Markers that the table does not name": "{other_markers}",
        "Places where one may stand": "{unsolved_markers}",
        "False reads": "{false_reads}",
    }
    markers = [_as_told(one) for one in scale.get("markers") or ()]
    columns = {
        "marker": "{id}",
        "used": "{used}",
        "side [m]": "{side_m:,.4f}",
        "sides in the model's units": "{sides}",
        "RMS error [px]": "{rms_reprojection_px:,.3f}",
        "sightings that agree": "{n_inliers} of {n_detections}",
        "remarks": "{remarks}",
    }
    tables = [table(f"{len(markers)} marker(s)", columns, markers, is_open=True)]
    lengths = [_as_told(one) for one in scale.get("references") or ()]
    columns = {
        "known length": "{name}",
        "used": "{used}",
        "length [m]": "{length_m:,.4f}",
        "scale [m per unit]": "{scale:.6g} ± {scale_std:.2g}",
        "off the others' scale": "{off:+.2f} ± {off_std:.2f} % ({against})",
        "remarks": "{remarks}",
    }
    tables.append(table(f"{len(lengths)} known length(s)", columns, lengths, is_open=True))
    figure, poses = None, data["poses"]
    if poses is not None and data["cameras"] is not None:
        figure = draw.marker_figure(scale, poses, Lenses(data["cameras"]), data["photos"])
    caption = "Markers with the corners in 3D drawn back into the photos (red)."
    # A count of 0 says nothing
    record = {name: value or None for name, value in (scale | ids).items()}
    return section("Scale", record, facts, tables, [(figure, caption)])


def _as_told(one: Mapping[str, Any]) -> dict:
    """A marker or a known length as its table tells it, and what the others say about it."""
    check = one.get("check")
    off = check and {
        "off": 100 * check["difference"],
        "off_std": 100 * check["difference_std"],
        "against": ", ".join(check["against"]),
    }
    return {
        **one,
        **(off or {}),
        "used": "yes" if one.get("used", True) else "no",
        "sides": ", ".join(f"{side:.5g}" for side in one.get("side_lengths") or ()),
        "remarks": "; ".join(map(str, one.get("flags") or ())),
    }


def _target(report: dict) -> dict:
    length = unit_name(report.get("unit", "m"))
    other, margin = report.get("runner_up"), report.get("margin")
    place = f"x {{base[0]:.2f}}, y {{base[1]:.2f}} {length}"
    facts = {
        "Chosen by": "crop.target_xy" if report.get("source") == "config" else "its wood",
        "Runner-up": tell(place, other) if other else "none",
        "Lead over it": f"{100 * margin:.0f} % of the score" if other and margin else "",
    }
    candidates = [
        {
            **one,
            "mark": "target" if one.get("is_target") else "",
            "off": tell("{distance:,.2f}", one) or "–",
        }
        for one in report.get("candidates") or ()
    ]
    columns = {
        "": "{mark}",
        "foot": place,
        "wood [voxels]": "{mass:,}",
        f"height [{length}]": "{height:,.2f}",
        f"off the middle [{length}]": "{off}",
        "score": "{score:,.2f}",
        "crop.target_xy": "{crop_target_xy[0]:g}, {crop_target_xy[1]:g}",
    }
    n = len(candidates)
    caption = f"{n} candidate(s): wood near what the cameras look at, times its height"
    return section("Target", {}, facts, [table(caption, columns, candidates, is_open=n > 1)])


def _contracted(data: dict, width_px: int) -> dict:
    facts = {"Method": "{method}", "Contracted points": f"{len(data['contracted']):,}"}
    figure = draw.contraction_figure(
        data["segmented"], data["contracted"], data["skeleton"], width_px
    )
    figures = [(figure, "Contracted points over the wood.")]
    return section("Contraction", data["contract_report"] or {}, facts, figures=figures)


def photo_section(data: dict) -> dict | None:
    """What the photos say of the skeleton; None without photos."""
    check = data["photo_check"]
    if not check:
        return None
    length = unit_name(check["unit"])
    facts = {
        "Precision by the photos": "{photo_precision:,.3f}",
        "Recall by the photos": "{photo_recall:,.3f}",
        "Skeleton that has sky behind it in the photos": "{judged_length:.2f} of {length:.2f} {m}",
        "Skeleton that is likely not there": "{refuted_length:.2f} of {length:.2f} {m}",
        "Thin wood that the skeleton lacks": "{missing_length:.2f} {m}",
        "of this not in the cloud either": "{missing_from_cloud_length:.2f} {m}",
        "Likely missing where no sky is behind": "{unseen_length:.2f} {m}",
        "Dropped, for it is likely not there": "{before[dropped_length]:.2f} {m}",
        "Precision by the photos before": "{before[photo_precision]:,.3f}",
    }
    again = {
        "azimuth [°]": "{azimuth_deg}",
        f"from the stem [{length}]": "{distance:.1f}",
        f"height [{length}]": "{height:.1f}",
        f"look at x, y, z [{length}]": "{at[0]:.2f}, {at[1]:.2f}, {at[2]:.2f}",
        f"would tell [{length}]": "{unsure_length:.2f}",
    }
    caption = "Photograph here again: what is unsure would stand before the sky"
    tables = [table(caption, again, check["photograph_again"], is_open=True)]
    for caption, key in (("By order", "by_order"), ("By radius, mm", "by_radius_mm")):
        columns = {"": "{name}"}
        columns |= {
            f"{what} [{length}]": f"{{{what}:.2f}}" for what in ("length", "judged", "refuted")
        }
        parts = [{"name": name, **each} for name, each in check[key].items()]
        tables.append(table(caption, columns, parts))
    columns = {f"z [{length}]": "{from:.2f} to {to:.2f}", f"length [{length}]": "{length:.2f}"}
    tables.append(table("Missing wood by height", columns, check["missing_by_height"][::-1]))
    columns = {"photo": "{name}", "clear sky says [log]": "{word_of_clear_sky:.1f}"}
    # Those that know less than a third of what half of them do, those that know least first
    words = [photo["word_of_clear_sky"] for photo in check["photos"]]
    limit = float(np.median(words)) / 3 if words else 0.0
    silent = [photo for photo in check["photos"] if photo["word_of_clear_sky"] > limit]
    silent.sort(key=lambda photo: (photo["word_of_clear_sky"], photo["name"]), reverse=True)
    caption = "Photos whose word counts little: off, blurred, or their mask is wrong"
    tables.append(table(caption, columns, silent))
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
    return section("What the photos say", {**check, "m": length}, facts, tables, pictures)
