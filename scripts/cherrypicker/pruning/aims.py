"""Limits on a standing tree: what of it is over each, and which cuts serve it."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.errors import StageError
from cherrypicker.geometry.tree_walks import last_common
from cherrypicker.pruning.standing import StandingTree


class Aim(NamedTuple):
    """One limit."""

    name: str  # of `cherrypicker.pruning.target.TURNS`
    weight: np.ndarray  # (n_nodes,) float64: what each node adds to what is limited
    allowed: float  # of that
    cuts: np.ndarray  # (n_cuts,) int64: nodes to cut at

    def amount(self, standing: StandingTree) -> float:
        """What stands of what is limited."""
        return float(self.weight[standing.stands].sum())

    def over(self, standing: StandingTree) -> float:
        """What of that is more than allowed; rounding is none."""
        over = self.amount(standing) - self.allowed
        return over if over > 1e-9 else 0.0


def aims_of(
    standing: StandingTree, limits: Mapping[str, float], light: Mapping | None
) -> list[Aim]:
    """The aims of limits, by the names of `cherrypicker.pruning.target.TURNS`.

    Too much height or width is the length of wood beyond it, so that every cut there helps. `light`
    is the content of ``light.json``.

    Raises
    ------
    StageError
        If shaded limbs are asked for and the light was not measured.
    """
    if "shaded_share" in limits and light is None:
        raise StageError("shaded limbs are asked for without light", key="light.enabled")
    traits, bases = standing.traits, standing.limb_base
    section, parent = traits["tcsa_cm2"], np.maximum(standing.tree.skeleton.parent, 0)
    per_ratio = standing.limb_area.sum() / max(traits["limb_trunk_ratio"], 1e-12)
    sides = standing.base[~standing.stem[standing.base]]
    # Of the sky's light what a limb's leaves get, or without leaves its wood
    lit = light["limbs"] if light else ()
    shares = {row["branch_id"]: row.get("leaf_sky_share", row["sky_share"]) for row in lit}
    angle = np.array([row["crotch_angle_deg"] for row in standing.limbs])
    share = np.array([shares.get(row["branch_id"]) for row in standing.limbs], dtype=np.float64)
    share[np.isnan(share)] = 1.0

    def counted(nodes: np.ndarray) -> np.ndarray:
        return np.bincount(nodes, minlength=len(parent)).astype(np.float64)

    def outside(is_out: np.ndarray) -> tuple:
        return standing.length * is_out, 0.0, np.flatnonzero(is_out & ~is_out[parent])

    def going(is_to_go: np.ndarray) -> tuple:
        return counted(standing.limb_node[is_to_go]), 0.0, bases[is_to_go]

    def touching(most: float) -> tuple:
        # Where the one of two goes back to a lateral that loses less wood, of those that may be cut
        wood, nodes = standing.beyond(standing.volume), []
        for pair in crossings(standing):
            both = np.array([standing.back_to_lateral(node) for node in pair])
            allowed = standing.allowed(both)
            both = allowed if len(allowed) else both
            nodes.append(both[np.argmin(wood[both])])
        cuts = np.array(nodes, dtype=np.int64)
        return counted(cuts), most, cuts

    def of_section(weight: np.ndarray) -> Callable[[float], tuple]:
        return lambda most: (weight, most * section, sides)

    makers = {
        "height_m": lambda most: outside(standing.height > most),
        "row_width_m": lambda most: outside(standing.across > most / 2.0),
        "renew_limbs": lambda n: going(np.arange(len(bases)) < n),
        "steep_deg": lambda least: going(angle < least),
        "shaded_share": lambda least: going(share < least),
        "crossing": touching,
        "limb_trunk_ratio": lambda most: (standing.limb_area, most * per_ratio, bases),
        "n_limbs": lambda most: (counted(standing.limb_node), most, bases),
    } | {f"{name}_per_cm2": of_section(weight) for name, weight in standing.sums.items()}
    return [Aim(name, *makers[name](limit)) for name, limit in limits.items()]


def crossings(standing: StandingTree) -> np.ndarray:
    """Places where two side axes that stand touch, one a pair of axes, (n, 2) int64.

    Of each the node of either axis. Nearer to the last node that both hang on than axes part that
    leave one another at 15 degrees (guess) it is a fork.
    """
    gap, least_angle_deg = 0.005, 15.0  # between surfaces: wind rubs what is nearer (guess)
    skeleton, owner = standing.tree.skeleton, standing.owner
    is_beyond = standing.along > standing.along[standing.base[owner]]
    own = np.flatnonzero(standing.stands & ~standing.stem & is_beyond)
    radius = skeleton.radius
    reach = 2.0 * radius[own].max(initial=0.0) + gap
    near = own[cKDTree(skeleton.points[own]).query_pairs(reach, output_type="ndarray")]
    one, other = near[owner[near[:, 0]] != owner[near[:, 1]]].T
    apart = np.linalg.norm(skeleton.points[one] - skeleton.points[other], axis=1)
    thick = radius[one] + radius[other] + gap
    to_root, found = skeleton.distance_to_root(), {}
    for row in np.flatnonzero(apart <= thick)[np.argsort((apart - thick)[apart <= thick])]:
        pair = frozenset((owner[one[row]], owner[other[row]]))
        fork = last_common(skeleton.parent, one[row], other[row])
        way = to_root[one[row]] + to_root[other[row]] - 2.0 * (to_root[fork] + radius[fork])
        if pair not in found and way > thick[row] / np.sin(np.radians(least_angle_deg) / 2.0):
            found[pair] = (one[row], other[row])
    return np.array(sorted(found.values()), dtype=np.int64).reshape(-1, 2)
