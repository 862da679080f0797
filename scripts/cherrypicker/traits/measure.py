"""All traits of one tree, with uncertainties and quality warnings."""

import logging
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from cherrypicker.classes import wood_mask
from cherrypicker.errors import StageError
from cherrypicker.evidence.frame_edges import frame_edges
from cherrypicker.evidence.missing_top import find_missing_top
from cherrypicker.files import rounded
from cherrypicker.geometry.error_terms import Terms
from cherrypicker.geometry.hulls import alpha_volume, hull_of
from cherrypicker.geometry.neighbors import quick_tree
from cherrypicker.pointcloud import PointCloud
from cherrypicker.skeleton.axes import axis_of_node
from cherrypicker.skeleton.axis_radii import typical_scatter
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.traits.branches import branch_rows
from cherrypicker.traits.crown import contour_volume, growth_by, measure_crown, missing_wood
from cherrypicker.traits.flags import at_least, quality_flags
from cherrypicker.traits.foot import find_foot
from cherrypicker.traits.intervals import CM2, Estimate
from cherrypicker.traits.limb_table import by_diameter, limb_rows, ratio_terms, squares_terms
from cherrypicker.traits.reports import Reports
from cherrypicker.traits.scaffold import Scaffold
from cherrypicker.traits.shoot_ends import draw_tips, find_shoot_ends
from cherrypicker.traits.sums import AxisSums, draw_unfound
from cherrypicker.traits.support import find_support, support_reach
from cherrypicker.traits.table import TRAITS
from cherrypicker.traits.trunk import TrunkDiameter, measure_near, stem_of

logger = logging.getLogger(__name__)

_ALPHA_SHARE = 0.15  # of the crown's width: hollows wider than this are outside (guess)
_ALPHA_CELLS = 5.0  # cells of the thinned points across such a hollow
_HECTARE_M2 = 1e4
# Draws behind an uncertainty; half and twice as many move standard errors of the length and of the
# tips by 4 % at most on three scans
N_DRAWS = 200
_OVER_GRAFT_M = 0.30  # where the stem is measured for the limb-to-trunk ratio (Schupp 2017)


@dataclass(frozen=True)
class TraitOptions:
    """How traits are measured; the fields are the config keys of ``traits``."""

    trunk_height_m: float = 0.30
    trunk_heights_m: tuple[float, ...] = (0.5, 1.0, 1.3)
    max_gap_m: float = 0.10
    min_limb_m: float = 0.10
    limb_classes_m: tuple[float, ...] = (0.01, 0.02, 0.03, 0.05)
    graft_height_m: float | None = None
    row_distance_m: float | None = None


