"""Bearing wood of a tree: pieces of its axes with kind and age, and what limbs carry of each."""

from collections.abc import Mapping

import numpy as np

from cherrypicker.bearing.ages import Ages, age_tree
from cherrypicker.bearing.buds import LEAST_M, Buds
from cherrypicker.bearing.rates import SHORT, read_rates
from cherrypicker.errors import StageError
from cherrypicker.files import rounded
from cherrypicker.formats.measured import MeasuredTree
from cherrypicker.skeleton import Axis, axis_of_node
from cherrypicker.traits.limb_table import limb_of_axis

#: Of wood: a shoot of one year, short wood of any age, and longer wood of two years or older.
KINDS = ("shoot", "spur", "two_year", "older")
#: Of ``bearing.csv``.
COLUMNS = (
    *("branch_id", "start_m", "end_m", "length_m", "kind", "age_years", "p_age"),
    *(f"p_{kind}" for kind in KINDS),
)
#: Its last ones, empty without photos: buds of the piece, and on which length of it they are told.
HELD_COLUMNS = ("buds", "buds_told_m")


def kind_table(n_ages: int) -> np.ndarray:
    """Kind by type and age, a place in `KINDS`, (2, n_ages) int64."""
    table = np.tile(np.minimum(2 * (np.arange(n_ages) > 0) + (np.arange(n_ages) > 1), 3), (2, 1))
    table[SHORT] = KINDS.index("spur")
    return table


def kind_chances(chance: np.ndarray) -> np.ndarray:
    """Chance of each kind by node, (n_nodes, 4) float64, of `Ages.chance`."""
    table = kind_table(chance.shape[2])
    return np.stack([chance[:, table == kind].sum(axis=1) for kind in range(len(KINDS))], axis=1)


