"""Scenes of what the network got wrong: foreign and wild trees, hollow boards, things at stems."""

import numpy as np
import pytest

from cherrypicker.classes import Label
from cherrypicker.errors import StageError
from cherrypicker_lab.orchard.grow.dressing import thin_out
from cherrypicker_lab.orchard.grow.elsewhere import tree_from_skeleton
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.scene.variety import scene_options
from cherrypicker_lab.training.segmentation import hard_props, scenes
from cherrypicker_lab.training.segmentation.random_props import NO_WOOD

CLASSES = {
    "sign": Label.SIGN,
    "marker": Label.MARKER,
    "target": Label.CALIBRATION_UNIT,
    "ring": Label.CALIBRATION_UNIT,
    "support_post": Label.SUPPORT_POST,
    "tie": Label.SUPPORT_POST,
    "wire": Label.SUPPORT_POST,
}


@pytest.fixture(scope="module")
def skeleton(tmp_path_factory):
    """A stem of 2 m with four limbs of 60 cm, every node at 2 cm."""
    rows = [(i, i - 1, 0, 0, 0.02 * i, 0.03) for i in range(101)]
    for limb in range(4):
        way = np.array([np.cos(limb * 1.6), np.sin(limb * 1.6), 0.3])
        start, parent = np.array([0, 0, 0.6 + 0.3 * limb]), 30 + 15 * limb
        for step in range(1, 31):
            rows.append((len(rows), parent, *(start + 0.02 * step * way), 0.009))
            parent = len(rows) - 1
    path = tmp_path_factory.mktemp("trees") / "tree.csv"
    lines = [",".join(f"{value:g}" for value in row) for row in rows]
    path.write_text("\n".join(["id,parent,x,y,z,radius", *lines]))
    return path


@pytest.fixture(scope="module")
def filled(skeleton):
    made = []
    small = {"habit": "leader", "height": 1.2, "trunk_radius": 0.02}
    for seed in range(24):
        rng = np.random.default_rng(seed)
        options = hard_props.hard_things(rng) | {"density": 0.2, "neighbours": 0, "net": None}
        scene = generate_scene(seed, **options | small)
        hard_props.add_hard(scene, rng, [skeleton] * (seed % 2))
        made.append(scene)
    return made


def _named(made, name):
    return [(scene, thing) for scene in made for thing in scene.objects if thing.name == name]


def test_a_foreign_skeleton_keeps_its_course_and_gets_radii_of_what_it_bears(skeleton):
    tree = tree_from_skeleton(skeleton, np.random.default_rng(1))
    stem, limbs = tree.axes[0], [axis for axis in tree.axes if axis.parent == 0]
    assert np.allclose(stem.points[0], 0) and np.abs(stem.points[:, :2]).max() < 1e-9
    joined = tree.skeleton()
    assert 1.3 <= joined.points[:, 2].max() <= 4.5
    assert len(joined.points) == 221
    for axis in limbs:
        assert np.allclose(axis.points[0], stem.points[axis.parent_node])
        assert axis.radii[0] <= stem.radii[axis.parent_node]
    # thickest at the foot, never thicker upwards
    assert (np.diff(stem.radii) <= 1e-12).all() and joined.radius.min() >= 0.001
    again = tree_from_skeleton(skeleton, np.random.default_rng(1))
    assert np.array_equal(again.skeleton().points, joined.points)


def test_an_orchard_scene_takes_it_as_its_target(skeleton):
    options = scene_options(3, chosen={"skeleton": str(skeleton), "background": "hills"})
    scene, again = (generate_scene(3, **options) for _ in range(2))
    assert scene.options["skeleton"] == str(skeleton)
    axes = scene.target.axes
    assert np.abs(axes[0].points[:, :2]).max() < 1e-9  # the file's stem is straight
    assert len(axes) > 5  # its limbs, and twigs where they end
    assert np.array_equal(scene.target.skeleton().points, again.target.skeleton().points)
    own = scene_options(3, chosen={"background": "hills"})
    assert options == own | {"skeleton": str(skeleton), "stubs": 0, "spurs": 0.0}


