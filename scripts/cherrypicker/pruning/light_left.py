"""The light that cuts leave to a tree's leaves, or without leaves to its wood."""

from collections.abc import Mapping, Sequence

import numpy as np

from cherrypicker.geometry.tree_walks import sum_from_root
from cherrypicker.light.measure import LightOptions, mesh_of, season_of
from cherrypicker.light.rays import cast_cuts
from cherrypicker.light.sky import sky_directions
from cherrypicker.pruning.standing import StandingTree
from cherrypicker.traits.limb_table import limb_of_axis


def light_left(
    standing: StandingTree, rows: Sequence[Mapping], light: Mapping, *, threads: int = 1
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """The light before any cut and after each of the ``rows`` of ``pruning.csv``.

    The options of ``light``, the content of ``light.json``, hold here as well; the neighbours in
    the row stay uncut. Returned by name are ``sky_share`` as of `measure_light` and, of a season,
    ``season_mj``, direct and diffuse: that of the tree, (n_cuts + 1,) float64, and that of each
    limb by rank with all that it carries, (n_cuts + 1, n_limbs) float64; NaN where it is none any
    more.
    """
    tree, limbs = standing.tree, np.array([row["branch_id"] for row in standing.limbs], dtype=int)
    options = LightOptions(**{name: light[name] for name in vars(LightOptions())})
    mesh, row_step = mesh_of(tree, options)
    sooner = np.zeros(len(tree.skeleton), dtype=np.int64)  # no cut lies beyond another
    sooner[[row["node"] for row in rows]] = np.arange(len(rows)) - len(rows)
    cut_of_node = len(rows) + sum_from_root(tree.skeleton.parent, sooner)
    directions = sky_directions()
    season = season_of(options, directions)
    even = np.ones(len(directions))
    weights = np.array([even, season.beam + season.diffuse] if season else [even])
    lit, own = cast_cuts(mesh, directions, cut_of_node, weights, row_step=row_step, threads=threads)
    parts = np.flatnonzero(mesh.is_leaf == mesh.is_leaf.any())
    lit, own = lit[..., parts], own[:, parts]
    carried = limb_of_axis(tree.axis_list, limbs.tolist())
    of_limb = carried[mesh.axis[parts], None] == limbs
    stands = np.arange(len(rows) + 1)[:, None] <= cut_of_node[standing.limb_node]
    of_tree, of_limbs = lit.sum(axis=2), np.where(stands, lit @ of_limb, np.nan)
    found = {"sky_share": (of_tree[0] / own.sum(axis=1), of_limbs[0] / (own @ of_limb))}
    return found | ({"season_mj": (of_tree[1], of_limbs[1])} if season else {})


def add_light_left(
    standing: StandingTree, summary: dict, rows: list[dict], light: Mapping, *, threads: int = 1
) -> None:
    """Write the light into what `propose_cuts` found, in place.

    ``sky_share_after`` and ``season_mj_after`` of each row; in the summary both before and after,
    and a list ``light_of_limbs`` with those of each limb, None after its cut.
    """
    summary["light_of_limbs"] = [{"branch_id": limb["branch_id"]} for limb in standing.limbs]
    for name, (of_tree, of_limbs) in light_left(standing, rows, light, threads=threads).items():
        for row, found in zip(rows, of_tree[1:].tolist(), strict=True):
            row[f"{name}_after"] = found
        summary["before"][name], summary["after"][name] = of_tree[[0, -1]].tolist()
        ends = zip(of_limbs[0].tolist(), of_limbs[-1].tolist(), strict=True)
        for told, (before, after) in zip(summary["light_of_limbs"], ends, strict=True):
            told[name], told[f"{name}_after"] = before, None if np.isnan(after) else after
