"""All traits of one tree, with uncertainties and quality warnings."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cherrypicker.classes import wood_mask
from cherrypicker.errors import StageError
from cherrypicker.files import rounded
from cherrypicker.pointcloud import PointCloud
from cherrypicker.skeleton import axes
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.skeleton.topology import Topology
from cherrypicker.traits.beyond import growth_by, missing_wood
from cherrypicker.traits.branches import branch_rows, totals_by_order
from cherrypicker.traits.crown import alpha_volume, crown_of, hull_of, measure_crown, projected_area
from cherrypicker.traits.crown_forms import (
    cone_volume,
    contour_volume,
    ellipsoid_volume,
    tree_row_volume,
)
from cherrypicker.traits.flags import at_least, quality_flags
from cherrypicker.traits.foot import find_foot
from cherrypicker.traits.frame_edges import frame_edges
from cherrypicker.traits.intervals import CI90, Terms, interval, spread, typical_scatter
from cherrypicker.traits.limb_sections import measure_limbs
from cherrypicker.traits.limb_table import by_diameter, limb_rows, ratio_terms, squares_terms
from cherrypicker.traits.missing_top import find_missing_top
from cherrypicker.traits.reports import Reports
from cherrypicker.traits.scaffold import Limb, StemSurface, clear_stem, crown_start, find_limbs
from cherrypicker.traits.shoot_ends import find_shoot_ends
from cherrypicker.traits.support import find_support, quick_tree, support_reach
from cherrypicker.traits.table import TRAITS
from cherrypicker.traits.trunk import Stem, TrunkDiameter, measure_near, stem_of

logger = logging.getLogger(__name__)

_MIN_WOOD_POINTS = 10  # fewer are noise (guess)
_ALPHA_SHARE = 0.15  # of the crown's width: hollows wider than this are outside (guess)
_ALPHA_CELLS = 5.0  # cells of the thinned points across such a hollow
_END_M = 0.02  # so far below its end a trunk is no longer measured (guess)
_FEWEST_SAMPLES = 20  # that a spread is told from
_CM2 = 1e4  # of a square metre
_OVER_GRAFT_M = 0.30  # where the stem is measured for the limb-to-trunk ratio (Schupp 2017)
_LIMB_DRAWS = 25  # limbs have a stream of draws of their own


@dataclass(frozen=True)
class TraitOptions:
    """How traits are measured; the fields are the config keys of ``traits``."""

    trunk_height_m: float = 0.30
    trunk_heights_m: tuple[float, ...] = (0.5, 1.0, 1.3)
    slab_half_height_m: float = 0.10
    min_points: int = 60
    min_arc_deg: float = 120.0
    max_gap_m: float = 0.10
    min_limb_m: float = 0.10
    limb_classes_m: tuple[float, ...] = (0.01, 0.02, 0.03, 0.05)
    graft_height_m: float | None = None
    row_distance_m: float | None = None
    n_bootstrap: int = 200


def measure_traits(
    skeleton: Skeleton,
    cloud: PointCloud,
    topology: Topology | None = None,
    reports: Reports | None = None,
    *,
    options: TraitOptions | None = None,
    seed: int = 0,
) -> tuple[dict, dict[str, list[dict]]]:
    """Measure a tree's traits on its skeleton and its original points.

    Parameters
    ----------
    cloud : PointCloud
        The segmented cloud, z up, in the skeleton's frame and unit, with a ``label`` field.
    topology : Topology, optional
        Counts junctions and tips; the skeleton's own without it.
    reports : Reports, optional
        What earlier stages say of the scan; its scale's standard error enters every uncertainty.

    Returns
    -------
    traits : dict
        Content of ``traits.json``.
    tables : dict of str to list of dict
        ``branches`` and ``limbs``: the rows of ``branches.csv`` and ``limbs.csv``.

    Raises
    ------
    StageError
        If the skeleton has no edge or the cloud no wood.
    """
    settings, reports = options or TraitOptions(), reports or Reports()
    photo_check = reports.photo_check
    is_wood = _checked_wood(skeleton, cloud)
    wood = cloud.points[is_wood]
    rng = np.random.default_rng(seed)
    axis_list = axes(skeleton)
    foot = find_foot(skeleton, cloud.points, cloud["label"])
    tree = quick_tree(wood)
    reach = support_reach(tree)
    support = find_support(
        skeleton,
        tree,
        reach,
        max_gap=settings.max_gap_m,
    )
    if not support.point.any():
        raise StageError("no wood point lies near the skeleton", key="graph")
    logger.info(
        "foot at z = %.3f (%s); %s of %s wood points near the skeleton (%.1f %%)",
        foot.point[2],
        foot.source,
        f"{support.point.sum():,}",
        f"{len(wood):,}",
        100 * support.point.mean(),
    )

    fit: dict[str, Any] = {
        "half_height": settings.slab_half_height_m,
        "min_points": settings.min_points,
        "min_arc_deg": settings.min_arc_deg,
        "rng": rng,
    }
    stem = stem_of(skeleton, axis_list[0].nodes, foot)
    trunk = measure_near(stem, wood, settings.trunk_height_m, **fit)
    heights = sorted(settings.trunk_heights_m)
    further = {height: _measured(stem, wood, height, fit) for height in heights}
    tree_points = wood[support.point]
    surface = StemSurface(skeleton, axis_list)
    limbs = find_limbs(skeleton, axis_list, surface, least=settings.min_limb_m, kept=support.node)
    clear = clear_stem(skeleton, axis_list, limbs, surface)
    draws = np.random.default_rng([seed, _LIMB_DRAWS])
    limbs = measure_limbs(skeleton, axis_list, limbs, surface, tree, draws)
    below = trunk
    if settings.graft_height_m is not None:
        below = measure_near(stem, wood, settings.graft_height_m + _OVER_GRAFT_M, **fit)
    crown_points = wood[crown_of(skeleton, clear, wood, support)]
    hull = hull_of(crown_points) if len(crown_points) else None
    crown, samples = measure_crown(
        tree_points,
        hull,
        find_shoot_ends(skeleton, support.node, tree, reach),
        typical_scatter(skeleton) or 0.0,
        reach,
        in_crown=~clear,
        n_samples=settings.n_bootstrap,
        rng=rng,
    )
    scale_error = reports.scale_error if cloud.unit == "m" else 0.0
    rows = branch_rows(
        skeleton, axis_list, foot.point[2], scale_error=scale_error, photo_check=photo_check
    )
    confidence = float(np.median(cloud["confidence"][is_wood])) if "confidence" in cloud else None

    top = None
    if reports.photos is not None:
        top = find_missing_top(reports.photos, tree_points, foot.point)
    missing = missing_wood(support.missed_boxes, reports.target, photo_check, top, foot.point)

    traits: dict[str, Any] = {"unit": cloud.unit}
    grown = growth_by(missing, crown, hull)
    off = samples - [crown.top, crown.width, crown.volume]
    over_foot: Terms = {"fit": foot.error, "top_error": reach}
    hull_terms = {"hull_error": reach * (0.0 if hull is None else hull.areas.sum())}
    _add(traits, "height_m", crown.top - foot.point[2], over_foot, scale_error, off[:, 0], grown[0])
    _add(traits, "trunk_diameter_m", trunk.diameter, trunk.terms, scale_error)
    width_terms = {"width_error": reach}
    _add(traits, "crown_width_m", crown.width, width_terms, scale_error, off[:, 1], grown[1])
    _add(traits, "crown_volume_m3", crown.volume, hull_terms, scale_error, off[:, 2], grown[2])
    traits["trunk_height_m"] = rounded(trunk.height)
    traits |= _section_area(traits)
    traits["crown_projected_area_m2"] = rounded(
        projected_area(crown_points if hull is None else hull.points)
    )
    base = skeleton.points[max(crown_start(axis_list, limbs, surface), 0)]
    traits |= _crown_forms(traits, crown_points, base, foot.point[2], settings.row_distance_m)
    alpha = _ALPHA_SHARE * max(crown.width, 1e-9)
    traits["crown_alpha_m"] = rounded(alpha)
    traits["crown_alpha_volume_m3"] = rounded(
        alpha_volume(crown_points, alpha, alpha / _ALPHA_CELLS)
    )
    _add_limbs(traits, limbs, below, scale_error)
    traits["n_limbs_by_diameter"] = by_diameter(limbs, settings.limb_classes_m)
    traits |= _counts(skeleton, topology, rows)
    traits |= _shoots(rows)
    traits |= _sections(trunk, further, scale_error)
    traits["foot"] = [rounded(value) for value in foot.point]
    traits["crown_volume_method"] = "convex hull"
    traits["trunk_end_height_m"] = rounded(stem.height[-1])
    traits |= _photo_shares(photo_check)
    unmeasured = [
        h for h, item in further.items() if item is None and h <= stem.height[-1] - _END_M
    ]
    traits["flags"] = quality_flags(
        reports,
        cloud.unit,
        height=traits["height_m"],
        trunk=trunk,
        wanted_height=settings.trunk_height_m,
        unmeasured=unmeasured,
        foot=foot,
        support=support,
        crown_width=crown.width,
        confidence=confidence,
        edges=() if reports.poses is None else frame_edges(reports.poses, tree_points),
        missing_top=top,
    )
    traits["at_least"] = at_least(traits["flags"], traits.get("at_least", ()))
    for flag in traits["flags"]:
        logger.info("flag: %s", flag)
    pruners = limb_rows(
        skeleton, axis_list, limbs, rows, below.diameter, foot.point[2], scale_error=scale_error
    )
    return traits, {"branches": rows, "limbs": pruners}


def _checked_wood(skeleton: Skeleton, cloud: PointCloud) -> np.ndarray:
    """Which points are wood, (n_points,) bool; refuse where there is nothing to measure."""
    if len(skeleton) < 2:
        raise StageError("the skeleton has no edge, there is nothing to measure", key="graph")
    is_wood = wood_mask(cloud["label"])
    n_wood = np.count_nonzero(is_wood)
    if n_wood < _MIN_WOOD_POINTS:
        raise StageError(
            f"{n_wood} points are labelled trunk or branch, {_MIN_WOOD_POINTS} are needed",
            key="segment",
        )
    return is_wood


def _measured(stem: Stem, wood: np.ndarray, height: float, options: dict) -> TrunkDiameter | None:
    """The diameter at a further height; None where the trunk does not reach it or no fit holds."""
    if height > stem.height[-1] - _END_M:
        return None
    found = measure_near(stem, wood, height, max_shift=0.0, **options)
    return found if found.source == "points" else None


def _crown_forms(
    traits: dict, points: np.ndarray, base: np.ndarray, foot_z: float, row_distance: float | None
) -> dict:
    """Where the crown begins, and its volumes by the field's formulas."""
    height, width = traits["height_m"], traits["crown_width_m"]
    depth = max(height - (base[2] - foot_z), 0.0) if len(points) else 0.0
    return {
        "crown_base_height_m": rounded(base[2] - foot_z) if len(points) else None,
        "crown_cone_volume_m3": rounded(cone_volume(width, depth)),
        "crown_ellipsoid_volume_m3": rounded(ellipsoid_volume(width, depth)),
        "crown_contour_volume_m3": rounded(contour_volume(points, base[:2])),
        "tree_row_volume_m3_ha": round(tree_row_volume(height, width, row_distance), 1)
        if row_distance is not None and traits["unit"] == "m"
        else None,
    }


