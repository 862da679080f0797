"""Trees of known years as skeletons: their own, and as made of clouds like those of photos."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import wood_mask
from cherrypicker.pointcloud import PointCloud
from cherrypicker.skeleton.model import Skeleton
from cherrypicker_lab.orchard.grow.years import grow_years, node_ages, node_is_spur
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.seen.as_seen import AsSeen, see_scene
from cherrypicker_lab.skeletons.methods import find_skeleton

N_POINTS = 150_000


@dataclass
class AgedTree:
    """A skeleton whose nodes' ages are known.

    `age` (n,) int64, 1 for the last year's wood; `is_spur` (n,) bool: it and all beyond is short.
    """

    name: str
    skeleton: Skeleton
    age: np.ndarray
    is_spur: np.ndarray


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
    return AgedTree(f"{true.name} as seen", skeleton, true.age[near], true.is_spur[near])
