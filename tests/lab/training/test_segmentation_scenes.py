"""Training scenes: things that pass for one another, and fresh scenes in every epoch."""

import numpy as np
import pytest

from cherrypicker.classes import Label
from cherrypicker.errors import StageError
from cherrypicker_lab.orchard.grow.templates import BEARING
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.training.segmentation import props as things
from cherrypicker_lab.training.segmentation import scenes


@pytest.fixture(scope="module")
def filled():
    made = []
    small = {"habit": "leader", "height": 1.2, "trunk_radius": 0.02}
    for seed in range(12):
        rng = np.random.default_rng(seed)
        options = things.confusable_things(rng) | {"density": 0.3, "neighbours": seed % 2}
        scene = generate_scene(seed, **small, **options)
        things.add_confusable(scene, rng)
        made.append(scene)
    return made


def _named(scene, name):
    return [thing for thing in scene.objects if thing.name == name]


def test_what_is_confused_stands_in_many_scenes_with_its_own_class(filled):
    assert np.mean([len(_named(scene, "sign")) > 0 for scene in filled]) > 0.6
    for name, label in (
        ("sign_post", Label.SIGN),
        ("ring", Label.CALIBRATION_UNIT),
        ("support_post", Label.SUPPORT_POST),
    ):
        things_of = [thing for scene in filled for thing in _named(scene, name)]
        assert len(things_of) >= 4
        assert {thing.label for thing in things_of} == {int(label)}


def test_small_signs_come_as_small_as_markers(filled):
    plates = [np.ptp(t.mesh.vertices, axis=0) for s in filled for t in _named(s, "sign")]
    across = np.array([np.hypot(*size[:2]) for size in plates])
    assert across.min() < 0.2 and across.max() > 0.3


def test_posts_keep_clear_of_the_stem_and_rings_sit_on_one(filled):
    for scene in filled:
        stem = scene.target.axes[0]
        for post in _named(scene, "support_post"):
            foot = post.mesh.vertices[post.mesh.vertices[:, 2] < 0.2]
            assert np.hypot(*foot[:, :2].T).min() > stem.radii.max()
        feet = np.asarray(scene.offsets)[:, :2]
        for ring in _named(scene, "ring"):
            middle = ring.mesh.vertices.mean(axis=0)
            assert np.linalg.norm(feet - middle[:2], axis=1).min() < 0.25


def test_held_out_forms_are_never_drawn():
    assert not {"cherry_whip", "fir", "larch", "pine"} & set(things.FORMS)


def test_a_fifth_of_the_training_trees_and_no_held_out_one_is_bearing(monkeypatch):
    drawn = []

    def scene(seed, *, habit=None, **_):
        drawn.append(habit)
        raise InterruptedError

    monkeypatch.setattr(scenes, "generate_scene", scene)
    for first in (0, scenes.HELD_OUT_SEED):
        for seed in range(first, first + 100):
            with pytest.raises(InterruptedError):
                scenes.make_sample(seed, 1000)
    assert 10 < sum(habit in BEARING for habit in drawn[:100]) < 30
    assert not any(drawn[100:])


def test_equal_seeds_give_equal_scenes_and_files_are_kept(tmp_path):
    first = scenes.make_sample(7, 4000, things="confusable")
    again = scenes.make_sample(7, 4000, things="confusable")
    assert np.array_equal(first.points, again.points)
    assert np.array_equal(first.labels, again.labels)
    scenes.load_samples([7], tmp_path, 4000, things="confusable")
    [file] = tmp_path.iterdir()
    stamp = file.stat().st_mtime_ns
    [kept] = scenes.load_samples([7], tmp_path, 4000, things="confusable")
    assert list(tmp_path.iterdir()) == [file] and file.stat().st_mtime_ns == stamp
    assert np.abs(kept.points - first.points).max() <= scenes.QUANTUM_M
    assert np.array_equal(kept.labels, first.labels)


@pytest.fixture
def drawn(monkeypatch):
    """What was asked for, seed and kind, in place of scenes."""
    asked = []
    monkeypatch.setattr(
        scenes, "make_sample", lambda seed, _, *, things, skeletons: asked.append((seed, things))
    )
    return asked


def test_every_epoch_has_fresh_scenes_of_all_kinds(drawn):
    fresh = scenes.FreshScenes(1000, 200, skeletons=["tree.csv"], more=["a scan"])
    assert len(fresh) == 201 and fresh[200] == "a scan"
    for epoch in (0, 3):
        fresh.begin(epoch)
        for number in range(200):
            fresh[number]
    assert [seed for seed, _ in drawn] == [*range(1000, 1200), *range(1600, 1800)]
    shares = {kind: np.mean([things == kind for _, things in drawn]) for kind in scenes.SHARES}
    assert shares == pytest.approx(scenes.SHARES, abs=0.06)


def test_without_trees_from_elsewhere_there_are_no_such_scenes(drawn):
    fresh = scenes.FreshScenes(0, 50)
    for number in range(50):
        fresh[number]
    assert {things for _, things in drawn} == {*scenes.SHARES} - {"elsewhere"}


def test_held_out_seeds_cannot_be_trained_on():
    with pytest.raises(StageError, match="training seeds are 0 to 899999"):
        scenes.FreshScenes(899_999, 2)
    fresh = scenes.FreshScenes(899_900, 60)
    with pytest.raises(StageError, match="epoch 2 asks for 60 from 899960"):
        fresh.begin(1)