class ScannedTree:
    """A tree's skeleton and its original points, and what its traits are read off, once each.

    Parameters as of `measure_traits`. The rows of `cherrypicker.traits.table.TRAITS` and of
    `cherrypicker.traits.flags.FLAGS` read the attributes.
    """

    def __init__(
        self,
        skeleton: Skeleton,
        cloud: PointCloud,
        reports: Reports,
        options: TraitOptions,
        seed: int,
    ) -> None:
        if len(skeleton) < 2:
            raise StageError("the skeleton has no edge, there is nothing to measure", key="graph")
        is_wood = wood_mask(cloud["label"])
        if not (n_wood := np.count_nonzero(is_wood)):
            raise StageError("no point is labelled trunk or branch", key="segment")
        self.unit, self.options = cloud.unit, options
        n_children = skeleton.n_children[1:]  # above the root
        self.n_junctions = int(np.count_nonzero(n_children > 1))
        self.scale_error = reports.scale_error if cloud.unit == "m" else 0.0
        wood, rng = cloud.points[is_wood], np.random.default_rng(seed)
        tree = quick_tree(wood)
        self.reach = support_reach(tree)
        self.support = find_support(skeleton, tree, self.reach, max_gap=options.max_gap_m)
        scaffold = Scaffold(skeleton, least=options.min_limb_m, kept=self.support.node)
        clear = scaffold.clear_stem()
        self.points = wood[self.support.point]
        if not len(self.points):
            raise StageError("no wood point lies near the skeleton", key="graph")
        has_confidence = "confidence" in cloud
        self.confidence = float(np.median(cloud["confidence"][is_wood])) if has_confidence else None
        self.foot = find_foot(skeleton, scaffold.axes[0].nodes, cloud.points, cloud["label"])
        foot_z = self.foot.point[2]
        logger.info(
            f"foot at z = {foot_z:.3f} ({self.foot.source}); {len(self.points):,} of {n_wood:,} "
            f"wood points near the skeleton ({100 * len(self.points) / n_wood:.1f} %)"
        )

        # The stem, and its diameters
        self.stem = stem_of(skeleton, scaffold.axes[0].nodes, self.foot)
        measured = partial(measure_near, self.stem, wood, rng=rng)
        self.trunk = measured(options.trunk_height_m)
        reached = [h for h in sorted(options.trunk_heights_m) if h <= self.stem.top]
        further = {height: measured(height, max_shift=0.0) for height in reached}
        self.sections = {h: item for h, item in further.items() if item.source == "points"}
        self.unmeasured = sorted(further.keys() - self.sections.keys())

        # Its limbs
        self.limbs = scaffold.limbs
        self.limb_trunk = self.trunk
        if options.graft_height_m is not None:
            self.limb_trunk = measured(options.graft_height_m + _OVER_GRAFT_M)

        # The crown above it, what of it is known to be missing, and where photos end before it
        self.crown_points = wood[self.support.point & ~clear[self.support.owner]]
        hull = hull_of(self.crown_points)
        ends = find_shoot_ends(skeleton, scaffold.axes, self.support.node, tree, self.reach)
        tips, scatter = draw_tips(ends, N_DRAWS, rng), typical_scatter(skeleton)
        extent, samples = measure_crown(
            self.points, hull, tips, ~clear[ends.nodes], scatter or 0.0, rng
        )
        self.missing_top = None
        if reports.photos is not None:
            self.missing_top = find_missing_top(reports.photos, self.points, self.foot.point)
        missing = missing_wood(self.support.missed, reports, self.missing_top, self.foot.point)
        self.edges = () if reports.poses is None else frame_edges(reports.poses, self.points)
        drawn, more = (samples - extent).T, growth_by(missing, extent, hull)
        top = {"fit": self.foot.error, "top_error": self.reach}
        self.height = self._estimate(extent[0] - foot_z, top, 1, drawn[0], more[0])
        sides, surface = {"width_error": self.reach}, {"hull_error": self.reach * hull.area}
        self.crown_width = self._estimate(extent[1], sides, 1, drawn[1], more[1])
        self.crown_volume = self._estimate(extent[2], surface, 3, drawn[2], more[2])
        base = skeleton.points[max(scaffold.crown_start, 0)]
        # None without a crown
        self.crown_base_height = base[2] - foot_z if len(self.crown_points) else None
        self.crown_projected_area = hull_of(hull.points[:, :2]).volume
        self.crown_alpha = _ALPHA_SHARE * max(self.crown_width.value, 1e-9)
        cell = self.crown_alpha / _ALPHA_CELLS
        self.crown_alpha_volume = alpha_volume(self.crown_points, self.crown_alpha, cell)
        self.crown_contour = contour_volume(self.crown_points, base[:2])

        # Its branches
        self.rows = branch_rows(
            skeleton,
            scaffold.axes,
            foot_z,
            scale_error=self.scale_error,
            photo_check=reports.photo_check,
        )
        self.limb_rows = limb_rows(
            scaffold, self.rows, self.limb_trunk.diameter, foot_z, scale_error=self.scale_error
        )
        owner = axis_of_node(skeleton, scaffold.axes)[self.support.owner[self.support.point]]
        n_points = np.bincount(owner, minlength=len(self.rows)).astype(np.float64)
        # The trunk is there, and what was bridged or drawn by hand was not found by its points
        n_points[0] = n_points[n_points == 0] = np.inf
        there = [1.0, *(1.0 if r["p_exists"] is None else r["p_exists"] for r in self.rows[1:])]
        self.total_length = float(skeleton.edge_length.sum())
        self.sums = AxisSums(
            self.rows,
            draw_unfound(n_points, np.array(there), N_DRAWS, rng),
            reports.photo_check.get("missing_length", 0.0),
            scatter,
            self.scale_error,
        )
        last = np.array([axis.nodes[-1] for axis in scaffold.axes])
        self.tips = self.sums.number(skeleton.n_children[last] == 0)
        # Candidates for last year's shoots: what lies beyond the last lateral of every side axis
        self.shoots = [row["shoot_length_m"] for row in self.rows if row["order"] > 0]
        self.spacings = [row["lateral_spacing_m"] for row in self.rows if row["lateral_spacing_m"]]

    def _estimate(
        self,
        value: float,
        terms: Terms,
        power: int,
        drawn: np.ndarray | None = None,
        missing: float = 0.0,
    ) -> Estimate:
        """A trait of a power of the length unit: the scale errs besides."""
        return Estimate.of(value, terms, drawn, missing, scale=power * self.scale_error)

    def diameter(self, section: TrunkDiameter) -> Estimate:
        """The stem's diameter at one of its sections."""
        return self._estimate(section.diameter, section.terms, 1)

    @property
    def limb_area(self) -> Estimate:
        """Sum of the limbs' cross-sections, cm²."""
        square, area = np.pi / 4 * CM2, sum(limb.diameter**2 for limb in self.limbs)
        terms = {name: square * term for name, term in squares_terms(self.limbs).items()}
        return self._estimate(square * area, terms, 2)

    @property
    def limb_trunk_ratio(self) -> Estimate:
        """That sum over the stem's cross-section (Schupp 2017)."""
        stem = self.limb_trunk
        ratio = sum(limb.diameter**2 for limb in self.limbs) / stem.diameter**2
        terms = ratio_terms(squares_terms(self.limbs), ratio, stem.diameter, stem.terms)
        return self._estimate(ratio, terms, 0)

    @property
    def crown_box(self) -> float:
        """Crown's width squared times its depth, from its base to the tree's height."""
        base = self.crown_base_height
        depth = 0.0 if base is None else max(self.height.value - base, 0.0)
        return self.crown_width.value**2 * depth

    @property
    def tree_row_volume(self) -> float | None:
        """That of a row of such trees, m³ a hectare; None where rows or metres are not known."""
        distance = self.options.row_distance_m
        if distance is None or self.unit != "m":
            return None
        return self.height.value * self.crown_width.value * _HECTARE_M2 / distance


