"""Scenes of `snakemake orchard`: options, files, photos' lens and flaws, maps of the truth."""

import json

import make_orchard_scene
import make_skeleton_set
import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree

from cherrypicker.classes import Label
from cherrypicker.errors import StageError
from cherrypicker.pointcloud import read_cloud
from cherrypicker.poses import read_poses
from cherrypicker.skeleton import read_skeleton_csv
from cherrypicker_lab.orchard.grow.templates import BEARING
from cherrypicker_lab.orchard.render.blender import unpack_truth
from cherrypicker_lab.orchard.render.photo import (
    FAR_ID,
    SKY_ID,
    PhotoEffects,
    behind_all,
    develop,
    distorted,
    lens_map,
    lens_margin,
    maps_through,
    write_maps,
)
from cherrypicker_lab.orchard.scene.cameras import CameraModel, Ring, default_rings, ring_poses
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.scene.variety import FORMS, scene_camera, scene_options
from cherrypicker_lab.orchard.seen.sampling import sample_scene
from cherrypicker_lab.orchard.truth import width_of_wood


def test_scene_on_disk_is_read_by_the_pipeline_s_own_readers(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        make_orchard_scene.main(
            tmp_path / name / "as_seen.ply", 5, '{"wind_m": 0.01}',
            n_points=6000, surface_points=4000, n_photos=20,
        )  # fmt: skip
    cloud = read_cloud(tmp_path / "a/as_seen.ply", required=("label", "tree", "colors"))
    assert 2000 < len(cloud) <= 6000
    assert {Label.GROUND, Label.TRUNK, Label.BRANCH} <= set(np.unique(cloud["label"]))
    assert len(read_poses(tmp_path / "a/truth/poses.npz")) == 20
    skeleton = read_skeleton_csv(tmp_path / "a/truth/skeleton.csv")
    traits = json.loads((tmp_path / "a/truth/traits.json").read_text())
    assert skeleton.edge_length.sum() == pytest.approx(traits["total_length_m"], rel=1e-3)
    assert len(read_cloud(tmp_path / "a/truth/cloud.ply", required=("label",))) > 2000
    same = [p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*.[pcjn]*")]
    assert len(same) >= 6
    for file in same:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes(), file


@pytest.mark.parametrize("tree", ["cherry_leader", "cherry_vase"])
def test_the_demo_s_true_crown_width_is_that_of_its_wood(project, tree):
    truth = project / "resources/demo" / tree / "truth"
    wood = read_skeleton_csv(truth / "skeleton.csv")
    stated = json.loads((truth / "traits.json").read_text())["crown_width_m"]
    assert stated == pytest.approx(width_of_wood(wood.points, wood.radius), abs=1e-4)


def test_unknown_forms_are_refused():
    with pytest.raises(StageError, match="oak"):
        scene_options(1, ["oak"])


def test_chosen_options_stand_over_drawn_ones():
    drawn = scene_options(7)
    chosen = scene_options(7, chosen={"net": "none", "wind_m": 0.05, "ground": "mulch"})
    assert chosen == {**drawn, "net": None, "wind": 0.05, "ground": "mulch"}
    left = {"sky": "drawn", "net": "drawn", "wind_m": -1, "neighbours": -1}
    assert scene_options(7, chosen=left) == drawn
    with pytest.raises(StageError, match="snow"):
        scene_options(7, chosen={"snow": 1})


def test_photos_of_another_size_keep_their_field_of_view():
    for seed in range(5):
        large, small = scene_camera(seed), scene_camera(seed, size_px=300)
        assert max(small.width, small.height) == 300
        assert small.focal_px / small.width == pytest.approx(large.focal_px / large.width, rel=5e-3)
        assert (small.k1, small.k2) == (large.k1, large.k2)
    with pytest.raises(StageError, match="photo_size_px"):
        scene_camera(1, size_px=20)


def test_depth_between_pixels_is_that_of_the_plane():
    camera = CameraModel(width=120, height=90, focal_px=90.0, k1=-0.12, k2=0.01)
    wide = camera.widened(lens_margin(camera))
    assert 1.0 < lens_margin(camera) < 1.25
    lens = lens_map(wide, camera)
    assert lens.min() >= 0
    assert (lens <= [wide.width - 1, wide.height - 1]).all()
    x, y = np.meshgrid(np.arange(wide.width) + 0.5, np.arange(wide.height) + 0.5)
    u, v = (x - wide.width / 2) / 90.0, (y - wide.height / 2) / 90.0
    depth = 1.0 / (0.4 + 0.1 * u - 0.05 * v)  # a plane
    mask = np.zeros(depth.shape, np.uint8)
    mask[:, : wide.width // 2] = 1
    normals = np.zeros((*depth.shape, 3))
    found, _, kinds, _ = maps_through(lens, depth.astype(np.float32), normals, mask, mask)
    u, v = (np.moveaxis(lens, -1, 0) + 0.5 - np.array([[[wide.width]], [[wide.height]]]) / 2) / 90.0
    off = np.abs(found - 1.0 / (0.4 + 0.1 * u - 0.05 * v))
    inside = np.abs(lens[..., 0] + 0.5 - wide.width / 2) > 1
    assert off[inside].max() < 1e-4
    assert off.max() < 0.02
    assert set(np.unique(kinds)) == {0, 1}


def test_options_cover_forms_and_sizes():
    drawn = [scene_options(seed) for seed in range(300)]
    assert {o["habit"] for o in drawn} == set(FORMS)
    bearing = [o for o in drawn if o["habit"] in BEARING]
    assert 0.12 < len(bearing) / len(drawn) < 0.28
    assert all(0.08 < 2 * o["trunk_radius"] < 0.21 for o in bearing)
    assert not any(scene_options(seed, ["vase", "fir"])["habit"] in BEARING for seed in range(60))
    assert scene_options(7, ["bearing_vase"])["habit"] == "bearing_vase"
    heights = np.array([o["height"] for o in drawn])
    assert heights.min() < 1.6
    assert heights.max() > 5.0
    radii = np.array([o["trunk_radius"] for o in drawn if o["habit"] != "cherry_whip"])
    assert radii.min() >= 0.02
    assert radii.max() <= 0.15
    assert {o["sky"] for o in drawn} == {"clear", "broken", "overcast", "low"}
    assert json.loads(json.dumps(drawn)) == drawn
    assert scene_options(7) == drawn[7]
    assert {m["pose"] for o in drawn for m in o["markers"]} == {"lying", "standing", "post"}


def test_trees_of_any_size_are_in_frame():
    for seed, height in ((1, 1.2), (2, 5.5)):
        scene = generate_scene(
            seed, habit="cherry_leader", height=height, trunk_radius=0.02 * height, neighbours=0
        )
        camera = CameraModel()
        poses = ring_poses(default_rings(scene, camera, 24), camera, seed=1)
        assert len(poses) == 24
        points = scene.target.skeleton().points
        for i in range(20):
            uv, depth = poses[i].project(points)
            inside = ((uv > 0) & (uv < [camera.width, camera.height])).all(axis=1) & (depth > 0)
            assert inside.mean() > 0.9


def test_lens_is_colmap_s_radial_model():
    pycolmap = pytest.importorskip("pycolmap")
    camera = CameraModel(width=320, height=240, focal_px=300.0, k1=-0.12, k2=0.02)
    wide = camera.widened(1.25)
    at = lens_map(wide, camera)
    colmap = pycolmap.Camera(
        model="RADIAL", width=320, height=240, params=[300.0, 160.0, 120.0, -0.12, 0.02]
    )
    for x, y in ((0, 0), (160, 120), (319, 239), (40, 200)):
        seen = (at[y, x] + 0.5 - [wide.width / 2, wide.height / 2]) / 300.0
        uv = np.ravel(colmap.img_from_cam(np.append(seen, 1.0)[None]))
        np.testing.assert_allclose(uv, [x + 0.5, y + 0.5], atol=0.01)
    assert at.min() > 0
    assert (at < [wide.width - 1, wide.height - 1]).all()
    plain = lens_map(
        CameraModel(width=320, height=240, focal_px=300.0), CameraModel(320, 240, 300.0)
    )
    image = np.random.default_rng(0).random((240, 320)).astype(np.float32)
    np.testing.assert_allclose(distorted(image, plain), image, atol=1e-4)


def test_effects_are_as_large_as_asked():
    light = np.full((60, 80, 3), 0.2)
    rng = np.random.default_rng(0)
    clean = develop(light, rng, PhotoEffects(noise=0.0))
    assert np.ptp(clean) == 0
    noisy = develop(light, rng, PhotoEffects(noise=0.02))
    assert noisy.std() == pytest.approx(0.02 * 255, rel=0.05)
    dark = develop(light, rng, PhotoEffects(noise=0.0, vignette=0.5))
    assert dark[0, 0, 0] < dark[30, 40, 0]
    assert dark[30, 40, 0] == clean[30, 40, 0]
    stops = [develop(light, rng, PhotoEffects(noise=0.0, exposure_stops=0.5))[0, 0, 0]
             for _ in range(20)]  # fmt: skip
    assert np.std(stops) > 5
    edge = np.zeros((60, 80, 3))
    edge[:, 40:] = 1.0
    smeared = develop(edge, np.random.default_rng(1), PhotoEffects(noise=0.0, motion_px=9.0))
    assert ((smeared > 10) & (smeared < 245)).any()
    assert PhotoEffects.random(3) == PhotoEffects.random(3)


def test_rendered_truth_unpacks():
    """Depth 2.5 m, class 5, tree 1, a normal of (0.6, -0.8, 0) x 0.5 in Blender's camera."""
    pixels = np.zeros((2, 2, 4))
    pixels[0, 0] = [2.5, 0.3 + 2 + 4 * 5, -0.4 + 2 + 4 * 1, 1.0]
    pixels[0, 1] = [4.0, 0.0 + 2, 0.0 + 2 + 4 * 16, 1.0]
    depth, normals, label, tree = unpack_truth(pixels)
    np.testing.assert_allclose(depth, [[2.5, 4.0], [0, 0]])
    assert label.tolist() == [[5, 0], [255, 255]]
    assert tree.tolist() == [[1, 255], [255, 255]]
    np.testing.assert_allclose(normals[0, 0], [0.3, 0.4, -np.sqrt(0.75)], atol=1e-6)
    np.testing.assert_allclose(normals[1], 0.0)


def test_maps_survive_the_disk_and_know_the_sky(tmp_path):
    scene = generate_scene(2, sky="clear", neighbours=0)
    poses = ring_poses([Ring(1, 1.0, 2.5, 1.4)], CameraModel(60, 90, 80.0), seed=1)
    label = np.full((90, 60), 255, np.uint8)
    label[60:] = Label.GROUND
    mask = behind_all(label, scene, poses, 0)
    assert (mask[0] == SKY_ID).all()
    assert (mask[60:] == Label.GROUND).all()
    assert (mask == FAR_ID).any()
    depth = np.random.default_rng(0).random((90, 60)).astype(np.float32)
    write_maps(tmp_path, "IMG_0001.jpg", depth, np.zeros((90, 60, 3)), mask, label)
    with np.load(tmp_path / "depth/IMG_0001.npz") as maps:
        np.testing.assert_array_equal(maps["depth"], depth)
    np.testing.assert_array_equal(Image.open(tmp_path / "semantic/IMG_0001.png"), mask)


def test_set_of_skeletons_on_disk(tmp_path):
    make_skeleton_set.main(tmp_path / "index.json", seed=1, n_trees=1)
    index = json.loads((tmp_path / "index.json").read_text())
    assert index["trees"] == ["fir_00"]
    noise = read_cloud(tmp_path / "fir_00/noise.ply", required=("label", "confidence"))
    holes = read_cloud(tmp_path / "fir_00/holes.ply", required=("label",))
    assert len(holes) < len(noise)
    skeleton = read_skeleton_csv(tmp_path / "fir_00/skeleton.csv")
    tree = json.loads((tmp_path / "fir_00/tree.json").read_text())
    assert skeleton.edge_length.sum() == pytest.approx(tree["traits"]["total_length_m"], rel=1e-3)


def test_camera_without_distortion_is_a_pinhole():
    assert scene_camera(3, distortion=False).k1 == 0.0
    assert {scene_camera(seed).width for seed in range(40)} == {800, 1200, 960, 1280}
    assert scene_camera(3) == scene_camera(3)


def test_pruning_and_spurs_keep_one_rooted_tree():
    plain = generate_scene(4, habit="leader", neighbours=0).target
    dressed = generate_scene(4, habit="leader", neighbours=0, stubs=4, spurs=8.0).target
    for axis in dressed.axes[1:]:
        parent = dressed.axes[axis.parent]
        np.testing.assert_array_equal(axis.points[0], parent.points[axis.parent_node])
        assert axis.order == parent.order + 1
        assert axis.radii[0] <= parent.radii[axis.parent_node]
    skeleton = dressed.skeleton()
    assert (skeleton.parent[1:] < np.arange(1, len(skeleton.parent))).all()
    pruned = generate_scene(4, habit="leader", neighbours=0, stubs=4).target
    assert len(pruned.axes) < len(plain.axes)
    assert pruned.skeleton().edge_length.sum() < plain.skeleton().edge_length.sum()
    spurred = generate_scene(4, habit="leader", neighbours=0, spurs=8.0).target
    new = spurred.axes[len(plain.axes) :]
    assert len(new) > 20
    assert all(0.01 < a.arclength[-1] < 0.06 and a.radii.max() < 0.004 for a in new)


def test_paint_wires_and_stakes_stand_where_they_should():
    marker = {"dictionary": "DICT_APRILTAG_36h11", "id": 3, "side_m": 0.2, "pose": "post"}
    scene = generate_scene(
        4, habit="leader", neighbours=0, paint=0.5, wires=2, markers=[marker], sky="low",
        post=False, sign=False, ring=False,
    )  # fmt: skip
    assert np.array(scene.markers[0]["corners"])[:, 2].min() > 0.9
    assert np.degrees(np.arcsin(scene.light.sun_direction[2])) < 20
    names = {thing.name for thing in scene.objects}
    assert {"wire_0", "wire_1", "row_post_0", "row_post_1"} <= names
    cloud = sample_scene(scene, 30_000, exact=True)
    bare = sample_scene(generate_scene(
        4, habit="leader", neighbours=0, wires=2, markers=[marker], sky="low", post=False,
        sign=False, ring=False,
    ), 30_000, exact=True)  # fmt: skip
    trunk = cloud["label"] == Label.TRUNK
    low = trunk & (cloud.points[:, 2] < 0.4)
    gain = cloud.colors.mean(axis=1) - bare.colors.mean(axis=1)
    assert np.median(gain[low]) > 0.1
    np.testing.assert_allclose(gain[trunk & (cloud.points[:, 2] > 0.6)], 0.0, atol=1e-6)
    posts = cloud.points[cloud["label"] == Label.SUPPORT_POST]
    assert cKDTree(posts).query([[0.0, posts[0, 1], 0.0]])[0][0] > 0.05
