"""Trees of known years as skeletons: their own, and as made of clouds like those of photos."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.bearing.two_dates import odds_of_ages, seasons_between
from cherrypicker.classes import wood_mask
from cherrypicker.pointcloud import PointCloud
from cherrypicker.series.compare import Scan, compare_scans
from cherrypicker.series.wood import sample_wood
from cherrypicker.skeleton import Skeleton, axes
from cherrypicker.traits.branches import branch_rows
from cherrypicker_lab.orchard.grow.years import grow_years, node_ages, node_is_spur
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.seen.as_seen import AsSeen, see_scene
from cherrypicker_lab.skeletons.methods import find_skeleton

N_POINTS = 150_000
OTHER_PHOTOS = 1000  # between the seeds of two scans of a tree


@dataclass
class AgedTree:
    """A skeleton whose nodes' ages are known.

    `age` (n,) int64, 1 for the last year's wood; `is_spur` (n,) bool: it and all beyond is short;
    `cloud` (m, 3) float64: the points that it was made of.
    """

    name: str
    skeleton: Skeleton
    age: np.ndarray
    is_spur: np.ndarray
    cloud: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))


def year_tree(form, seed, *, years=None):
    """A grown tree (`Tree`), and its own skeleton as an `AgedTree`."""
    tree = grow_years(seed, form, years=years)
    ages, is_spur = node_ages(tree), node_is_spur(tree)
    return tree, AgedTree(f"{form}_{seed}", tree.skeleton(), ages, is_spur)


def as_seen_tree(tree, true, seed):
    """The skeleton of a tree from a cloud as photos would give it, with its nearest nodes' ages."""
    scene = generate_scene(
        seed, habit="leader", height=2.2, neighbours=0, sign=False, ring=False, cube=False,
        post=False, roof=False, markers=[], sky="clear",
    )  # fmt: skip
    scene.trees[0] = tree
    found = see_scene(scene, N_POINTS, np.random.default_rng(seed), AsSeen(), look=False)
    is_wood = wood_mask(found["label"])
    cloud = PointCloud(
        found["points"][is_wood],
        fields={"label": found["label"][is_wood].astype(np.uint8)},
        frame="metric",
        unit="m",
    )
    skeleton, _ = find_skeleton(cloud)
    _, near = cKDTree(true.skeleton.points + scene.offsets[0]).query(skeleton.points)
    name = f"{true.name} as seen"
    return AgedTree(name, skeleton, true.age[near], true.is_spur[near], cloud.points)


def year_before(form, seed, tree):
    """A grown tree as seen a year before, with its own photos."""
    last = max(int(axis.years[-1]) for axis in tree.axes)
    return as_seen_tree(*year_tree(form, seed, years=last - 1), seed + OTHER_PHOTOS)


def odds_by_year_before(before, tree, n_ages):
    """Odds of ages, as `age_tree` takes them, by a scan of the year before."""
    scans = []
    for scan, year in ((before, 2025), (tree, 2026)):
        wood = sample_wood(scan.skeleton)
        rows = branch_rows(scan.skeleton, axes(scan.skeleton), 0.0)
        scans.append(Scan(scan.name, f"{year}-02-01", wood, rows, scan.cloud))
    (step,) = compare_scans(scans).steps
    return odds_of_ages(step, seasons_between(step), n_ages)