def measure_traits(
    skeleton: Skeleton,
    cloud: PointCloud,
    reports: Reports | None = None,
    *,
    options: TraitOptions | None = None,
    seed: int = 0,
) -> tuple[dict, dict[str, list[dict]]]:
    """Measure a tree's traits on its skeleton and its original points.

    The cloud is the segmented one, z up, in the skeleton's frame and unit, with a field ``label``.
    ``reports`` are what earlier stages say of the scan, whose scale's standard error enters every
    uncertainty. Returns the content of ``traits.json``, and by the names ``branches`` and ``limbs``
    the rows of ``branches.csv`` and ``limbs.csv``.

    Raises
    ------
    StageError
        If the skeleton has no edge or the cloud no wood.
    """
    reports, options = reports or Reports(), options or TraitOptions()
    tree = ScannedTree(skeleton, cloud, reports, options, seed)
    traits: dict[str, Any] = {"unit": cloud.unit}
    terms, outgrown = {}, []
    for name, trait in TRAITS.items():
        if trait.value is None:
            if name in reports.photo_check:
                traits[name] = reports.photo_check[name]
            continue
        found = trait.value(tree)
        if isinstance(found, Estimate) and found.se is not None and found.ends is not None:
            digits = max(trait.digits, 6)
            traits[f"{name}_se"] = round(float(found.se), digits)
            traits[f"{name}_ci90"] = [round(float(end), digits) for end in found.ends]
            if found.terms:
                terms[name] = {key: round(float(one), digits) for key, one in found.terms.items()}
            if found.is_outgrown:
                outgrown.append(name)
        value = found.value if isinstance(found, Estimate) else found
        traits[name] = value if value is None else round(value, trait.digits)
    diameters = {f"{h:.2f}": tree.diameter(item) for h, item in tree.sections.items()}
    traits |= {
        "trunk_diameters": {h: rounded(found.value) for h, found in diameters.items()},
        "trunk_diameters_se": {h: rounded(found.se or 0.0) for h, found in diameters.items()},
        # What the diameters rest on, for the report and for whoever doubts them
        "trunk_sections": [
            {
                "height_m": rounded(item.height),
                "diameter_m": rounded(item.diameter),
                "center": [rounded(value) for value in item.center],
                "axis": [rounded(value) for value in item.axis],
                "arc_deg": item.arc_deg,
                "residual_m": rounded(item.residual),
                "n_points": item.n_points,
                "source": item.source,
            }
            for item in (tree.trunk, *tree.sections.values())
        ],
        "n_limbs_by_diameter": by_diameter(tree.limbs, options.limb_classes_m),
        **tree.sums.by_order(),
        "crown_volume_method": "convex hull",
        "foot": [rounded(value) for value in tree.foot.point],
        "interval_terms": terms,
        "flags": quality_flags(reports, tree),
    }
    traits["at_least"] = at_least(traits["flags"], outgrown)
    for flag in traits["flags"]:
        logger.info("flag: %s", flag)
    return traits, {"branches": tree.rows, "limbs": tree.limb_rows}
