"""The trees of one scan: where each stands, which wood is whose, and a cloud of each alone.

A walk along a row is one scan of several trees. The choice of stems and the ways from their feet
are those that find a single target among its neighbours; here every stem that could be one is.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from cherrypicker.classes import wood_mask
from cherrypicker.errors import StageError
from cherrypicker.placement.footprint import Footprint
from cherrypicker.pointcloud import PointCloud
from cherrypicker.wood.target import TREE_SHARE, Candidate, choose_target
from cherrypicker.wood.target_wood import SharedWood

logger = logging.getLogger(__name__)

ALL = "all"
NO_TREE, NO_WOOD = 0, -1  # owners beside the numbers of trees, which start at 1


@dataclass
class FoundTrees:
    """The trees of a scan."""

    trees: list[Candidate]  # in the order of their numbers: of the list, else along the row
    asked_xy: list[np.ndarray]  # (2,) each: where each was asked for, or stands
    left_out: list[tuple[Candidate, str]]  # what else stands there, and why it is no tree
    # (n_points,) int16: number of each point's tree, from 1; `NO_TREE` of other wood, `NO_WOOD`
    owner: np.ndarray

    def report(self, scan: str, *, factor: float, unit: str) -> dict[str, Any]:
        """Content of trees.json of a scan; `factor` as of `wood.target.target_report`."""

        def shown(one: Candidate) -> dict[str, Any]:
            place = [round(value / factor, 4) for value in one.base[:2]]
            content = {"foot": one.base, "crop_target_xy": place, "height": one.height}
            return content | {"mass": one.mass}

        count = np.bincount(self.owner[self.owner >= 0], minlength=len(self.trees) + 1)
        trees = [
            {"number": number, "tree": f"{scan}_{number}", **shown(one)}
            | {"n_points": int(count[number]), "asked_xy": place.tolist()}
            for number, (one, place) in enumerate(zip(self.trees, self.asked_xy, strict=True), 1)
        ]
        left = [{**shown(one), "reason": reason} for one, reason in self.left_out]
        return {
            "unit": unit,
            "factor": factor,
            "trees": trees,
            "left_out": left,
            "n_wood": int(count.sum()),
            "n_of_no_tree": int(count[NO_TREE]),
        }


def read_places(given: Sequence) -> str | np.ndarray:
    """Return which trees are asked for: "all", or places of shape (n, 2).

    They are given as pairs, or as numbers one after the other, which may be strings, as a command
    line gives them. A `StageError` where they are none of these.
    """
    if given == ALL or list(given) == [ALL]:
        return ALL
    try:
        places = np.array(given, dtype=np.float64).reshape(-1, 2)
    except ValueError:
        places = np.empty((0, 2))
    if not len(places) or not np.isfinite(places).all():
        raise StageError(f"{given!r} is no list of places, nor {ALL!r}", key="crop.target_xy")
    return places


def find_trees(
    cloud: PointCloud,
    shared: SharedWood,
    asked: str | Sequence[ArrayLike] = ALL,
    *,
    region: Footprint | None = None,
) -> FoundTrees:
    """Find the trees of a scan and share its wood out among them.

    The cloud has the field ``label``, z up, and its wood is shared out. Asked for
    ``all``, trees are the stems that carry as much as one, else those nearest to places (n, 2) in
    the cloud's frame. Wood that comes in over the border of the region of interest is no tree's. A
    `StageError` where there is no tree, a place is none of the scene, or two places mean one stem.
    """
    labels = np.asarray(cloud["label"])
    trees, places, left = _chosen(cloud.points, shared, asked, region)
    number = np.full(len(shared.bases) + 2, NO_TREE, dtype=np.int16)
    for place, tree in enumerate(trees, 1):
        number[tree.stem] = place
    on_stem = shared.sample[shared.owner[shared.sample] >= 0]
    is_wood = wood_mask(labels)
    stem = shared.owner[is_wood]
    # A point without a way goes with the nearest wood that has one
    loose = stem < 0
    nearest = cKDTree(cloud.points[on_stem]).query(cloud.points[is_wood][loose])[1]
    stem[loose] = shared.owner[on_stem[nearest]]
    owner = np.full(len(labels), NO_WOOD, dtype=np.int16)
    owner[is_wood] = number[stem]
    for place, tree in enumerate(trees, 1):
        n_points = np.count_nonzero(owner == place)
        logger.info("tree %d at (%.2f, %.2f): %s points", place, *tree.base[:2], f"{n_points:,}")
    for other, reason in left:
        logger.info("left out at (%.2f, %.2f): %s", *other.base[:2], reason)
    return FoundTrees(trees, places, left, owner)


def _chosen(
    points: np.ndarray,
    shared: SharedWood,
    asked: str | Sequence[ArrayLike],
    region: Footprint | None,
) -> tuple[list[Candidate], list[np.ndarray], list[tuple[Candidate, str]]]:
    """The trees, where each was asked for, and what is left out and why."""
    owner = shared.owner[shared.sample]
    choose = partial(
        choose_target, points[shared.sample], shared.bases, owner, spacing=shared.spacing
    )
    if isinstance(asked, str):
        found = choose().candidates
        heaviest = max(one.mass for one in found)
        trees = [one for one in found if one.mass >= TREE_SHARE * heaviest]
        # Along the line that they stand in, from its lower x (or y) end
        feet = np.array([tree.base[:2] for tree in trees])
        along = np.linalg.svd(feet - feet.mean(axis=0), full_matrices=False)[2][0]
        along *= np.sign(along[np.argmax(np.abs(along))]) or 1.0
        trees = [trees[i] for i in np.argsort(feet @ along, kind="stable")]
        least = f"% of the heaviest tree's wood, a tree {100 * TREE_SHARE:.0f} %"
        left = [
            (one, f"carries {100 * one.mass / heaviest:.0f} {least}")
            for one in found
            if one not in trees
        ]
        return trees, [np.array(tree.base[:2]) for tree in trees], left
    choices = [choose(region=region, target_xy=place) for place in asked]
    trees, places = [each.target for each in choices], [np.asarray(p, float) for p in asked]
    first: dict[int, int] = {}
    for number, tree in enumerate(trees, 1):
        if tree.stem in first:
            x, y = tree.base[:2]
            raise StageError(
                f"places {first[tree.stem]} and {number} mean one stem, at ({x:.3g}, {y:.3g}); "
                f"the nearest to {places[number - 1].round(3).tolist()} is no other",
                key="crop.target_xy",
            )
        first[tree.stem] = number
    reason = "no place of crop.target_xy is nearest to it"
    left = [(one, reason) for one in choices[0].candidates if one.stem not in first]
    return trees, places, left


def rows_of_tree(points: np.ndarray, owner: np.ndarray, number: int, foot: ArrayLike) -> np.ndarray:
    """One tree's points: its wood, and what is no wood as far from its foot as it is high or wide.

    Rows of the scan's points (n_points, 3), increasing, by their `FoundTrees.owner` (n_points,). A
    `StageError` where the owners are not of this cloud, or the tree of that number has no wood.
    """
    if len(owner) != len(points):
        raise StageError(
            f"the owners are of {len(owner):,} points, the cloud has {len(points):,}: they are not "
            "of one scan"
        )
    is_own = owner == number
    if not is_own.any():
        raise StageError(f"no wood of tree {number} in the scan", key="crop.target_xy")
    away = points - np.asarray(foot, dtype=np.float64)
    aside = np.linalg.norm(away[:, :2], axis=1)
    reach = max(aside[is_own].max(), away[is_own, 2].max())
    return np.flatnonzero(is_own | ((owner == NO_WOOD) & (aside <= reach)))


def scan_of_tree(found: dict[str, Any], number: int, scan: dict[str, Any]) -> dict[str, Any]:
    """Content of tree.json: what the stages after the split need to know of the scan.

    `found` is the content of trees.json, `scan` that of metric.json; of a ready cloud it has
    ``unit``, ``factor`` and ``region``. ``target_xy`` and ``neighbours_xy`` are added, in the frame
    of segmented.ply.
    """
    tree = found["trees"][number - 1]
    others = [one["foot"][:2] for one in found["trees"] if one is not tree]
    others += [one["foot"][:2] for one in found["left_out"]]
    return scan | {"target_xy": tree["foot"][:2], "neighbours_xy": others}
