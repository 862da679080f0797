"""Quality warnings of a tree's traits: "name: sentence", in a fixed order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cherrypicker.traits.foot import Foot
from cherrypicker.traits.missing_top import MissingTop
from cherrypicker.traits.support import Support
from cherrypicker.traits.trunk import TrunkDiameter
from cherrypicker.units import unit_name

# From where on a user should look. Guesses but for the share of missed wood: with it the faulty
# tree of docs/traits.md is told and six sound ones are not
_LOW_ARC_DEG = 240.0
_LOW_CONFIDENCE = 0.6
_ROUGH = 0.12  # share of the radius that the points scatter
_HIDDEN_FOOT_M = 0.1
_FEW_PHOTOS = 0.9  # share that is registered
_MISSED_SHARE, _MISSED_LENGTH_M = 0.01, 0.15
_LOOSE_SCALE = 0.01
_PHOTOS_AGREE = 0.95  # shares below are told; guess
_PLAUSIBLE_HEIGHT_M = (0.15, 25.0)  # of a fruit tree


def quality_flags(
    trunk: TrunkDiameter,
    wanted_height: float,
    missing: list[float],
    foot: Foot,
    support: Support,
    crown_width: float,
    confidence: float | None,
    unit: str,
) -> list[str]:
    """Warnings that follow from the measurement itself.

    Parameters
    ----------
    wanted_height : float
        Height at which the diameter was asked for.
    missing : list of float
        Further heights that the trunk reaches but where no diameter could be measured.
    confidence : float or None
        Median confidence of the wood labels.
    unit : str
        ``m`` or ``arbitrary``.
    """
    length = unit_name(unit)
    flags = []
    if trunk.source == "skeleton":
        flags.append(
            "trunk_not_measured: no circle fits the stem points, the trunk diameter is the "
            "skeleton's and has no uncertainty"
        )
    elif trunk.arc_deg < _LOW_ARC_DEG:
        flags.append(
            f"arc_coverage_low: points cover {trunk.arc_deg:.0f} of 360 degrees of the trunk at "
            f"height {trunk.height:.2f} {length}"
        )
    if trunk.source == "points" and trunk.residual > _ROUGH * trunk.diameter / 2:
        flags.append(
            f"trunk_rough: points scatter by {trunk.residual:.4f} {length} around the trunk's "
            f"surface, {200 * trunk.residual / trunk.diameter:.0f} % of its radius"
        )
    if abs(trunk.height - wanted_height) > 1e-6:
        flags.append(
            f"trunk_height_moved: the trunk diameter was taken at height {trunk.height:.2f} "
            f"{length}, not {wanted_height:.2f}"
        )
    if missing:
        heights = ", ".join(f"{height:.2f}" for height in missing)
        flags.append(f"no_diameter: the trunk has no measurable diameter at {heights} {length}")
    flags += _shape_flags(foot, support, crown_width, confidence, length)
    return flags


def _shape_flags(
    foot: Foot, support: Support, crown_width: float, confidence: float | None, length: str
) -> list[str]:
    flags = []
    if foot.source == "wood":
        flags.append("no_ground: no ground below the stem, its foot is its lowest points")
    elif foot.source == "root":
        flags.append("foot_unseen: neither ground nor stem around the skeleton's root, its foot")
    elif foot.gap > _HIDDEN_FOOT_M:
        flags.append(
            f"foot_hidden: the lowest stem points lie {foot.gap:.2f} {length} over the ground, "
            "nothing of the stem was found below them"
        )
    if len(support.gaps):
        flags.append(
            f"gaps_bridged: the skeleton bridges {len(support.gaps)} gap(s) without points, the "
            f"longest {np.max(support.gaps):.2f} {length}"
        )
    if support.n_stray:
        flags.append(
            f"stray_pieces: {support.n_stray} piece(s) of skeleton, {support.stray_length:.2f} "
            f"{length} in all, are shorter than the gaps that they hang on and do not count for "
            "height and crown"
        )
    if support.missed_share > _MISSED_SHARE or support.missed_length > _MISSED_LENGTH_M:
        flags.append(
            f"wood_left_out: {100 * support.missed_share:.1f} % of the wood points lie far from "
            f"the skeleton, the largest piece is {support.missed_length:.2f} {length} long; "
            "height, crown and lengths may be too small"
        )
    if crown_width == 0:
        flags.append("no_crown: nothing leaves the stem, crown width and volume are 0")
    if confidence is not None and confidence < _LOW_CONFIDENCE:
        flags.append(f"labels_uncertain: the median confidence of the wood is {confidence:.2f}")
    return flags


def scan_flags(
    unit: str,
    *,
    height: float | None = None,
    scale: dict | None = None,
    sparse: dict | None = None,
    target: dict | None = None,
    edits: dict | None = None,
    photo_check: dict | None = None,
    edges: Sequence = (),
    missing_top: MissingTop | None = None,
) -> list[str]:
    """Warnings that earlier stages left in their reports, and an odd size of the whole.

    Parameters
    ----------
    unit : str
        ``m`` or ``arbitrary``.
    height : float, optional
        Of the tree, in that unit.
    scale, sparse, target, edits, photo_check : dict, optional
        As of :func:`cherrypicker.traits.measure.measure_traits`.
    edges : sequence of FrameEdge
        Sides of the tree beyond which few photos look.
    missing_top : MissingTop, optional
        How much taller the photos show the tree than its cloud is.
    """
    flags = []
    if unit != "m":
        flags.append("unscaled: the scan has no scale, all lengths are in arbitrary units")
    elif height is not None and not _PLAUSIBLE_HEIGHT_M[0] <= height <= _PLAUSIBLE_HEIGHT_M[1]:
        flags.append(
            f"odd_height: a tree {height:.3g} m tall is odd; check scale, marker_sides_m or "
            "cloud_unit in trees.tsv"
        )
    if scale and scale.get("scale") and scale.get("scale_std"):
        share = scale["scale_std"] / scale["scale"]
        if share > _LOOSE_SCALE:
            flags.append(f"scale_uncertain: the scale's standard error is {100 * share:.1f} %")
    if scale and scale.get("doubts"):
        flags.append(f"scale_doubtful: {'; '.join(scale['doubts'])}")
    if sparse:
        n_photos, n_registered = sparse.get("n_photos"), sparse.get("n_registered")
        if n_photos and n_registered is not None and n_registered < _FEW_PHOTOS * n_photos:
            lost = sparse.get("n_left_out", 0)
            flags.append(
                f"few_photos: {n_registered} of {n_photos} photos are used"
                + (f", {lost} were left out for their cameras' errors" if lost else "")
            )
        n_doubtful = sum(bool(facts.get("doubt")) for facts in sparse.get("photos", {}).values())
        unsure = sparse.get("camera_error_px")
        if n_doubtful and unsure:
            flags.append(
                f"cameras_uncertain: {n_doubtful} of {n_registered} used photos are doubtful, "
                f"{unsure['worst']} is known within {unsure['max']:.1f} px at the tree, the median "
                f"within {unsure['median']:.1f} px; photos should overlap more"
            )
    flags += _edge_flags(edges, unit_name(unit))
    if missing_top is not None:
        flags.append(
            f"top_not_in_cloud: {missing_top.n_photos} photos show wood up to "
            f"{missing_top.height:.2f} {unit_name(unit)} over the foot, the cloud ends at "
            f"{missing_top.found:.2f}; height, crown and lengths are too small, look at "
            "mvs.max_image_size_px and the depth maps"
        )
    flags += _photo_flags(photo_check or {}, unit_name(unit))
    flags += _target_flags(target or {}, unit_name(unit))
    if edits and edits["lost"]:
        flags.append(
            f"edits_lost: {len(edits['lost'])} of {edits['n_edits']} hand corrections no longer "
            f"find their place ({'; '.join(edits['lost'])})"
        )
    return flags


def _photo_flags(check: dict, length: str) -> list:
    """What the photos refute of the skeleton, and what they show that it lacks."""
    flags = []
    longest = {
        name: max((piece["length"] for piece in check.get(f"{name}_pieces", ())), default=0.0)
        for name in ("refuted", "missing")
    }
    precision, recall = check.get("photo_precision"), check.get("photo_recall")
    before = check.get("before") or {"dropped_length": 0.0, "length": 1.0, "dropped_pieces": ()}
    dropped = max((piece["length"] for piece in before["dropped_pieces"]), default=0.0)
    if _is_doubtful(1.0 - before["dropped_length"] / before["length"], dropped):
        flags.append(
            f"dropped_by_photos: {before['dropped_length']:.2f} of {before['length']:.2f} {length} "
            f"of skeleton are more likely not there by all photos together and were dropped, the "
            f"longest piece {dropped:.2f} {length}"
        )
    if _is_doubtful(precision, longest["refuted"]):
        flags.append(
            f"not_in_photos: of {check['length']:.2f} {length} of skeleton "
            f"{check['refuted_length']:.2f} are likely not there by the photos, the longest piece "
            f"{longest['refuted']:.2f} {length}"
        )
    if _is_doubtful(recall, longest["missing"]):
        flags.append(
            f"wood_missing: the photos show {check['missing_length']:.2f} {length} of thin wood "
            f"that the skeleton lacks, the longest piece {longest['missing']:.2f} {length}, and "
            f"about {check['unseen_length']:.2f} more may be missing where they have no sky behind "
            "the tree; height, crown and lengths may be too small"
        )
    return flags


def _is_doubtful(share: float | None, longest: float) -> bool:
    return share is not None and (share < _PHOTOS_AGREE or longest > _MISSED_LENGTH_M)


def _target_flags(target: dict, length: str) -> list:
    """What ``target.json`` doubts, and which other trees it saw."""
    flags = list(target.get("warnings") or [])
    others = target.get("other_stems_xy") or []
    if others:
        flags.append(
            f"second_tree: {len(others)} other tree(s) stand beside the target; "
            "crop.target_xy chooses between them"
        )
    loose = target.get("loose") or []
    spans = [np.linalg.norm(np.subtract(piece["high"], piece["low"])) for piece in loose]
    if sum(spans) > _MISSED_LENGTH_M:
        flags.append(
            f"wood_loose: {len(loose)} piece(s) of wood near the tree hang on nothing and are not "
            f"in the skeleton, {sum(spans):.2f} {length} in all, the largest {max(spans):.2f} "
            f"{length} long and {loose[int(np.argmax(spans))]['gap']:.2f} off; height, crown and "
            "lengths may be too small"
        )
    return flags


def _edge_flags(edges: Sequence, length: str) -> list[str]:
    """One warning for a top that the photos may cut off, one for all such sides of the crown."""
    top = [edge for edge in edges if edge.azimuth_deg is None]
    sides = [edge for edge in edges if edge.azimuth_deg is not None]
    flags = [
        f"top_outside_photos: {edge.n_photos} photos frame what is {edge.beyond:.2f} {length} "
        f"above the highest wood, {edge.n_usual} the tree; height may be too small, photograph "
        "the tree from farther away"
        for edge in top
    ]
    if sides:
        azimuths = ", ".join(f"{edge.azimuth_deg:.0f}" for edge in sides)
        least = min(sides, key=lambda edge: edge.n_photos)
        flags.append(
            f"side_outside_photos: towards azimuth {azimuths} degrees as few as {least.n_photos} "
            f"photos frame what is {least.beyond:.2f} {length} beyond the outermost wood, "
            f"{least.n_usual} the tree; the crown's width may be too small"
        )
    return flags
