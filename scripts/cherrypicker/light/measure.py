"""Light of a tree by axis and by limb: silhouettes, share of the sky, energy over a season."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from cherrypicker.errors import StageError
from cherrypicker.files import rounded
from cherrypicker.formats.measured import MeasuredTree
from cherrypicker.light.mesh import PartMesh, leaf_mesh, wood_mesh
from cherrypicker.light.rays import Silhouettes, cast_silhouettes
from cherrypicker.light.sky import SeasonLight, season_light, sky_directions
from cherrypicker.skeleton import axis_of_node
from cherrypicker.traits.limb_table import limb_of_axis


@dataclass(frozen=True)
class LightOptions:
    """Config keys of the section ``light``, as the schema describes them."""

    place_deg: tuple[float, float] | None = None
    season: tuple[str, str] | None = None
    north_deg: float = 90.0
    row_spacing_m: float | None = None
    row_azimuth_deg: float = 0.0
    leaf_area_cm2: float = 0.0

    def check(self, unit: str) -> None:
        """Raise a StageError, which names the key, of what goes only with something else."""
        needed = ("place_deg", "season")
        missing = [f"light.{name}" for name in needed if getattr(self, name) is None]
        if 0 < len(missing) < len(needed):
            raise StageError(
                f"light over a season needs place and season, and {' and '.join(missing)} is empty",
                key=", ".join(missing),
            )
        if self.season and self.season[1] < self.season[0]:
            first, last = self.season
            cause = f"the season ends, {last}, before it begins, {first}"
            raise StageError(cause, key="light.season")
        if unit != "m" and (self.season or self.row_spacing_m or self.leaf_area_cm2):
            raise StageError("light of a season, row or leaves needs a scale", key="scale.mode")


def measure_light(
    tree: MeasuredTree,
    limbs: list[int],
    options: LightOptions | None = None,
    *,
    seed: int = 0,
    threads: int = 1,
) -> tuple[dict, list[dict]]:
    """Measure the light that a tree's axes receive.

    `limbs` are the ``branch_id`` of each limb, by rank; seed and threads are as in
    `cast_silhouettes`. Options that do not go together raise the StageError of
    `LightOptions.check`.

    Returns
    -------
    totals : dict
        What ``light.json`` holds: the options, the tree, and each limb with all that it carries.
    rows : list of dict
        Of ``light.csv``: one an axis.
    """
    options = options or LightOptions()
    options.check(tree.skeleton.unit)
    directions = sky_directions()
    season = season_of(options, directions)
    mesh, row_step = mesh_of(tree, options)
    seen = cast_silhouettes(mesh, directions, row_step=row_step, seed=seed, threads=threads)
    n_axes = len(tree.axis_list)
    carried = limb_of_axis(tree.axis_list, limbs)
    rank_of = {limb: rank for rank, limb in enumerate(limbs, 1)}
    rank = np.array([rank_of.get(limb, 0) for limb in carried.tolist()])
    owner = axis_of_node(tree.skeleton, tree.axis_list)[: len(seen.step_share)]
    in_shade = tree.skeleton.edge_length[: len(owner)] * (1.0 - seen.step_share)
    shaded = np.bincount(owner, in_shade, minlength=len(mesh.axis))

    def sums(group: np.ndarray, n_groups: int) -> list[dict[str, float | None]]:
        return light_sums(mesh, seen, shaded, season, group, n_groups)

    rows = [
        {"branch_id": axis, "limb_rank": rank[axis] or "", **found}
        for axis, found in enumerate(sums(mesh.axis, n_axes))
    ]
    of_ranks = sums(rank[mesh.axis], len(limbs) + 1)
    of_limbs = [{"rank": at, "branch_id": limb, **of_ranks[at]} for limb, at in rank_of.items()]
    head = {"unit": tree.skeleton.unit, "n_directions": len(directions), **vars(options)}
    return head | sums(0 * mesh.axis, 1)[0] | {"limbs": of_limbs}, rows


def mesh_of(tree: MeasuredTree, options: LightOptions) -> tuple[PartMesh, np.ndarray | None]:
    """The tree's wood and leaves, and the way to its neighbour in the row, None without one."""
    row_step = None
    if options.row_spacing_m:
        azimuth = np.radians(options.row_azimuth_deg)
        row_step = options.row_spacing_m * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    mesh = wood_mesh(tree)
    if options.leaf_area_cm2:
        mesh = mesh.with_parts(leaf_mesh(tree, options.leaf_area_cm2 / 1e4))
    return mesh, row_step


def season_of(options: LightOptions, directions: np.ndarray) -> SeasonLight | None:
    """The season's light from directions of the sky (n, 3); None where none is asked for."""
    if not options.season or not options.place_deg:
        return None
    return season_light(directions, *options.place_deg, options.season, north_deg=options.north_deg)


def light_sums(
    mesh: PartMesh,
    seen: Silhouettes,
    shaded: np.ndarray,
    season: SeasonLight | None,
    group: np.ndarray,
    n_groups: int,
) -> list[dict[str, float | None]]:
    """Sum the light of parts by group, the wood's and, with the prefix ``leaf_``, the leaves'.

    `shaded` is each part's length in shade, `group` each part's group; the sums stand in a list by
    group, with the columns of docs/light.md. A share of nothing is None.
    """
    columns: dict[str, np.ndarray] = {}
    for prefix, of_kind in (("", ~mesh.is_leaf), ("leaf_", mesh.is_leaf)):
        if not of_kind.any():
            continue
        parts = np.flatnonzero(of_kind)
        entries = (np.ones(len(parts)), (parts, group[parts]))
        member = csr_matrix(entries, shape=(len(group), n_groups))
        lit, alone, area = seen.lit @ member, seen.own.sum(axis=0) @ member, mesh.areas() @ member
        silhouette = lit.mean(axis=0)
        found = {
            "area_m2": area,
            "silhouette_m2": silhouette,
            "star": silhouette / np.where(area > 0, area, np.nan),
            "sky_share": lit.sum(axis=0) / np.where(alone > 0, alone, np.nan),
        }
        if season:
            found["direct_mj"] = season.beam @ lit
            found["diffuse_mj"] = season.diffuse @ lit
        if not prefix:
            found["shaded_length_m"] = shaded @ member
        columns |= {prefix + name: values for name, values in found.items()}
    return [
        {
            name: None if np.isnan(values[row]) else rounded(values[row])
            for name, values in columns.items()
        }
        for row in range(n_groups)
    ]
