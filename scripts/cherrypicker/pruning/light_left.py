"""The sky's light that cuts leave to a tree's leaves, or without leaves to its wood."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cherrypicker.light.measure import LightOptions, mesh_of
from cherrypicker.light.rays import cast_cuts
from cherrypicker.light.sky import sky_directions
from cherrypicker.pruning.standing import StandingTree
from cherrypicker.traits.limb_table import limb_of_axis


def light_left(
    standing: StandingTree,
    rows: Sequence[Mapping],
    light: Mapping,
    *,
    threads: int = 1,
) -> tuple[np.ndarray, np.ndarray]:
    """Share of the sky's light before any cut and after each, as ``sky_share`` of `measure_light`.

    Parameters
    ----------
    rows : sequence of mapping
        Of ``pruning.csv``.
    light : mapping
        ``light.json``: its options hold here as well. The neighbours in the row stay uncut.
    threads : int
        As of `cherrypicker.light.rays.cast_cuts`.

    Returns
    -------
    of_tree : ndarray of shape (n_cuts + 1,), float64
    of_limbs : ndarray of shape (n_cuts + 1, n_limbs), float64
        Of each limb, by rank, with all that it carries; NaN where it is none any more.
    """
    tree, limbs = standing.tree, np.array([row["branch_id"] for row in standing.limbs], dtype=int)
    options = LightOptions(**{name: light[name] for name in vars(LightOptions())})
    mesh, row_step = mesh_of(tree, options)
    cut_of_node = np.full(len(tree.skeleton), len(rows))
    cut_of_node[[row["node"] for row in rows]] = np.arange(len(rows))
    for node in range(1, len(cut_of_node)):
        bearer = tree.skeleton.parent[node]
        cut_of_node[node] = min(cut_of_node[node], cut_of_node[bearer])
    shown = cast_cuts(mesh, sky_directions(), cut_of_node, row_step=row_step, threads=threads)
    parts = np.flatnonzero(mesh.is_leaf == mesh.is_leaf.any())
    lit, own = (each[:, parts] for each in shown)
    carried = limb_of_axis(tree.axis_list, limbs.tolist())
    of_limb = carried[mesh.axis[parts], None] == limbs
    n_made = np.arange(len(rows) + 1)[:, None]
    alone = np.where(n_made <= cut_of_node[standing.limb_node], own @ of_limb, np.nan)
    return lit.sum(axis=1) / own.sum(axis=1), (lit @ of_limb) / alone


def add_light_left(
    standing: StandingTree, summary: dict, rows: list[dict], light: Mapping, *, threads: int = 1
) -> None:
    """Write the light into what `propose_cuts` found, in place.

    ``sky_share_after`` of each row; in the summary ``sky_share`` before and after, and a list
    ``light_of_limbs`` with that of each limb, None after its cut.
    """
    of_tree, of_limbs = light_left(standing, rows, light, threads=threads)
    for row, share in zip(rows, of_tree[1:].tolist(), strict=True):
        row["sky_share_after"] = share
    summary["before"]["sky_share"], summary["after"]["sky_share"] = of_tree[[0, -1]].tolist()
    summary["light_of_limbs"] = [
        {
            "branch_id": limb["branch_id"],
            "sky_share": before,
            "sky_share_after": None if np.isnan(after) else after,
        }
        for limb, before, after in zip(
            standing.limbs, of_limbs[0].tolist(), of_limbs[-1].tolist(), strict=True
        )
    ]
