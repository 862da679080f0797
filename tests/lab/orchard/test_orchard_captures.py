"""Captures as people walk them: where the photos are taken from, and what stands around."""

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from cherrypicker.classes import Label
from cherrypicker.errors import StageError
from cherrypicker_lab.orchard.render.blender import truth_attribute
from cherrypicker_lab.orchard.render.photo import BACKGROUND_ID, FAR_ID, SKY_ID, behind_all
from cherrypicker_lab.orchard.scene.cameras import CameraModel, default_rings, ring_poses
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.scene.presets import WALK_PRESETS
from cherrypicker_lab.orchard.scene.surroundings import BACKGROUNDS, HILL_FROM_M, hill_height
from cherrypicker_lab.orchard.scene.variety import scene_options, scene_walk
from cherrypicker_lab.orchard.scene.walks import WALKS, preset_poses, tree_size, walk_poses
from cherrypicker_lab.orchard.seen.sampling import sample_scene

WIDE = CameraModel(1000, 667, 800.0)
TALL = CameraModel(667, 1000, 830.0)
NEAREST_BACKGROUND_M = 2.0  # twigs of the next rows


@pytest.fixture(scope="module")
def scene():
    return generate_scene(
        11, habit="cherry_leader", height=3.0, trunk_radius=0.05, neighbours=2, row_spacing=4.0
    )


def pixels_of(points, poses):
    """Pixels (n_photos, n, 2) of points, and which of them lie in the frame."""
    rotation, offset = poses.cam_from_world[:, :, :3], poses.cam_from_world[:, :, 3]
    x = np.einsum("nij,mj->nmi", rotation, points) + offset[:, None]
    pixels = x[..., :2] / x[..., 2:] * poses.K[:, None, [0, 1], [0, 1]] + poses.K[:, None, :2, 2]
    size = np.column_stack([poses.width, poses.height])[:, None]
    return pixels, (x[..., 2] > 0) & (pixels > 0).all(-1) & (pixels < size).all(-1)


def n_pieces(poses):
    """Pieces that photos fall into when those taken near one another are joined."""
    centers, forward = poses.centers, poses.cam_from_world[:, 2, :3]
    azimuth = np.arctan2(centers[:, 1], centers[:, 0])
    between = np.angle(np.exp(1j * (azimuth[:, None] - azimuth)))
    is_near = (cdist(centers, centers) < 0.6) | (np.abs(between) < np.radians(15.5))
    return connected_components(is_near & (forward @ forward.T > np.cos(np.radians(35))))[0]


@pytest.mark.parametrize("camera", [WIDE, TALL], ids=["wide", "tall"])
@pytest.mark.parametrize("walk", WALKS[1:])
def test_walks_can_be_registered_and_frame_all_of_the_tree(scene, walk, camera):
    poses = walk_poses(scene, camera, walk, 52)
    assert len(poses) == 52
    assert str(poses.names[51]) == "IMG_0052.jpg"
    assert n_pieces(poses) == 1
    _, is_framed = pixels_of(scene.target.skeleton().points, poses)
    assert is_framed.sum(axis=0).min() >= 5
    # most photos crop the crown
    assert (is_framed.mean(axis=1) > 0.99).mean() < 0.5
    height = poses.centers[:, 2] - scene.ground_height(poses.centers[:, :2])
    assert height.min() > 0.4 and height.max() < 2.7
    wood = np.concatenate([scene.target.skeleton().points, scene.obstacles()])
    assert cKDTree(wood).query(poses.centers)[0].min() > 0.3


def test_rings_are_the_default_and_those_of_before(scene):
    rings = ring_poses(
        default_rings(scene, WIDE, 24), WIDE, seed=scene.seed, ground=scene.ground_height,
        obstacles=scene.obstacles(),
    )  # fmt: skip
    np.testing.assert_array_equal(walk_poses(scene, WIDE, n_photos=24).cam_from_world,
                                  rings.cam_from_world)  # fmt: skip
    with pytest.raises(ValueError, match="walk must be one of"):
        walk_poses(scene, WIDE, "hop")