def kinds_and_ages(chance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Kind (a place in `KINDS`) and age of each node, (n_nodes,) int64 both.

    The age is the median of what it may be: as each may-be keeps to what the tree's order of growth
    allows, so do the medians. What is short by more than half is a spur.
    """
    n_ages = chance.shape[2]
    below = np.cumsum(chance.sum(axis=1), axis=1)
    age = 1 + np.minimum((below < 0.5).sum(axis=1), n_ages - 1)
    kind_of = kind_table(n_ages)
    is_short = chance[:, SHORT].sum(axis=1) > 0.5
    return kind_of[is_short.astype(int), age - 1], age


def measure_bearing(
    tree: MeasuredTree,
    limbs: list[dict],
    trunk_area_cm2: float | None = None,
    dated: np.ndarray | None = None,
    buds: Buds | None = None,
) -> tuple[dict, list[dict]]:
    """Tell the bearing wood of a tree in metres, and of its limbs, rows of ``limbs.csv`` by rank.

    The trunk's section, ``trunk_area_cm2``, may be unknown, and the buds; ``dated`` is as of
    `cherrypicker.bearing.ages.age_tree`. Returns what ``bearing.json`` holds, of the tree and of
    each limb with all that it carries, and the rows of ``bearing.csv``: one a piece, from base to
    tip of each axis.

    Raises
    ------
    StageError
        If the tree has no scale.
    """
    if tree.skeleton.unit != "m":
        raise StageError(
            f"tree {tree.name}: shoots and spurs are told by their lengths, and the scale is not "
            "known",
            key="bearing.enabled, scale.mode",
        )
    rates = read_rates()
    owner = axis_of_node(tree.skeleton, tree.axis_list)
    ages = age_tree(tree.skeleton, tree.axis_list, rates, dated)
    carried = limb_of_axis(tree.axis_list, [row["branch_id"] for row in limbs])
    of_nodes = bearing_of_nodes(tree.axis_list, ages)
    shoot = kind_chances(ages.chance)[:, KINDS.index("shoot")]

    def sums_over(chosen: np.ndarray, area_cm2: float | None) -> dict[str, float | None]:
        sums = bearing_sums(of_nodes, chosen, area_cm2)
        return sums if buds is None else sums | _shoot_buds(buds, np.where(chosen, shoot, 0.0))

    totals = sums_over(np.ones(len(owner), dtype=bool), trunk_area_cm2)
    of_limbs = []
    for rank, row in enumerate(limbs, 1):
        sums = sums_over(carried[owner] == row["branch_id"], row["area_cm2"])
        of_limbs.append({"rank": rank, "branch_id": row["branch_id"], **sums})
    head: dict = {"unit": "m", "oldest_told_years": rates.n_ages}
    if buds is not None:
        head["bud_noise_m"] = rounded(buds.noise_m) if np.isfinite(buds.noise_m) else None
    return head | totals | {"limbs": of_limbs}, piece_rows(tree, ages, buds)


def _shoot_buds(buds: Buds, shoot: np.ndarray) -> dict[str, float | None]:
    """Buds on shoots, by the chance of nodes to be of one; no ratio where noise hides some."""
    count, told = float(buds.n_on @ shoot), float(buds.told_m @ shoot)
    return {
        "shoot_buds": rounded(count),
        "shoot_buds_told_m": rounded(told),
        "shoot_buds_per_m": rounded(count / told) if told and buds.noise_m <= LEAST_M else None,
    }


def bearing_of_nodes(axis_list: list[Axis], ages: Ages) -> dict[str, np.ndarray]:
    """What each node adds to the tree's bearing wood as expected, (n_nodes,) float64 by name.

    These are ``shoots`` and ``spurs`` (ends of axes of each kind), ``shoot_length_m`` and
    ``bearing_length_m`` (two-year wood and spurs).
    """
    at_tip = np.zeros(len(ages.length))
    at_tip[[axis.nodes[-1] for axis in axis_list]] = 1.0
    shoot, spur, two_year, _ = kind_chances(ages.chance).T
    return {
        "shoots": at_tip * shoot,
        "spurs": at_tip * spur,
        "shoot_length_m": ages.length * shoot,
        "bearing_length_m": ages.length * (two_year + spur),
    }


def bearing_sums(
    of_nodes: Mapping[str, np.ndarray], chosen: np.ndarray, area_cm2: float | None
) -> dict[str, float | None]:
    """Sums over chosen nodes (n_nodes,) bool of `bearing_of_nodes`, also a cm² of a section.

    The latter, by the section's area, are named ``..._per_cm2``.
    """
    sums = {name: float(each[chosen].sum()) for name, each in of_nodes.items()}
    return {name: rounded(found) for name, found in sums.items()} | {
        f"{name}_per_cm2": rounded(found / area_cm2) if area_cm2 else None
        for name, found in sums.items()
    }


def piece_rows(tree: MeasuredTree, ages: Ages, buds: Buds | None = None) -> list[dict]:
    """Rows of ``bearing.csv``: runs of one kind and age along each axis."""
    kind, age = kinds_and_ages(ages.chance)
    chances = kind_chances(ages.chance)
    rows = []
    for branch, axis in enumerate(tree.axis_list):
        nodes = axis.nodes
        steps = tree.skeleton.edge_length[nodes]
        end = np.cumsum(steps)
        changed = (np.diff(kind[nodes]) != 0) | (np.diff(age[nodes]) != 0)
        for run in np.split(np.arange(len(nodes)), np.flatnonzero(changed) + 1):
            weight = ages.length[nodes[run]]
            weight = weight if weight.sum() > 0 else np.ones(len(run))
            mean = weight @ chances[nodes[run]] / weight.sum()
            years = int(age[nodes[run[0]]])
            told = ages.chance[nodes[run], :, years - 1].sum(axis=1)
            row = {
                "branch_id": branch,
                "start_m": rounded(end[run[0]] - steps[run[0]]),
                "end_m": rounded(end[run[-1]]),
                "length_m": rounded(ages.length[nodes[run]].sum()),
                "kind": KINDS[kind[nodes[run[0]]]],
                "age_years": years,
                "p_age": rounded(weight @ told / weight.sum()),
            }
            row |= {f"p_{name}": rounded(p) for name, p in zip(KINDS, mean, strict=True)}
            if buds is not None:
                count, told = buds.n_on[nodes[run]].sum(), buds.told_m[nodes[run]].sum()
                row |= zip(HELD_COLUMNS, (int(count), rounded(told)), strict=True)
            rows.append(row)
    return rows
