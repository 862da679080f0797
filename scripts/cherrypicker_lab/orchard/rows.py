"""A row of trees with touching crowns, seen from both alleys, whose every point knows its tree.

The trees of `scene.layout.generate_scene` stand so close that the crowns meet; the photos are a
walk along one side and back along the other, each aimed at the row beside it.
"""

import numpy as np

from cherrypicker_lab.orchard.grow.growth import HABITS
from cherrypicker_lab.orchard.scene.cameras import CameraModel, look_at, numbered_poses
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.seen.as_seen import AsSeen
from cherrypicker_lab.orchard.seen.sampling import sample_scene
from cherrypicker_lab.orchard.truth import tree_traits

N_TREES = 5
# Of the width of the first tree's crown: neighbours reach a tenth to a fourth into one another
SPACING_SHARE = (0.75, 0.9)
STEP_M = 0.35  # between two photos of the walk
LENS_HEIGHTS_M = (1.0, 1.9)
CAMERA = CameraModel(800, 1200, 1050.0)


def row_scene(seed):
    """Lay out a row without anything but trees and ground.

    The stems are 0.75 to 0.9 of the width of the first tree's crown apart. The seed decides the
    trees, whose forms take turns, and how they stand.
    """
    forms = sorted(HABITS)
    habit = forms[seed % len(forms)]
    width = tree_traits(generate_scene(seed, habit=habit, neighbours=0).target)["crown_width_m"]
    spacing = width * np.random.default_rng([int(seed), 211]).uniform(*SPACING_SHARE)
    return generate_scene(
        seed, habit=habit, neighbours=N_TREES - 1, row_spacing=float(spacing), markers=[],
        sign=False, ring=False, cube=False, post=False, roof=False,
    )  # fmt: skip


def alley_poses(scene):
    """Photos of a walk along both sides of a row, at two heights in turn."""
    x = scene.offsets[:, 0]
    height = max(tree.height for tree in scene.trees)
    distance = float(np.clip(1.1 * height, 1.5, 5.0))
    walk = np.arange(x.min() - distance, x.max() + distance, STEP_M)
    poses = []
    for side in (-1.0, 1.0):
        for number, place in enumerate(walk[:: int(side)]):
            center = np.array([place, side * distance, LENS_HEIGHTS_M[number % 2]])
            center[2] += scene.ground_height(center[None, :2])[0]
            aside = np.clip(place, x.min(), x.max())
            aim = np.array([aside + (0.5 if number % 3 else -0.5), 0.0, 0.45 * height])
            poses.append(look_at(center, aim))
    return numbered_poses(poses, CAMERA)


def row_cloud(scene, n_points):
    """A row's labelled cloud as stereo would see it from the alleys.

    Its fields are ``label`` and ``tree``, 0 for the first of `scene.trees`, 255 for no tree.
    """
    reach = float(np.abs(scene.offsets[:, 0]).max()) + 1.5
    return sample_scene(
        scene, n_points, as_seen=AsSeen(), extent=reach, ground_share=0.3,
        poses=alley_poses(scene),
    )  # fmt: skip
