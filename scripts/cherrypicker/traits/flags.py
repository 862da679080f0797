"""Quality warnings of a tree's traits: a row each says when, in which words, and what helps.

Nothing heavy is imported: pages ask here for advice.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

from cherrypicker.traits.reports import Reports
from cherrypicker.units import unit_name

# A larger share is told: with 1 % of the points the faulty tree of docs/traits.md is told and six
# sound ones are not; twice the lack by the photos and half of it tell the same of six scans
_MISSED_PERCENT, _PHOTOS_AGREE = 1.0, 0.95
_LONG_M = 0.15  # a piece of wood longer than this is told (guess)


@dataclass(frozen=True)
class Flag:
    """A quality warning, told as "name: sentence"."""

    name: str
    when: Callable[[Any], Any]  # of the facts that `quality_flags` gathers
    sentence: str  # which tells these facts, a format of ``f``
    advice: str
    least: tuple[str, ...] = ()  # traits of which more is there than was found


def _is_doubtful(share: float | None, longest: float) -> bool:
    return share is not None and (share < _PHOTOS_AGREE or longest > _LONG_M)


_SUMS = ("total_length_m", "n_shoots", "n_tips", "wood_volume_m3")
_HEIGHT = ("height_m", "crown_volume_m3", *_SUMS)
_STEM = ("crown_base_height_m", "height_m", "total_length_m", "wood_volume_m3")
_ROWS = (
    Flag(
        "unscaled",
        lambda f: f.unit != "m",
        "the scan has no scale, all lengths are in arbitrary units",
        "Put a marker beside the tree and name it in marker_sides_m, or give a scale.",
    ),
    Flag(
        "odd_height",  # for a fruit tree (guess)
        lambda f: f.unit == "m" and not 0.15 <= f.height.value <= 25.0,
        "a tree {f.height.value:.3g} m tall is odd; check scale, marker_sides_m or cloud_unit in "
        "trees.tsv",
        "Check scale, marker_sides_m or cloud_unit in trees.tsv.",
    ),
    Flag(
        "scale_uncertain",
        lambda f: f.scale_error > 1.0,  # guess
        "the scale's standard error is {f.scale_error:.1f} %",
        "Photograph the markers from nearer and from more sides, or use larger ones.",
    ),
    Flag(
        "scale_doubtful",
        lambda f: f.doubts,
        "{f.doubts}",
        "Compare the known lengths below: measure again the one that is named, and look for it in "
        "the photos.",
    ),
    Flag(
        "few_photos",
        lambda f: (
            f.n_used is not None and f.n_used < 0.9 * (f.sparse.get("n_photos") or 0)
        ),  # guess
        "{f.n_used} of {f.sparse[n_photos]} photos are used{f.left_out}",
        "See below which photos failed and why. Take more, with more overlap.",
    ),
    Flag(
        "cameras_uncertain",
        lambda f: f.n_doubtful and f.camera_error,
        "{f.n_doubtful} of {f.n_used} used photos are doubtful, {f.camera_error[worst]} "
        "is known within {f.camera_error[max]:.1f} px at the tree, the median within "
        "{f.camera_error[median]:.1f} px; photos should overlap more",
        "Take the photos closer together, so that each part stands in more.",
    ),
    Flag(
        "top_outside_photos",
        lambda f: f.top,
        "{f.top.n_photos} photos frame what is {f.top.beyond:.2f} {f.m} above the highest wood, "
        "{f.top.n_usual} the tree; height may be too small, photograph the tree from farther away",
        "Photograph the tree from farther away, with its top in the picture.",
        _HEIGHT,
    ),
    Flag(
        "side_outside_photos",
        lambda f: f.side,
        "towards azimuth {f.azimuths} degrees as few as {f.side.n_photos} photos frame what is "
        "{f.side.beyond:.2f} {f.m} beyond the outermost wood, {f.side.n_usual} the tree; the "
        "crown's width may be too small",
        "Photograph the tree from farther away, with that side in the picture.",
        ("crown_width_m", "crown_volume_m3", *_SUMS),
    ),
    Flag(
        "top_not_in_cloud",
        lambda f: f.missing_top,
        "{f.missing_top.n_photos} photos show wood up to {f.missing_top.height:.2f} {f.m} over the "
        "foot, the cloud ends at {f.missing_top.found:.2f}; height, crown and lengths are too "
        "small, look at mvs.max_image_size_px and the depth maps",
        "Raise mvs.max_image_size_px, and look at the depth maps below.",
        _HEIGHT,
    ),
    Flag(
        "dropped_by_photos",
        lambda f: _is_doubtful(
            1.0 - f.before["dropped_length"] / f.before["length"], f.longest["dropped"]
        ),
        "{f.before[dropped_length]:.2f} of {f.before[length]:.2f} {f.m} of skeleton are more "
        "likely not there by all photos together and were dropped, the longest piece "
        "{f.longest[dropped]:.2f} {f.m}",
        "Look at the worst photo below: what is purple was dropped. Nothing is to do if it is no "
        "wood.",
    ),
    Flag(
        "not_in_photos",
        lambda f: _is_doubtful(f.photo_check.get("photo_precision"), f.longest["refuted"]),
        "of {f.photo_check[length]:.2f} {f.m} of skeleton {f.photo_check[refuted_length]:.2f} are "
        "likely not there by the photos, the longest piece {f.longest[refuted]:.2f} {f.m}",
        "Look at the worst photo below, and delete in the view what is red there.",
    ),
    Flag(
        "wood_missing",
        lambda f: _is_doubtful(f.photo_check.get("photo_recall"), f.longest["missing"]),
        "the photos show {f.photo_check[missing_length]:.2f} {f.m} of thin wood that the skeleton "
        "lacks, the longest piece {f.longest[missing]:.2f} {f.m}, and about "
        "{f.photo_check[unseen_length]:.2f} more may be missing where they have no sky behind the "
        "tree; height, crown and lengths may be too small",
        "Look at the worst photo below: what is orange lacks. Photograph again where the table "
        "below says, or raise mvs.max_image_size_px.",
        _SUMS,
    ),
    Flag(
        "target_close",
        lambda f: f.warnings.get("target_close"),
        "{f.warnings[target_close]}",
        "Look whether the right tree was taken; else set crop.target_xy to the other.",
    ),
    Flag(
        "target_far",
        lambda f: f.warnings.get("target_far"),
        "{f.warnings[target_far]}",
        "Correct crop.target_xy: the places of the candidates stand below.",
    ),
    Flag(
        "second_tree",
        lambda f: f.n_others,
        "{f.n_others} other tree(s) stand beside the target; crop.target_xy chooses between them",
        "Look whether the right tree was taken; else set crop.target_xy.",
    ),
    Flag(
        "wood_loose",
        lambda f: f.loose_length > _LONG_M,
        "{f.n_loose} piece(s) of wood near the tree hang on nothing and are not in the skeleton, "
        "{f.loose_length:.2f} {f.m} in all, the largest {f.longest_loose[0]:.2f} {f.m} long and "
        "{f.longest_loose[1][gap]:.2f} off; height, crown and lengths may be too small",
        "In the view, look for wood beside the skeleton. Is it the tree's? Then raise "
        "contract.gap_m over its distance, or photograph what lies between from nearer.",
        _SUMS,
    ),
    Flag(
        "edits_lost",
        lambda f: f.lost,
        "{f.n_lost} of {f.edits[n_edits]} hand corrections no longer find their place ({f.lost})",
        "Look whether these corrections are still needed. If so, make them again in the view; take "
        "the lost ones out of the file.",
    ),
    Flag(
        "trunk_not_measured",
        lambda f: f.trunk.source == "skeleton",
        "no circle fits the stem points, the trunk diameter is the skeleton's and has no "
        "uncertainty",
        "Look at the trunk sections below. Photograph the stem from all sides, or set "
        "traits.trunk_height_m where it is seen whole.",
    ),
    Flag(
        "arc_coverage_low",
        lambda f: f.trunk.source == "points" and f.trunk.arc_deg < 240.0,  # guess
        "points cover {f.trunk.arc_deg:.0f} of 360 degrees of the trunk at height "
        "{f.trunk.height:.2f} {f.m}",
        "Photograph the stem from the sides that lack, or set traits.trunk_height_m where it is "
        "seen whole.",
    ),
    Flag(
        "trunk_rough",
        lambda f: f.rough > 12.0,  # guess
        "points scatter by {f.trunk.residual:.4f} {f.m} around the trunk's surface, "
        "{f.rough:.0f} % of its radius",
        "Look at the trunk sections: a fork, a burr or a tie there? Set traits.trunk_height_m "
        "above or below it.",
    ),
    Flag(
        "trunk_height_moved",
        lambda f: abs(f.trunk.height - f.options.trunk_height_m) > 1e-6,
        "the trunk diameter was taken at height {f.trunk.height:.2f} {f.m}, not "
        "{f.options.trunk_height_m:.2f}",
        "Set traits.trunk_height_m to a height that the trunk reaches.",
    ),
    Flag(
        "no_diameter",
        lambda f: f.unmeasured,
        "the trunk has no measurable diameter at {f.heights} {f.m}",
        "Take these heights out of traits.trunk_heights_m, or photograph the stem there.",
    ),
    Flag(
        "no_ground",
        lambda f: f.foot.source == "wood",
        "no ground below the stem, its foot is its lowest points",
        "Photograph the ground around the stem. Until then all heights lack what is below the "
        "lowest point.",
        _STEM,
    ),
    Flag(
        "foot_unseen",
        lambda f: f.foot.source == "root",
        "neither ground nor stem around the skeleton's root, its foot",
        "Photograph the foot of the stem. Look whether the skeleton's root is the tree's.",
        _STEM,
    ),
    Flag(
        "foot_hidden",
        lambda f: f.foot.gap > 0.1,  # guess
        "the lowest stem points lie {f.foot.gap:.2f} {f.m} over the ground, nothing of the stem "
        "was found below them",
        "Clear the grass from the foot and photograph it, or trust heights less.",
    ),
    Flag(
        "gaps_bridged",
        lambda f: len(f.support.gaps),
        "the skeleton bridges {f.support.gaps.size} gap(s) without points, the longest "
        "{f.longest_gap:.2f} {f.m}",
        "Sort the branches by their flags and look at those with a gap. Cut what is not one "
        "branch; photograph that side from nearer.",
    ),
    Flag(
        "stray_pieces",
        lambda f: f.support.n_stray,
        "{f.support.n_stray} piece(s) of skeleton, {f.support.stray_length:.2f} {f.m} in all, are "
        "shorter than the gaps that they hang on and do not count for height and crown",
        "In the view, connect the pieces that are the tree's and delete the others.",
    ),
    Flag(
        "wood_left_out",
        lambda f: f.missed > _MISSED_PERCENT or f.support.missed_length > _LONG_M,
        "{f.missed:.1f} % of the wood points lie far from the skeleton, the largest piece "
        "is {f.support.missed_length:.2f} {f.m} long; height, crown and lengths may be too small",
        "In the view, look for wood without a line. Is it the tree's? Then photograph it from "
        "nearer. Is it not? Then crop closer.",
        _SUMS,
    ),
    Flag(
        "no_crown",
        lambda f: f.crown_width.value == 0,
        "nothing leaves the stem, crown width and volume are 0",
        "Is this the tree? Set crop.target_xy to its place, or look at the classes.",
    ),
    Flag(
        "labels_uncertain",
        lambda f: f.confidence is not None and f.confidence < 0.6,  # guess
        "the median confidence of the wood is {f.confidence:.2f}",
        "Colour the points by confidence in the view, and correct by editing what follows from a "
        "wrong class.",
    ),
)
#: Name to warning, in the order in which they are told.
FLAGS = {flag.name: flag for flag in _ROWS}


def quality_flags(reports: Reports, tree: Any) -> list[str]:
    """The warnings of a `cherrypicker.traits.measure.ScannedTree`, "name: sentence" each."""
    facts = SimpleNamespace(**vars(reports) | vars(tree))
    check, target, lost = reports.photo_check, reports.target, reports.edits.get("lost", ())
    before = check.get("before") or {"dropped_length": 0.0, "length": 1.0}
    longest = {
        name: max((piece["length"] for piece in told.get(f"{name}_pieces", ())), default=0.0)
        for name, told in (("dropped", before), ("refuted", check), ("missing", check))
    }
    loose = [(math.dist(one["low"], one["high"]), one) for one in target.get("loose") or ()]
    sides = [edge for edge in facts.edges if edge.azimuth_deg is not None]
    n_left_out = reports.sparse.get("n_left_out")
    photos = reports.sparse.get("photos", {}).values()
    vars(facts).update(
        m=unit_name(facts.unit),
        rough=200 * facts.trunk.residual / facts.trunk.diameter,
        heights=", ".join(f"{height:.2f}" for height in facts.unmeasured),
        longest_gap=max(facts.support.gaps, default=0.0),
        missed=100 * facts.support.missed_share,
        top=next((edge for edge in facts.edges if edge.azimuth_deg is None), None),
        side=min(sides, key=lambda edge: edge.n_photos, default=None),
        azimuths=", ".join(f"{edge.azimuth_deg:.0f}" for edge in sides),
        scale_error=100 * reports.scale_error,
        doubts="; ".join(reports.scale.get("doubts") or ()),
        n_used=reports.sparse.get("n_registered"),
        left_out=f", {n_left_out} were left out for their cameras' errors" if n_left_out else "",
        n_doubtful=sum(bool(photo.get("doubt")) for photo in photos),
        camera_error=reports.sparse.get("camera_error_px"),
        before=before,
        longest=longest,
        warnings=dict(warning.split(": ", 1) for warning in target.get("warnings") or ()),
        n_others=len(target.get("other_stems_xy") or ()),
        n_loose=len(loose),
        loose_length=sum(length for length, _ in loose),
        longest_loose=max(loose, key=lambda one: one[0], default=None),
        n_lost=len(lost),
        lost="; ".join(lost),
    )
    told = (flag for flag in _ROWS if flag.when(facts))
    return [f"{flag.name}: {flag.sentence.format(f=facts)}" for flag in told]


def at_least(flags: Sequence[str], outgrown: Sequence[str] = ()) -> list[str]:
    """Names of the traits whose value is the least that it can be, by the tree's flags.

    `outgrown` are those that wood which is known to be missing makes larger than their error
    allows.
    """
    known = [FLAGS[name] for flag in flags if (name := flag.partition(":")[0]) in FLAGS]
    return sorted({name for flag in known for name in flag.least}.union(outgrown))


def advice_for(warning: str) -> str:
    """What to do about a warning "name: sentence", or about one without a name."""
    flag = FLAGS.get(warning.partition(":")[0])
    return flag.advice if flag else "Look at the stage that says so, below."
