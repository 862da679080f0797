"""What makes generated scenes look real: buds, bark relief, nets, wind, kinds of ground."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cherrypicker.classes import Label
from cherrypicker_lab.orchard.render.wind import moved_points, sway
from cherrypicker_lab.orchard.scene.appearance import RELIEF_M, SMOOTH_M, bark_relief
from cherrypicker_lab.orchard.scene.cameras import CameraModel, Ring, ring_poses
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.scene.mesh import NO_TREE
from cherrypicker_lab.orchard.scene.variety import scene_options
from cherrypicker_lab.orchard.seen.sampling import sample_scene

BARE = {"habit": "leader", "neighbours": 0, "sign": False, "ring": False, "cube": False,
        "post": False, "roof": False, "markers": []}  # fmt: skip


@pytest.fixture(scope="module")
def plain():
    return generate_scene(4, **BARE)


def test_looks_leave_the_tree_and_its_truth_as_they_are(plain):
    dressed = generate_scene(
        4, **BARE, buds=30.0, relief=1.0, ground="gravel", net="over", wind=0.03
    )
    one, two = plain.target.skeleton(), dressed.target.skeleton()
    for name in ("points", "radius", "parent", "label"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    np.testing.assert_array_equal(one.fields["order"], two.fields["order"])
    same = sample_scene(generate_scene(4, **BARE), 3000)
    np.testing.assert_array_equal(same.points, sample_scene(plain, 3000).points)


def test_buds_sit_on_young_wood_and_on_every_tip():
    tree = generate_scene(4, **BARE, buds=25.0).target
    buds, skeleton = tree.buds, tree.skeleton()
    distance, node = cKDTree(skeleton.points).query(buds.points)
    assert (distance < 0.01).all()
    tips = np.array([axis.points[-1] for axis in tree.axes if axis.radii[-1] <= 0.0055])
    assert cKDTree(buds.points).query(tips)[0].max() < 0.004
    sides = np.delete(np.arange(len(buds.s)), np.flatnonzero(np.isin(buds.s, [
        axis.arclength[-1] for axis in tree.axes])))  # fmt: skip
    young = sum(np.diff(a.arclength)[a.radii[1:] <= 0.0055].sum() for a in tree.axes)
    assert len(sides) == pytest.approx(25.0 * young, rel=0.25)
    radii = np.array([
        np.interp(s, tree.axes[k].arclength, tree.axes[k].radii)
        for s, k in zip(buds.s[sides], buds.axis[sides])
    ])  # fmt: skip
    assert radii.max() < 0.006


def test_buds_are_in_the_clouds_as_branches(plain):
    budded = generate_scene(4, **BARE, buds=40.0)
    for exact in (True, False):
        cloud = sample_scene(budded, 40_000, exact=exact)
        wood = cloud.select(cloud["tree"] == 0)
        assert set(np.unique(wood["label"])) <= {Label.TRUNK, Label.BRANCH}
    cloud = sample_scene(budded, 40_000, exact=True)
    middle = budded.target.buds.points + 0.004 * budded.target.buds.directions
    near = {
        name: (cKDTree(c.points[c["tree"] == 0]).query(middle)[0] < 0.003).mean()
        for name, c in (("budded", cloud), ("plain", sample_scene(plain, 40_000, exact=True)))
    }
    assert near["budded"] > 2 * near["plain"]


def test_relief_is_as_deep_as_asked_and_only_on_old_wood():
    rng = np.random.default_rng(0)
    rest, radius = rng.uniform(0, 1, (5000, 3)), np.full(5000, 0.05)
    full = bark_relief(rest, radius, {"seed": 3, "relief": 1.0})
    assert np.abs(full).max() <= RELIEF_M
    assert full.std() > 0.0003
    half = bark_relief(rest, radius, {"seed": 3, "relief": 0.5})
    np.testing.assert_allclose(half, 0.5 * full)
    thin = np.full(5000, 0.6 * SMOOTH_M)
    assert not bark_relief(rest, thin, {"seed": 3, "relief": 1.0}).any()
    assert not bark_relief(rest, radius, {"seed": 3}).any()


def test_relief_roughens_the_exact_cloud_s_trunk(plain):
    spread = []
    for scene in (plain, generate_scene(4, **BARE, relief=1.0)):
        cloud = sample_scene(scene, 30_000, exact=True)
        trunk = cloud.points[cloud["label"] == Label.TRUNK]
        stem = scene.target.axes[0]
        distance, node = cKDTree(stem.points).query(trunk)
        spread.append((distance - stem.radii[node]).std())
    assert spread[1] > spread[0] + 0.0002


def test_nets_are_threads_of_class_roof():
    for kind, low in (("over", 1.2), ("along", 0.0)):
        scene = generate_scene(4, **BARE, net=kind)
        net = next(thing for thing in scene.objects if thing.name == "net")
        assert net.label == Label.ROOF
        assert net.mesh.vertices[:, 2].min() > low
        # threads, not a sheet: their area is a small part of what they span
        span = np.ptp(net.mesh.vertices, axis=0)
        assert net.mesh.face_areas().sum() < 0.5 * span[0] * max(span[1], span[2])
        cloud = sample_scene(scene, 20_000, exact=True)
        assert (cloud["label"] == Label.ROOF).any()
        assert (cloud["tree"][cloud["label"] == Label.ROOF] == NO_TREE).all()
    with pytest.raises(ValueError, match="net"):
        generate_scene(4, **BARE, net="under")


def test_no_photographer_stands_in_a_post():
    scene = generate_scene(4, **BARE, wires=2, row_spacing=2.6)
    posts = [t.mesh.vertices for t in scene.objects if t.name.startswith("row_post")]
    rings = [Ring(24, 1.1, 1.35, 1.0)]
    free = ring_poses(rings, CameraModel(), seed=1)
    clear = ring_poses(rings, CameraModel(), seed=1, obstacles=scene.obstacles())
    gaps = [cKDTree(np.concatenate(posts)).query(p.centers)[0].min() for p in (free, clear)]
    assert gaps[0] < 0.3
    assert gaps[1] > 0.35


def test_wind_moves_twigs_and_keeps_the_tree_whole(plain):
    tree = plain.target
    amplitude = 0.02
    moved = [sway(tree, amplitude, 4, photo) for photo in range(12)]
    for axis, way in zip(tree.axes, moved[0]):
        if axis.parent >= 0:
            np.testing.assert_allclose(way[0], moved[0][axis.parent][axis.parent_node])
    low = tree.axes[0].arclength < 0.5
    assert max(np.linalg.norm(way[0][low], axis=1).max() for way in moved) < 0.15 * amplitude
    tips = np.array([[way[-1] for way in photo] for photo in moved])
    assert 0.2 * amplitude < np.sqrt((tips**2).sum(axis=2).mean()) < 2 * amplitude
    assert not np.allclose(tips[0], tips[1])
    np.testing.assert_array_equal(sway(tree, amplitude, 4, 1)[3], moved[1][3])
    k = next(i for i, axis in enumerate(tree.axes) if axis.order >= 2)
    places = moved_points(tree, moved[0], np.array([k, k]), np.array([0.0, 99.0]))
    np.testing.assert_allclose(places, moved[0][k][[0, -1]])


def test_looks_are_drawn_from_the_seed():
    drawn = [scene_options(seed) for seed in range(200)]
    assert {o["net"] for o in drawn} == {None, "over", "along"}
    assert len({o["ground"] for o in drawn}) == 6
    for name in ("buds", "relief", "wind"):
        assert 0.1 < np.mean([o[name] > 0 for o in drawn]) <= 1.0
    assert all(o["buds"] == 0 for o in drawn if o["habit"] in ("fir", "larch", "pine"))