def _add_limbs(traits: dict, limbs: list[Limb], below: TrunkDiameter, scale_error: float) -> None:
    """Enter the limbs' number and area, and what that is to the stem's."""
    squares, terms = sum(limb.diameter**2 for limb in limbs), squares_terms(limbs)
    area, ratio = np.pi / 4 * _CM2, squares / below.diameter**2
    traits["n_limbs"] = len(limbs)
    of_area = {name: area * term for name, term in terms.items()}
    _add(traits, "limb_area_cm2", area * squares, of_area, scale_error)
    of_ratio = ratio_terms(terms, ratio, below.diameter, below.terms)
    _add(traits, "limb_trunk_ratio", ratio, of_ratio, scale_error)
    traits["limb_trunk_height_m"] = rounded(below.height)


def _counts(skeleton: Skeleton, topology: Topology | None, rows: list) -> dict:
    n_children = skeleton.n_children
    totals, length = totals_by_order(rows), float(skeleton.edge_length.sum())
    n_junctions = int((n_children[1:] > 1).sum())
    n_tips = int((n_children == 0).sum())
    return {
        "total_length_m": rounded(length),
        "n_junctions": n_junctions if topology is None else topology.n_junctions,
        "n_tips": n_tips if topology is None else topology.n_tips,
        "branching_index_per_m": rounded((len(rows) - 1) / length),
        "length_by_order_m": {str(k): rounded(v["length"]) for k, v in totals.items()},
        "n_branches_by_order": {str(k): v["n"] for k, v in totals.items()},
        "volume_by_order_m3": {str(k): round(v["volume"], 8) for k, v in totals.items()},
        "mean_diameter_by_order_m": {
            str(k): rounded(v["mean_diameter"]) for k, v in totals.items()
        },
        "wood_volume_m3": round(sum(v["volume"] for v in totals.values()), 8),
    }


