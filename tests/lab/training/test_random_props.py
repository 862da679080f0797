"""Scenes of things drawn at random: each has the class that its kind has, in any shape."""

import numpy as np
import pytest

from cherrypicker.classes import Label
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.training.segmentation import random_props, scenes
from cherrypicker_lab.training.segmentation.random_props import NO_WOOD

CLASSES = {
    "sign": Label.SIGN,
    "sign_post": Label.SIGN,
    "marker": Label.MARKER,
    "marker_post": Label.MARKER,
    "target": Label.CALIBRATION_UNIT,
    "ring": Label.CALIBRATION_UNIT,
    "roof": Label.ROOF,
    "roof_post": Label.ROOF,
    "support_post": Label.SUPPORT_POST,
    "patch": Label.TRUNK,
    "ivy": Label.TRUNK,
    "grass": Label.GROUND,
    "stone": Label.GROUND,
    "hose": Label.GROUND,
    **dict.fromkeys(("ladder", "crate", "tools", "legs", "solid", "house"), NO_WOOD),
}


@pytest.fixture(scope="module")
def filled():
    made = []
    small = {"habit": "leader", "height": 1.2, "trunk_radius": 0.02}
    for seed in range(40):
        rng = np.random.default_rng(seed)
        options = random_props.random_things(rng) | {"density": 0.2, "neighbours": 0, "net": None}
        scene = generate_scene(seed, **small, **options)
        random_props.add_random(scene, rng)
        made.append(scene)
    return made


def _named(made, name):
    return [(scene, thing) for scene in made for thing in scene.objects if thing.name == name]


def test_every_kind_is_drawn_and_has_its_class(filled):
    for name, label in CLASSES.items():
        labels = {thing.label for _, thing in _named(filled, name)}
        assert labels == {int(label)}, name


def test_nothing_lies_far_below_the_ground_or_holds_broken_places(filled):
    for scene in filled:
        for thing in scene.objects:
            points = thing.mesh.vertices
            assert np.isfinite(points).all(), thing.name
            top = points[points[:, 2].argmax()]
            assert top[2] > scene.ground_height(top[None, :2])[0] - 0.05, thing.name


def test_boards_and_roofs_come_in_many_sizes(filled):
    for name, ratio in (("sign", 5.0), ("roof", 1.5)):
        size = [np.linalg.norm(np.ptp(t.mesh.vertices, axis=0)) for _, t in _named(filled, name)]
        assert max(size) > ratio * min(size)


def test_what_grows_on_a_stem_lies_on_it(filled):
    for scene, thing in [*_named(filled, "patch"), *_named(filled, "ring")]:
        stem = scene.target.axes[0]
        apart = np.linalg.norm(thing.mesh.vertices[:, None] - stem.points[None], axis=2).min(axis=1)
        assert apart.max() < 2 * stem.reach.max() + 0.03


def test_a_sample_of_things_at_random_is_the_same_again_and_has_no_other_label():
    first = scenes.make_sample(5, 4000, things="random")
    again = scenes.make_sample(5, 4000, things="random")
    assert np.array_equal(first.points, again.points)
    assert set(np.unique(first.labels)) <= {*map(int, Label), NO_WOOD}
    assert {int(Label.GROUND), int(Label.BRANCH)} <= set(np.unique(first.labels))
