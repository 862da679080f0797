"""A measured tree under the saw: what stands after cuts, and how sure each number of it is."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cherrypicker.bearing.ages import age_tree
from cherrypicker.bearing.measure import bearing_of_nodes
from cherrypicker.bearing.rates import read_rates
from cherrypicker.formats.measured import MeasuredTree
from cherrypicker.geometry.lines import Line
from cherrypicker.geometry.tree_walks import sum_from_root, sum_from_tips
from cherrypicker.skeleton import axis_of_node
from cherrypicker.traits.intervals import Z90, base_shares, volume_ends
from cherrypicker.traits.scaffold import BEYOND_M, Scaffold


class StandingTree:
    """What stands of a tree. A cut is a node, and takes all that hangs on it with it.

    It is made of the rows of ``branches.csv`` and ``limbs.csv`` and the content of ``traits.json``.
    A thinning cut leaves a ``stub`` beyond the bearer's surface. What stays of a limb and is
    shorter than ``least_limb`` is none, as of ``traits.min_limb_m``. The row runs as
    ``row_azimuth_deg`` says, from +x towards +y.

    Attributes
    ----------
    stands, stem, stays : ndarray of shape (n_nodes,), bool
        What is not cut; the trunk, and a leader that goes on above it; what no cut may take.
    owner : ndarray of shape (n_nodes,), int64
        Axis of each node.
    base : ndarray of shape (n_axes,), int64
        First node that a thinning cut of each axis takes.
    limb_base, limb_node : ndarray of shape (n_limbs,), int64
        That of each limb, and the node without which it is none.
    along : ndarray of shape (n_nodes,), float64
        Way to each node along its axis, from the node that the axis hangs on.
    length, volume, limb_area : ndarray of shape (n_nodes,), float64
        What each node adds to the tree; a limb's section, cm², goes with its node.
    sums : dict of str to ndarray of shape (n_nodes,), float64
        The same of what is told a cm² of the stem's section: ``length_m``, ``tips`` and, with a
        scale, shoots and bearing wood of `bearing_of_nodes`.
    height, across : ndarray of shape (n_nodes,), float64
        Over the stem's foot, and how far off it across the row.
    """

    def __init__(
        self,
        tree: MeasuredTree,
        branches: Sequence[Mapping],
        limbs: Sequence[Mapping],
        traits: Mapping,
        *,
        stub: float = 0.0,
        least_limb: float = 0.1,
        row_azimuth_deg: float = 0.0,
    ) -> None:
        skeleton = tree.skeleton
        self.tree, self.limbs, self.traits = tree, limbs, traits
        self.stands = np.ones(len(skeleton), dtype=bool)
        self.owner = axis_of_node(skeleton, tree.axis_list)
        self.stem = np.isin(self.owner, Scaffold(tree.by_points.skeleton, least=BEYOND_M).stem)
        self.stays = self.stem.copy()
        self.along = np.zeros(len(skeleton))
        self.base = self._nodes_beyond(stub)
        self.length = skeleton.edge_length
        self.volume = np.zeros(len(skeleton))
        pieces = tree.cylinders
        self.volume[pieces.node] = np.pi * pieces.radius**2 * pieces.length
        self.sums = {"length_m": self.length}
        of_limbs = [row["branch_id"] for row in limbs]
        self.limb_base = self.base[of_limbs]
        self.limb_node = np.maximum(self.limb_base, self._nodes_beyond(least_limb)[of_limbs])
        if skeleton.unit == "m":
            ages = age_tree(skeleton, tree.axis_list, read_rates())
            self.sums |= bearing_of_nodes(tree.axis_list, ages)
        self.sums["tips"] = (skeleton.n_children == 0).astype(np.float64)
        self.limb_area = np.zeros(len(skeleton))
        self.limb_area[self.limb_node] = [row["area_cm2"] for row in limbs]
        offset = skeleton.points - np.asarray(traits["foot"])
        azimuth = np.radians(row_azimuth_deg)
        self.height = offset[:, 2]
        self.across = np.abs(offset[:, :2] @ [-np.sin(azimuth), np.cos(azimuth)])
        self._ends = base_shares(branches)
        of_scale = traits.get("interval_terms", {}).get("height_m", {}).get("scale", 0.0)
        self._scale_error = of_scale / (traits.get("height_m") or 1.0)

    def _nodes_beyond(self, stub: float) -> np.ndarray:
        """First node of each axis that is more than a stub beyond its bearer's surface.

        On a limb it also lies beyond the limbs that fork off at the stem, which stand without it.
        Fills `along`.
        """
        axis_list, limbs = self.tree.axis_list, {row["branch_id"] for row in self.limbs}
        cut_at = np.zeros(len(axis_list))
        for index, axis in enumerate(axis_list):
            points = self.tree.axis_points(index)
            way = Line(points).along
            self.along[axis.nodes] = way[-len(axis.nodes) :]
            if axis.attach < 0:
                continue
            bearer = self.tree.axis_points(axis.parent)
            away = np.linalg.norm(points[1:, None] - bearer, axis=2)
            is_clear = (away - self.tree.axis_radii(axis.parent)).min(axis=1) > 0
            cut_at[index] = stub + way[np.argmax(is_clear)]
            if {index, axis.parent} <= limbs:
                cut_at[axis.parent] = max(cut_at[axis.parent], self.along[axis.attach] + stub)
        rows = [
            np.searchsorted(self.along[axis.nodes[:-1]], at, "right")
            for axis, at in zip(axis_list, cut_at, strict=True)
        ]
        return np.array([axis.nodes[row] for axis, row in zip(axis_list, rows, strict=True)])

    def cut(self, node: int) -> None:
        """Take a node and all that hangs on it."""
        self.stands[node] = False
        is_cut = (~self.stands).astype(np.float64)
        self.stands &= sum_from_root(self.tree.skeleton.parent, is_cut) == 0

    def beyond(self, values: np.ndarray) -> np.ndarray:
        """Sum of what stands of values over each node and all that hangs on it, (n_nodes,)."""
        return sum_from_tips(self.tree.skeleton.parent, np.where(self.stands, values, 0.0))

    def back_to_lateral(self, node: int) -> int:
        """Where to cut so that a node goes: beyond the last lateral below it, or at the base."""
        skeleton, axis = self.tree.skeleton, self.owner[node]
        base = self.base[axis]
        if self.along[node] <= self.along[base]:
            return int(self.tree.axis_list[axis].nodes[0])
        while node != base and skeleton.n_children[skeleton.parent[node]] == 1:
            node = int(skeleton.parent[node])
        return node

    def allowed(self, nodes: np.ndarray) -> np.ndarray:
        """Those of some nodes that a cut may be made at."""
        return nodes[self.stands[nodes] & (self.beyond(self.stays)[nodes] == 0)]

    def told(self) -> dict[str, Any]:
        """The numbers of what stands; ``_se`` is a standard error, None where it is not known."""
        traits, stands = self.traits, self.stands
        ratio, area = traits["limb_trunk_ratio"], self.limb_area.sum()
        left = {name: float(each[stands].sum()) for name, each in self.sums.items()}
        of_section = {f"{name}_per_cm2": each / traits["tcsa_cm2"] for name, each in left.items()}
        n_tips = left.pop("tips")
        shares = self._ends[self.owner[stands]]
        low, high = volume_ends(self.volume[stands], shares, self._scale_error)
        return {
            "limb_trunk_ratio": ratio * self.limb_area[stands].sum() / area if area else 0.0,
            "limb_trunk_ratio_se": self._ratio_error(),
            "n_limbs": int(stands[self.limb_node].sum()),
            **left,
            **self._as_whole("length", "_m", "total_length_m", left["length_m"]),
            "n_tips": round(n_tips),
            **self._as_whole("tips", "", "n_tips", n_tips),
            **of_section,
            "height_m": float(self.height[stands].max()),
            "height_m_se": traits.get("height_m_se"),
            "row_width_m": 2.0 * float(self.across[stands].max()),
            "row_width_m_se": traits.get("crown_width_m_se"),
            "volume_m3": float(self.volume[stands].sum()),
            "volume_low_m3": low,
            "volume_high_m3": high,
        }

    def _as_whole(self, of: str, unit: str, trait: str, left: float) -> dict[str, float | None]:
        """Interval of a sum over what stands, and the error of it a cm² of the stem's section.

        What was missed, or is none, is the same share of it as of the whole tree.
        """
        traits = self.traits
        ends, se, section = (traits.get(n) for n in (f"{trait}_ci90", f"{trait}_se", "tcsa_cm2_se"))
        whole = traits.get(trait)
        low, high = (None, None) if not whole or ends is None else (left * e / whole for e in ends)
        error = None
        if whole and se is not None and section is not None:
            share = np.hypot(se / whole, section / traits["tcsa_cm2"])
            error = float(share * left / traits["tcsa_cm2"])
        return {f"{of}_low{unit}": low, f"{of}_high{unit}": high, f"{of}{unit}_per_cm2_se": error}

    def _ratio_error(self) -> float | None:
        """Standard error of the ratio of the limbs that stand.

        The table of limbs tells the error of each section, ``traits.json`` that of their sum: what
        the limbs' errors have in common follows, as one correlation of all pairs, and holds for
        those that stand. The stem's error is that of its section.
        """
        traits, ends = self.traits, [row["diameter_high_m"] for row in self.limbs]
        error, stem = (traits.get(f"{name}_se") for name in ("limb_area_cm2", "tcsa_cm2"))
        if error is None or stem is None or None in ends or not self.limb_area.any():
            return None
        area, thick = (np.array([row[k] for row in self.limbs]) for k in ("area_cm2", "diameter_m"))
        own = 2.0 * area * (np.array(ends) / thick - 1.0) / Z90
        alone, together = float(own @ own), float(own.sum() ** 2)
        shared = np.clip((error**2 - alone) / max(together - alone, 1e-12), 0.0, 1.0)
        left = own[self.stands[self.limb_node]]
        of_limbs = np.sqrt((1.0 - shared) * (left @ left) + shared * left.sum() ** 2)
        ratio = traits["limb_trunk_ratio"] / area.sum()
        of_stem = stem / traits["tcsa_cm2"] * area[self.stands[self.limb_node]].sum()
        return float(ratio * np.hypot(of_limbs, of_stem))

    def cut_diameter(self, node: int) -> dict[str, Any]:
        """Diameter of a cut and its 90 % interval: as a limb's beside the stem, or its axis's."""
        names = ("diameter_m", "diameter_low_m", "diameter_high_m")
        if len(limb := np.flatnonzero(self.limb_base == node)):
            return {name: self.limbs[limb[0]][name] for name in names}
        found = 2.0 * self.tree.skeleton.radius[node] * np.append(1.0, self._ends[self.owner[node]])
        told = (None if np.isnan(each) else each for each in found.tolist())
        return dict(zip(names, told, strict=True))