def _shoots(rows: list) -> dict:
    """Candidates for last year's shoots: what lies beyond the last lateral of every side axis."""
    lengths = [row["shoot_length_m"] for row in rows if row["order"] > 0]
    spacing = [row["lateral_spacing_m"] for row in rows if row["lateral_spacing_m"]]
    return {
        "n_shoots": len(lengths),
        "mean_shoot_length_m": rounded(np.mean(lengths)) if lengths else 0.0,
        "lateral_spacing_m": rounded(np.median(spacing)) if spacing else None,
    }


def _photo_shares(photo_check: Mapping[str, Any]) -> dict:
    """What the photos say of the skeleton as a whole; nothing without photos."""
    names = ("photo_precision", "photo_recall", "photo_sky_share", "n_photos", "photo_confirmed")
    return {name: photo_check[name] for name in names if name in photo_check}


def _add(
    traits: dict,
    name: str,
    value: float,
    terms: Terms,
    scale_error: float,
    drawn: np.ndarray | None = None,
    missing: float = 0.0,
) -> None:
    """Enter a trait with its standard error and 90 % interval, where they are known.

    Parameters
    ----------
    terms : Terms
        What its error follows, but for the scale's; none for a trait without an error.
    drawn : ndarray of shape (n_samples,), float64, optional
        How far drawn values lie off `value`.
    missing : float, default 0
        How much larger it is with the wood that is known to be missing; where the found wood's
        interval does not reach as far, the value is the least.
    """
    traits[name] = rounded(value)
    if not terms or (drawn is not None and len(drawn) < _FEWEST_SAMPLES):
        return
    terms = {**terms, "scale": (TRAITS[name].power or 0) * scale_error * value}
    arms, sd = (0.0, 0.0), spread(terms)
    if drawn is not None:
        low, high = np.maximum(np.quantile(drawn, CI90) * [-1, 1], 0.0)
        if value + missing > interval(value, terms, (low, high))[1]:
            traits.setdefault("at_least", []).append(name)
        arms, sd = (low, max(high, missing)), np.hypot(sd, drawn.std(ddof=1))
    traits[f"{name}_se"] = rounded(float(sd))
    traits[f"{name}_ci90"] = [rounded(end) for end in interval(value, terms, arms)]
    told = {"drawn_low": arms[0], "drawn_high": arms[1], **terms}
    traits.setdefault("interval_terms", {})[name] = {k: rounded(float(v)) for k, v in told.items()}


