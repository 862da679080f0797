"""An ordered list of cuts that brings a tree to its target.

Limits on where wood may stand come first, then wood that is to go, then how much may be left, at
last what still touches. Of each of these in turn every step takes the cut that brings the limits
nearest: the sum over them of the share of what was over that goes with it. So a ratio is served by
the largest limbs first, as in Schupp et al. 2017. Of cuts that bring them equally near, as where
several reach them, it takes the one that loses least wood. The list begins with the thickest cut.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.geometry.tree_walks import last_common
from cherrypicker.pruning.aims import Aim, aims_of
from cherrypicker.pruning.standing import StandingTree
from cherrypicker.pruning.target import TURNS, Target
from cherrypicker.traits.intervals import interval


def propose_cuts(
    standing: StandingTree,
    target: Target,
    *,
    keep: Sequence[int] = (),
    light: Mapping | None = None,
) -> tuple[dict, list[dict]]:
    """Propose cuts, and make them on the standing tree, all of which stands.

    The stem stands up to the height that the target asks for, whole where it asks for none. No cut
    may take an axis whose ``branch_id`` is in ``keep``; ``light`` is the content of ``light.json``.
    Returns the content of ``pruning.json``, and the rows of ``pruning.csv`` in the order of the
    cuts.

    Raises
    ------
    StageError
        If `keep` names no axis of the tree; from `aims_of`.
    """
    n_axes, parent = len(standing.base), standing.tree.skeleton.parent
    if strangers := [axis for axis in keep if not 0 <= axis < n_axes]:
        raise StageError(f"no axis {strangers[0]}, the tree has {n_axes}", key="pruning.keep")
    standing.stays = standing.stem & (standing.height <= target.limits.get("height_m", np.inf))
    standing.stays |= np.isin(standing.owner, list(keep))
    before = standing.told()
    was = [aim.amount(standing) for aim in aims_of(standing, target.limits, light)]
    chosen: dict[int, list[str]] = {}
    for turn in TURNS:
        limits = {name: limit for name, limit in target.limits.items() if name in turn}
        first = {aim.name: aim.over(standing) for aim in aims_of(standing, limits, light)}
        # Sought anew after each cut: axes that touched may not, or in another place
        while found := _best_cut(standing, aims_of(standing, limits, light), first):
            node, served = found
            # A cut on wood that a later one takes is none
            for beyond in [cut for cut in chosen if last_common(parent, node, cut) == node]:
                del chosen[beyond]
            chosen[node] = [turn[name][0] for name in served]
            standing.cut(node)
    standing.stands[:] = True
    in_turn = sorted(chosen, key=lambda node: -standing.cut_diameter(node)["diameter_m"])
    rows = [_made(standing, node, chosen[node], at) for at, node in enumerate(in_turn, 1)]
    after = standing.told()
    aims = aims_of(standing, target.limits, light)
    told = [
        {
            "name": aim.name,
            "limit": aim.allowed if aim.name in TURNS[1] else target.limits[aim.name],
            "before": before.get(aim.name, amount),
            "after": after.get(aim.name, aim.amount(standing)),
            "after_se": after.get(f"{aim.name}_se"),
            "is_reached": not aim.over(standing),
        }
        for aim, amount in zip(aims, was, strict=True)
    ]
    head = {"unit": standing.tree.skeleton.unit, "preset": target.preset, "source": target.source}
    notes = list(target.notes)
    if before["n_limbs"] and not after["n_limbs"]:
        notes.append(f"no limb is left: {target.preset} does not fit the form of this tree")
    told_of = {"notes": notes, "keep": list(keep), "n_cuts": len(rows)}
    return head | told_of | {"targets": told, "before": before, "after": after}, rows


def _best_cut(
    standing: StandingTree, aims: list[Aim], first: Mapping[str, float]
) -> tuple[int, list[str]] | None:
    """The cut that brings aims nearest, and the names of those; None where no cut does."""
    still = [(aim, over) for aim in aims if (over := aim.over(standing))]
    if not still:
        return None
    cuts = standing.allowed(np.unique(np.concatenate([aim.cuts for aim, _ in still])))
    gains = np.zeros((len(still), len(cuts)))
    for row, (aim, over) in enumerate(still):
        gains[row] = np.minimum(standing.beyond(aim.weight)[cuts], over) / first[aim.name]
    gain = gains.sum(axis=0)
    if gain.max(initial=0.0) <= 1e-9:
        return None
    equal = np.flatnonzero(gain >= gain.max() - 1e-9)
    best = equal[np.argmin(standing.beyond(standing.volume)[cuts[equal]])]
    served = np.flatnonzero(gains[:, best] > 1e-9)
    return int(cuts[best]), [still[row][0].name for row in served]


def _made(standing: StandingTree, node: int, reasons: list[str], number: int) -> dict:
    """Make a cut; its row of ``pruning.csv``."""
    skeleton, axis = standing.tree.skeleton, int(standing.owner[node])
    length, volume = (standing.beyond(each)[node] for each in (standing.length, standing.volume))
    below = int(skeleton.parent[node])
    is_thinning = standing.along[node] <= standing.along[standing.base[axis]]
    standing.cut(node)
    left = standing.told()
    ratio, error = left["limb_trunk_ratio"], left["limb_trunk_ratio_se"]
    low_ratio, high_ratio = (None, None) if error is None else interval(ratio, {"fit": error})
    return {
        "cut": number,
        "branch_id": axis,
        "node": node,
        "kind": "thinning" if is_thinning and not standing.stem[node] else "heading",
        "reasons": " ".join(reasons),
        "along_m": standing.along[below] if standing.owner[below] == axis else 0.0,
        "height_m": standing.height[below],
        **dict(zip(("x_m", "y_m", "z_m"), skeleton.points[below].tolist(), strict=True)),
        **standing.cut_diameter(node),
        "removed_length_m": length,
        "removed_volume_m3": volume,
        "ratio_after": ratio,
        "ratio_low": low_ratio,
        "ratio_high": high_ratio,
        "n_limbs_after": left["n_limbs"],
        "length_after_m": left["length_m"],
        "n_tips_after": left["n_tips"],
        "shoots_after": left.get("shoots"),
        "bearing_length_after_m": left.get("bearing_length_m"),
        "height_after_m": left["height_m"],
        "sky_share_after": None,  # until `light_left` tells
        "season_mj_after": None,
        "volume_after_m3": left["volume_m3"],
        **{name: end for name, end in left.items() if "_low_m" in name or "_high_m" in name},
    }
