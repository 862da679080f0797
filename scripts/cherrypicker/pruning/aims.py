"""Limits on a standing tree: what of it is over each, and which cuts serve it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.pruning.faults import crossings
from cherrypicker.pruning.standing import StandingTree


@dataclass
class Aim:
    """One limit.

    Attributes
    ----------
    name : str
        Of `cherrypicker.pruning.target.LIMITS`.
    weight : ndarray of shape (n_nodes,), float64
        What each node adds to what is limited.
    allowed : float
        What of that may stand.
    cuts : ndarray of int64
        Nodes to cut at.
    pairs : ndarray of shape (n, 3), int64, optional
        From `crossings`: then these are limited, and nodes have no weight of their own.
    """

    name: str
    weight: np.ndarray
    allowed: float
    cuts: np.ndarray
    pairs: np.ndarray | None = None

    def weights(self, standing: StandingTree) -> np.ndarray:
        """What each node adds now; a pair that touches counts once where both hang on one node."""
        if self.pairs is None:
            return self.weight
        touching = self.pairs[standing.stands[self.pairs[:, :2]].all(axis=1)]
        weight = self.weight.copy()
        np.add.at(weight, touching[:, :2], 1.0)
        np.add.at(weight, touching[:, 2], -1.0)
        return weight

    def amount(self, standing: StandingTree) -> float:
        """What stands of what is limited."""
        return float(self.weights(standing)[standing.stands].sum())

    def over(self, standing: StandingTree) -> float:
        """What of that is more than allowed; rounding is none."""
        over = self.amount(standing) - self.allowed
        return over if over > 1e-9 else 0.0


def aims_of(
    standing: StandingTree, limits: Mapping[str, float], light: Mapping | None = None
) -> list[Aim]:
    """The aims of limits, by the names of `cherrypicker.pruning.target.LIMITS`.

    Too much height or width is the length of wood beyond it, so that every cut there helps.

    Parameters
    ----------
    light : dict, optional
        ``light.json``.

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
    shares = {row["branch_id"]: _share_of_sky(row) for row in (light or {}).get("limbs", ())}
    angle, share = (
        np.array([find(row) for row in standing.limbs])
        for find in (lambda r: r["crotch_angle_deg"], lambda r: shares.get(r["branch_id"], 1.0))
    )

    def counted(nodes: np.ndarray) -> np.ndarray:
        return np.bincount(nodes, minlength=len(parent)).astype(np.float64)

    def outside(is_out: np.ndarray) -> tuple:
        return standing.length * is_out, 0.0, np.flatnonzero(is_out & ~is_out[parent])

    def going(is_to_go: np.ndarray) -> tuple:
        return counted(bases[is_to_go]), 0.0, bases[is_to_go]

    makers = {
        "height_m": lambda most: outside(standing.height > most),
        "row_width_m": lambda most: outside(standing.across > most / 2.0),
        "renew_limbs": lambda n: going(np.arange(len(bases)) < n),
        "steep_deg": lambda least: going(angle < least),
        "shaded_share": lambda least: going(share < least),
        "crossing": lambda most: _touching(standing, most),
        "limb_trunk_ratio": lambda most: (standing.limb_area, most * per_ratio, bases),
        "n_limbs": lambda most: (counted(bases), most, bases),
        "length_m_per_cm2": lambda most: (standing.length, most * section, sides),
        "tips_per_cm2": lambda most: (standing.is_tip, most * section, sides),
    }
    return [Aim(name, *makers[name](limit)) for name, limit in limits.items()]


def _touching(standing: StandingTree, most: float) -> tuple:
    """Of two axes that touch, the one that loses less wood goes back to a lateral below."""
    pairs, wood = crossings(standing), standing.beyond(standing.volume)
    ways = [np.array([standing.back_to_lateral(node) for node in pair[:2]]) for pair in pairs]
    allowed = [both for way in ways if len(both := standing.allowed(way))]
    lesser = np.array([both[np.argmin(wood[both])] for both in allowed], dtype=np.int64)
    return np.zeros(len(wood)), most, lesser, pairs


def _share_of_sky(row: Mapping) -> float:
    """Of the sky's light what a limb's leaves get, or without leaves its wood."""
    share = row.get("leaf_sky_share", row["sky_share"])
    return 1.0 if share is None else share