def _section_area(traits: dict) -> dict:
    """The trunk's cross-section area as a circle's of its diameter, with the diameter's error."""
    name, diameter = "tcsa_cm2", traits["trunk_diameter_m"]
    area: dict[str, Any] = {name: rounded(np.pi / 4 * _CM2 * diameter**2)}
    if "trunk_diameter_m_ci90" in traits:
        error, ends = traits["trunk_diameter_m_se"], traits["trunk_diameter_m_ci90"]
        area[f"{name}_se"] = rounded(np.pi / 2 * _CM2 * diameter * error)
        area[f"{name}_ci90"] = [rounded(np.pi / 4 * _CM2 * end**2) for end in ends]
    return area


def _sections(
    trunk: TrunkDiameter, further: dict[float, TrunkDiameter | None], scale_error: float
) -> dict:
    """Diameters at the further heights, and what each diameter rests on."""
    found = {height: item for height, item in further.items() if item is not None}
    errors = {
        height: spread({**item.terms, "scale": scale_error * item.diameter})
        for height, item in found.items()
    }
    return {
        "trunk_diameters": {f"{h:.2f}": rounded(item.diameter) for h, item in found.items()},
        "trunk_diameters_se": {f"{h:.2f}": rounded(float(error)) for h, error in errors.items()},
        "trunk_sections": [_section(item) for item in (trunk, *found.values())],
    }


def _section(item: TrunkDiameter) -> dict:
    """What a diameter rests on, for the report and for whoever doubts it."""
    return {
        "height_m": rounded(item.height),
        "diameter_m": rounded(item.diameter),
        "center": [rounded(value) for value in item.center],
        "axis": [rounded(value) for value in item.axis],
        "arc_deg": item.arc_deg,
        "residual_m": rounded(item.residual),
        "n_points": item.n_points,
        "source": item.source,
    }
