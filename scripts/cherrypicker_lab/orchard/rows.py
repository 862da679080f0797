"""A row of trees with touching crowns, seen from both alleys, whose every point knows its tree.

The trees of `scene.layout.generate_scene` stand so close that the crowns meet; the photos are a
walk along one side and back along the other, each aimed at the row beside it. Photos that are
rendered go round the ends of the row as well, for a reconstruction to join the two sides.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from cherrypicker.files import write_json
from cherrypicker_lab.orchard.grow.growth import HABITS
from cherrypicker_lab.orchard.scene.cameras import CameraModel, look_at, numbered_poses
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.seen.as_seen import AsSeen
from cherrypicker_lab.orchard.seen.sampling import sample_scene
from cherrypicker_lab.orchard.truth import tree_traits, write_skeleton, write_truth

N_TREES = 5
# Of the width of the first tree's crown: neighbours reach a tenth to a fourth into one another
SPACING_SHARE = (0.75, 0.9)
STEP_M = 0.35  # between two photos of the walk
LENS_HEIGHTS_M = (1.0, 1.9)
CAMERA = CameraModel(800, 1200, 1050.0)
# Of rendered photos: the same view in fewer pixels
PHOTO_CAMERA = CameraModel(750, 1000, 870.0, model="Orchard Row")
N_PHOTOS = 100  # 0.3 m apart on a row of 6 m
# Markers by the stem in the middle, one towards either alley, as a grower would lay them
MARKERS = [
    {
        "dictionary": "DICT_4X4_50", "id": number, "side_m": 0.25, "pose": "lying",
        "xy": (0.35 * side, 0.75 * side), "azimuth": -0.5 * np.pi * side, "tilt": 0.15,
    }
    for number, side in ((7, -1.0), (8, 1.0))
]  # fmt: skip
HAND_M, HAND_ROLL_DEG = 0.05, 1.2  # how far a hand is off, as on the demo's rings
TRUTH_POINTS = 600_000


def row_scene(seed, n_trees=N_TREES, markers=()):
    """Lay out a row without anything but trees and ground.

    The stems are 0.75 to 0.9 of the width of the first tree's crown apart.

    Parameters
    ----------
    seed : int
        Decides the trees, whose forms take turns, and how they stand.
    n_trees : int, default 5
    markers : sequence of dict, default none
        As of `generate_scene`.

    Returns
    -------
    Scene
    """
    forms = sorted(HABITS)
    habit = forms[seed % len(forms)]
    width = tree_traits(generate_scene(seed, habit=habit, neighbours=0).target)["crown_width_m"]
    spacing = width * np.random.default_rng([int(seed), 211]).uniform(*SPACING_SHARE)
    return generate_scene(
        seed, habit=habit, neighbours=n_trees - 1, row_spacing=float(spacing),
        markers=list(markers),
        sign=False, ring=False, cube=False, post=False, roof=False,
    )  # fmt: skip


def alley_poses(scene):
    """Photos of a walk along both sides of a row, at two heights in turn."""
    x = scene.offsets[:, 0]
    height, distance = _height_and_distance(scene)
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


def loop_poses(scene, n_photos=N_PHOTOS):
    """Photos of a walk around a row: along one alley, round the end, back along the other.

    Two heights in turn, evenly spaced, with a hand's jitter; each photo is aimed at the row beside
    it, half a metre on or back.

    Returns
    -------
    Poses
    """
    rng = np.random.default_rng([int(scene.seed), 67])
    low, high = scene.offsets[:, 0].min(), scene.offsets[:, 0].max()
    height, distance = _height_and_distance(scene)
    poses = []
    for number, (x, y) in enumerate(_stadium(low, high, distance, n_photos)):
        center = np.array([x, y, LENS_HEIGHTS_M[number % 2]]) + rng.normal(size=3) * HAND_M
        center[2] += scene.ground_height(center[None, :2])[0]
        aim = np.array([np.clip(x, low, high), 0.0, 0.45 * height])
        aim[0] += 0.5 if number % 3 else -0.5
        poses.append(look_at(center, aim, np.radians(rng.normal() * HAND_ROLL_DEG)))
    return numbered_poses(poses, PHOTO_CAMERA)


def _height_and_distance(scene):
    """Height of the highest tree, and how far off the row one stands to photograph it, m."""
    height = max(float(tree.skeleton().points[:, 2].max()) for tree in scene.trees)
    return height, float(np.clip(1.1 * height, 1.5, 5.0))


def _stadium(low, high, distance, n):
    """Places (n, 2), evenly spaced, at a distance from the line from (low, 0) to (high, 0)."""
    side, bend = high - low, np.pi * distance
    places = []
    for half, way in zip(*np.divmod(np.arange(n) * 2.0 * (side + bend) / n, side + bend)):
        turn = max(way - side, 0.0) / distance  # round the end
        x, y = min(way, side) + distance * np.sin(turn), -distance * np.cos(turn)
        places.append((low + x, y) if half == 0 else (high - x, -y))
    return np.array(places)


def write_row_truth(folder, scene, poses, name):
    """Write `write_truth`'s files of the whole row, and of each tree its skeleton and traits.

    ``skeleton_tree{i}.csv`` is in the scene's frame; ``trees.json`` has for each of ``trees`` its
    ``tree`` (the value of the cloud's field), ``foot`` and ``traits``.
    """
    folder = Path(folder)
    reach = float(np.abs(scene.offsets[:, 0]).max()) + 2.0
    write_truth(folder, scene, poses, n_points=TRUTH_POINTS, extent=reach, name=name)
    rows = []
    for i, (tree, foot) in enumerate(zip(scene.trees, scene.offsets)):
        skeleton = tree.skeleton()
        write_skeleton(
            folder / f"skeleton_tree{i}.csv", replace(skeleton, points=skeleton.points + foot)
        )
        rows.append({"tree": i, "foot": foot, "traits": tree_traits(tree)})
    write_json(folder / "trees.json", {"trees": rows})


def row_cloud(scene, n_points):
    """A row's labelled cloud as stereo would see it from the alleys.

    Returns
    -------
    PointCloud
        Fields ``label`` and ``tree`` (0 the first of `scene.trees`, 255 no tree).
    """
    reach = float(np.abs(scene.offsets[:, 0]).max()) + 1.5
    return sample_scene(
        scene, n_points, as_seen=AsSeen(), extent=reach, ground_share=0.3,
        poses=alley_poses(scene),
    )  # fmt: skip