def test_no_low_ring_frames_the_whole_tree(scene):
    poses = walk_poses(scene, WIDE, "low_rings", 52)
    nodes = scene.target.skeleton().points
    _, is_framed = pixels_of(nodes, poses)
    assert is_framed.mean(axis=1).max() < 0.97
    low, high = is_framed[:26].any(axis=0), is_framed[26:].any(axis=0)
    assert not low[nodes[:, 2] > 0.9 * nodes[:, 2].max()].any()
    assert not high[nodes[:, 2] < 0.05].any()
    assert poses.centers[:26, 2].max() < poses.centers[26:, 2].min()


def test_alleys_run_on_both_sides_and_between_the_trees(scene):
    x, y, _ = walk_poses(scene, WIDE, "alleys", 56).centers.T
    gap = tree_size(scene).gap
    assert min((y > 1.5).sum(), (y < -1.5).sum()) >= 12
    beside = np.abs(y) < 0.8
    assert min((beside & (x > 0)).sum(), (beside & (x < 0)).sum()) >= 3
    assert np.abs(np.abs(x[beside]) - gap).max() < 0.7
    assert np.ptp(x[y > 1.5]) > 2.5 * gap


def test_spiral_turns_twice_rises_and_comes_nearer(scene):
    centers = walk_poses(scene, TALL, "spiral", 54).centers
    turned = np.ptp(np.unwrap(np.arctan2(centers[:, 1], centers[:, 0])))
    assert turned == pytest.approx(4 * np.pi, rel=0.05)
    assert centers[-9:, 2].mean() > centers[:9, 2].mean() + 0.8
    away = np.linalg.norm(centers[:, :2], axis=1)
    assert away[-9:].mean() < away[:9].mean() - 0.2


def test_half_ring_stays_on_one_side_at_two_heights(scene):
    poses = walk_poses(scene, WIDE, "half_ring", 44)
    x, y, z = poses.centers.T
    side = np.sign(np.median(y))
    assert (side * y > -0.8).all()
    assert np.ptp(x) > 3.0
    assert z[22:].min() > z[:22].max()


@pytest.mark.parametrize("background", BACKGROUNDS)
def test_backgrounds_are_geometry_around_the_scan(background):
    scene = generate_scene(5, neighbours=2, row_spacing=3.6, background=background)
    again = generate_scene(5, neighbours=2, row_spacing=3.6, background=background)
    assert scene.surroundings
    assert len({thing.name for thing in scene.surroundings}) == len(scene.surroundings)
    points = np.concatenate([thing.mesh.vertices for thing in scene.surroundings])
    for thing, other in zip(scene.surroundings, again.surroundings):
        assert thing.label == Label.UNLABELLED
        np.testing.assert_array_equal(thing.mesh.vertices, other.mesh.vertices)
        assert np.isfinite(thing.mesh.vertices).all()
        assert thing.mesh.face_areas().sum() > 0.2
        assert thing.mesh.faces.max() < len(thing.mesh.vertices)
    away = np.linalg.norm(points[:, :2], axis=1)
    assert away.min() > NEAREST_BACKGROUND_M
    assert (away < 12).any()
    # it stands on the ground, at most with its foundations below
    assert (points[:, 2] - scene.ground_height(points[:, :2])).min() > -1.2
    # on either side of the row, or it would be the background of few photos
    assert (points[:, 1] > 3).any() and (points[:, 1] < -3).any()


def test_hills_rise_high_above_the_cameras_all_around_and_not_near_the_tree():
    scene = generate_scene(5, background="hills")
    azimuth = np.linspace(-np.pi, np.pi, 180)
    ring = np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    assert (hill_height(0.99 * HILL_FROM_M * ring, scene.ground_seed) == 0).all()
    ground = np.stack([scene.ground_height(r * ring) for r in np.arange(9.0, 40.0)])
    horizon = np.degrees(np.arctan2(ground - 1.5, np.arange(9.0, 40.0)[:, None])).max(axis=0)
    assert horizon.min() > 5
    assert np.median(horizon) > 10
    plain = generate_scene(5)
    near = 7.5 * np.random.default_rng(0).uniform(-0.7, 0.7, (99, 2))
    np.testing.assert_array_equal(scene.ground_height(near), plain.ground_height(near))