@pytest.mark.parametrize(
    "content",
    ["", "a,b\n1,2\n", "id,parent,x,y,z,radius\n0,-1,0,0,0,1\n1,-1,0,0,1,1\n2,1,0,0,2,1\n"],
)
def test_what_is_no_skeleton_is_refused_by_name(tmp_path, content):
    (tmp_path / "bad.csv").write_text(content)
    with pytest.raises(StageError, match=r"(in the table|without a parent).*bad\.csv"):
        tree_from_skeleton(tmp_path / "bad.csv", np.random.default_rng(0))


def test_every_kind_is_drawn_and_has_its_class(filled):
    for name, label in CLASSES.items():
        assert {thing.label for _, thing in _named(filled, name)} == {int(label)}, name


def test_things_lie_on_the_ground_and_at_the_stem(filled):
    for scene in filled:
        for thing in scene.objects:
            points = thing.mesh.vertices
            assert np.isfinite(points).all(), thing.name
            top = points[points[:, 2].argmax()]
            assert top[2] > scene.ground_height(top[None, :2])[0] - 0.05, thing.name
    apart = [
        np.linalg.norm(thing.mesh.vertices[:, None, :2] - scene.target.axes[0].points[None, :, :2],
                       axis=2).min()
        for name in ("support_post", "target", "sign")
        for scene, thing in _named(filled, name)
    ]  # fmt: skip
    assert np.mean(np.array(apart) < 0.1) > 0.3


def test_wild_trees_bear_more_and_stay_one_piece_above_the_ground(filled):
    assert np.median([len(scene.target.axes) for scene in filled]) > 40
    for scene in filled:
        joined = scene.target.skeleton()
        assert (joined.parent[1:] >= 0).all() and (joined.radius > 0).all()
        assert joined.points[:, 2].min() > -0.05
        for axis in scene.target.axes[1:]:
            assert np.allclose(
                axis.points[0], scene.target.axes[axis.parent].points[axis.parent_node]
            )


def test_a_pruned_tree_keeps_its_stem_and_whole_limbs(skeleton):
    tree = tree_from_skeleton(skeleton, np.random.default_rng(2))
    n_limbs = len(tree.axes)
    thin_out(np.random.default_rng(0), tree, 0.5)
    assert 1 <= len(tree.axes) < n_limbs
    assert tree.axes[0].parent == -1
    for axis in tree.axes[1:]:
        assert np.allclose(axis.points[0], tree.axes[axis.parent].points[axis.parent_node])
    thin_out(np.random.default_rng(0), tree, 1.0)
    assert not [axis for axis in tree.axes if axis.parent == 0]


def test_hollow_boards_have_a_rim_and_hardly_a_middle(filled):
    found = [thing.material["found"] for name in ("sign", "marker")
             for _, thing in _named(filled, name) if "found" in thing.material]  # fmt: skip
    plain = [share for share in found if share.mean() < 0.5]
    assert len(plain) > 3
    assert all(share[0].min() == 1.0 and share.min() <= 0.15 for share in plain)


def test_painted_stems_are_white_from_the_ground_and_rings_keep_above_the_paint(filled):
    assert any(scene.target.paint_m > 0 for scene in filled)
    for scene, thing in _named(filled, "ring"):
        if thing.mesh.vertices[:, 2].max() < 2:
            low = thing.mesh.vertices[:, 2].min()
            assert low > 0.9 * scene.target.paint_m


def test_trees_from_elsewhere_need_their_files(skeleton, tmp_path):
    with pytest.raises(StageError, match="--trees"):
        scenes.make_sample(5, 4000, things="elsewhere")
    first = scenes.make_sample(5, 4000, things="elsewhere", skeletons=[skeleton])
    again = scenes.make_sample(5, 4000, things="elsewhere", skeletons=[skeleton])
    assert np.array_equal(first.points, again.points)
    assert set(np.unique(first.labels)) <= {*map(int, Label), NO_WOOD}