@pytest.mark.parametrize("kind", ["hedges", "buildings"])
def test_hedges_and_buildings_stand_where_they_cover_the_crown(kind):
    scene = generate_scene(6, background=kind)
    points = np.concatenate([t.mesh.vertices for t in scene.surroundings])
    away = np.linalg.norm(points[:, :2], axis=1)
    near = points[(away > 4.0) & (away < 12.0)]
    azimuth = np.degrees(np.arctan2(near[:, 1], near[:, 0]))
    high = near[:, 2] > 1.2
    # in a third of all directions something taller than a camera stands within 12 m
    assert len(np.unique(azimuth[high] // 10)) >= (12 if kind == "hedges" else 8)


def test_clouds_and_tree_do_not_know_of_the_background():
    plain, hedged = generate_scene(8), generate_scene(8, background="hedges")
    one, other = (sample_scene(s, 5000, exact=True, is_colored=False) for s in (plain, hedged))
    np.testing.assert_array_equal(one.points, other.points)
    assert "background" not in plain.options
    assert hedged.options["background"] == "hedges"
    with pytest.raises(ValueError, match="background must be one of"):
        generate_scene(8, background="sea")


def test_masks_tell_the_background_from_sky_and_from_what_lies_at_infinity(scene):
    labels = truth_attribute(np.array([int(Label.UNLABELLED), int(Label.BRANCH)]), 255)[:, 0]
    np.testing.assert_array_equal(labels, [BACKGROUND_ID, Label.BRANCH])
    poses = walk_poses(scene, CameraModel(60, 40, 48.0), "spiral", 6)
    label = np.full((40, 60), 255, np.uint8)
    label[:20] = BACKGROUND_ID
    mask = behind_all(label, scene, poses, 0)
    assert (mask[:20] == BACKGROUND_ID).all()
    assert set(np.unique(mask[20:])) <= {SKY_ID, FAR_ID}


def test_walks_and_backgrounds_are_drawn_only_where_asked_for():
    for seed in range(5):
        assert scene_options(seed, chosen={"walk": "spiral"}) == scene_options(seed)
        assert "background" not in scene_options(seed, chosen={"background": "none"})
        assert scene_walk(seed) == scene_walk(seed, {"net": "none"}) == "rings"
    hills = scene_options(3, chosen={"background": "hills"})
    assert hills == {**scene_options(3), "background": "hills"}
    assert scene_walk(3, {"walk": "alleys"}) == "alleys"
    assert {scene_walk(seed, {"walk": "drawn"}) for seed in range(60)} == set(WALKS)
    drawn = {scene_options(s, chosen={"background": "drawn"}).get("background") for s in range(60)}
    assert drawn == {None, *BACKGROUNDS}
    with pytest.raises(StageError, match="walk, background"):
        scene_options(3, chosen={"weather": "snow"})


@pytest.mark.parametrize("name", sorted(WALK_PRESETS))
def test_presets_of_walks_can_be_registered_and_scaled(name):
    preset = WALK_PRESETS[name]
    assert name == f"walk_{preset['walk']}_{preset['scene']['background']}"
    scene = generate_scene(**preset["scene"])
    poses = preset_poses(preset, scene)
    assert 40 <= len(poses) <= 66
    assert n_pieces(poses) == 1
    nodes = scene.target.skeleton()
    assert 2.5 < nodes.points[:, 2].max() < 3.8
    assert nodes.radius.min() <= 0.0021
    _, is_framed = pixels_of(nodes.points, poses)
    assert is_framed.sum(axis=0).min() >= 5
    assert (is_framed.mean(axis=1) > 0.99).mean() < 0.25
    _, is_seen = pixels_of(np.array(scene.markers[0]["corners"]), poses)
    assert is_seen.all(axis=1).sum() >= 6


def test_the_shipped_list_names_the_presets_and_their_markers(project):
    table = (project / "config/examples/walks.tsv").read_text()
    rows = [line.split("\t") for line in table.splitlines()[1:]]
    assert [row[0] for row in rows] == list(WALK_PRESETS)
    for name, photos, dictionary, sides, _ in rows:
        marker = WALK_PRESETS[name]["scene"]["markers"][0]
        assert photos == f"scenes/{name}/photos"
        assert dictionary == marker["dictionary"]
        assert sides == f"{marker['id']}:{marker['side_m']}"
