"""The synthetic orchard: trees, labels, scenes, sampled clouds, cameras and their truth."""

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from cherrypicker.classes import Label
from cherrypicker.pointcloud import read_cloud
from cherrypicker.poses import read_poses
from cherrypicker_lab.orchard.grow.growth import Axis, grow_tree, trunk_end_node
from cherrypicker_lab.orchard.scene.backdrop import backdrop
from cherrypicker_lab.orchard.scene.boards import marker_image
from cherrypicker_lab.orchard.scene.cameras import CameraModel, Ring, look_at, ring_poses
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.scene.mesh import NO_TREE, tree_mesh
from cherrypicker_lab.orchard.scene.noise import fbm, spots
from cherrypicker_lab.orchard.seen.sampling import sample_scene
from cherrypicker_lab.orchard.truth import tree_traits, write_truth

HABITS = ("leader", "spindle", "vase")


def straight_axis(length, radii, order=0):
    s = np.linspace(0, length, 101)
    points = np.column_stack([0 * s, 0 * s, s])
    return Axis(points, np.interp(s, *zip(*radii)), order)


@pytest.mark.parametrize("habit", HABITS)
def test_skeleton_is_one_rooted_tree(habit):
    skeleton = grow_tree(5, habit).skeleton()
    assert (skeleton.parent == -1).sum() == 1
    assert skeleton.parent[0] == -1
    assert (skeleton.parent[1:] < np.arange(1, len(skeleton.parent))).all()
    assert np.isfinite(skeleton.points).all()
    assert (skeleton.radius > 0.0018).all()
    np.testing.assert_allclose(skeleton.points[0], 0.0)
    # nodes are a centimetre apart, so no edge may jump
    assert skeleton.edge_length.max() < 0.02
    assert skeleton.fields["order"].max() >= 2


@pytest.mark.parametrize("habit", HABITS)
@pytest.mark.parametrize("seed", [1, 8])
def test_children_are_thinner_than_their_parent(habit, seed):
    tree = grow_tree(seed, habit)
    for axis in tree.axes[1:]:
        parent = tree.axes[axis.parent]
        np.testing.assert_allclose(axis.points[0], parent.points[axis.parent_node])
        assert axis.radii[0] <= parent.radii[axis.parent_node] + 1e-12
        assert axis.order == parent.order + 1


def test_a_leader_is_trunk_to_its_tip_and_a_vase_to_its_fork():
    leader, vase = grow_tree(3, "leader"), grow_tree(3, "vase")
    assert leader.axes[0].points[-1, 2] > 0.85 * leader.skeleton().points[:, 2].max()
    assert vase.axes[0].points[-1, 2] < 1.0
    assert {a.order for a in vase.axes if a.parent == 0} == {1}
    labels = vase.skeleton().label
    orders = vase.skeleton().fields["order"]
    np.testing.assert_array_equal(labels == Label.TRUNK, orders == 0)


def test_trunk_rule_by_hand():
    # 30 mm below and 26 mm above the fork: 0.87 of it, the trunk goes on
    stem = straight_axis(1.0, [(0, 0.030), (0.5, 0.030), (0.51, 0.026), (1, 0.026)])
    twig = straight_axis(0.3, [(0, 0.008), (0.3, 0.003)], 1)
    assert trunk_end_node(stem, [50], [twig]) == 100
    # 30 mm and 20 mm: 0.67, it ends at the fork
    stem = straight_axis(1.0, [(0, 0.030), (0.5, 0.030), (0.51, 0.020), (1, 0.020)])
    assert trunk_end_node(stem, [50], [twig]) == 50
    # ... unless another axis carries the thickness on
    thick = straight_axis(0.3, [(0, 0.028), (0.3, 0.027)], 1)
    assert trunk_end_node(stem, [50], [thick]) == 100


@pytest.mark.parametrize("habit", HABITS)
def test_grown_trunks_obey_the_rule(habit):
    for seed in range(4):
        tree = grow_tree(seed, habit)
        children = [a for a in tree.axes if a.parent == 0]
        end = trunk_end_node(tree.axes[0], [a.parent_node for a in children], children)
        assert end == len(tree.axes[0].points) - 1


def test_mesh_surface_lies_at_the_radius():
    tree = grow_tree(2, "leader")
    mesh = tree_mesh(tree)
    on_stem = (mesh.attributes["axis"] == 0) & (mesh.attributes["s"] < tree.axes[0].arclength[-1])
    stem = tree.axes[0]
    distance = cKDTree(stem.points).query(mesh.vertices[on_stem])[0]
    np.testing.assert_allclose(distance, mesh.attributes["radius"][on_stem], atol=0.003)
    assert mesh.faces.max() < len(mesh.vertices)


def test_exact_cloud_lies_on_the_wood():
    scene = generate_scene(4, habit="vase", neighbours=1, row_spacing=2.4, ring=False)
    cloud = sample_scene(scene, 20_000, exact=True)
    wood = cloud.select(cloud["tree"] == 0)
    skeleton = scene.target.skeleton()
    distance, node = cKDTree(skeleton.points).query(wood.points)
    gap = distance - skeleton.radius[node]
    # facets and the centimetre between nodes leave a few millimetres; at a junction the nearest
    # node may be the child's, which starts inside the parent
    assert np.median(np.abs(gap)) < 0.001
    assert np.quantile(gap, 0.01) > -0.003
    assert np.quantile(gap, 0.95) < 0.006
    assert set(np.unique(wood["label"])) == {Label.TRUNK, Label.BRANCH}
    ground = cloud["label"] == Label.GROUND
    level = scene.ground_height(cloud.points[ground][:, :2])
    np.testing.assert_allclose(cloud.points[ground][:, 2], level, atol=1e-9)
    assert (cloud["tree"] == 1).any()
    assert (cloud["tree"][ground] == NO_TREE).all()


def test_all_classes_can_appear():
    scene = generate_scene(6, sign=True, ring=True, cube=True, post=True, roof=True)
    cloud = sample_scene(scene, 30_000, exact=True)
    assert set(np.unique(cloud["label"])) == set(range(8))
    assert cloud.colors.min() >= 0.0
    assert cloud.colors.max() <= 1.0


def test_noise_is_in_range_and_does_not_repeat():
    rng = np.random.default_rng(0)
    points = rng.uniform(-100, 100, (20_000, 3))
    values = fbm(points, octaves=4)
    assert values.min() >= 0.0
    assert values.max() <= 1.0
    assert values.mean() == pytest.approx(0.5, abs=0.02)
    shifted = fbm(points + [256.0, 0.0, 0.0], octaves=1)
    assert np.corrcoef(fbm(points, octaves=1), shifted)[0, 1] < 0.1
    strength, tint = spots(points, density=0.5)
    assert (tint[strength == 0] == 0).all()
    assert 0.05 < (strength > 0).mean() < 0.95


@pytest.mark.parametrize("dictionary", ["DICT_4X4_50", "DICT_APRILTAG_36h11"])
def test_marker_image_is_detected_with_its_id(dictionary):
    image, n_modules = marker_image(dictionary, 9)
    assert image.shape[0] == 2 * n_modules + 6
    picture = np.kron(image[..., 0], np.ones((10, 10)))
    picture = np.round(255 * picture / picture.max()).astype(np.uint8)
    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    _, ids, _ = cv2.aruco.ArucoDetector(book).detectMarkers(picture)
    assert ids.ravel().tolist() == [9]


@pytest.mark.parametrize(("dictionary", "marker"), [("DICT_4X4_50", 50), ("DICT_9X9", 1)])
def test_impossible_markers_are_refused(dictionary, marker):
    with pytest.raises(ValueError, match="DICT"):
        marker_image(dictionary, marker)


@pytest.mark.parametrize("pose", ["lying", "standing"])
def test_marker_corners_have_the_side_and_face_the_viewer(pose):
    spec = {"dictionary": "DICT_5X5_100", "id": 3, "side_m": 0.2, "pose": pose, "xy": (0.5, 0.2)}
    scene = generate_scene(9, markers=[spec])
    corners = np.array(scene.markers[0]["corners"])
    sides = np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)
    np.testing.assert_allclose(sides, 0.2)
    # clockwise seen from the front: the normal of the front points at the viewer
    normal = np.cross(corners[1] - corners[0], corners[0] - corners[3])
    if pose == "lying":
        assert normal[2] > 0
    assert corners[:, 2].min() > scene.ground_height(np.array([[0.5, 0.2]]))[0]


def test_look_at_follows_the_camera_convention():
    center = np.array([0.0, -3.0, 1.0])
    pose = look_at(center, [0.0, 0.0, 1.0])
    np.testing.assert_allclose(pose[:, :3] @ center + pose[:, 3], 0.0, atol=1e-12)
    np.testing.assert_allclose(pose[:, :3] @ [1, 0, 0], [1, 0, 0], atol=1e-12)  # x right
    np.testing.assert_allclose(pose[:, :3] @ [0, 0, 1], [0, -1, 0], atol=1e-12)  # y down
    np.testing.assert_allclose(pose[:, :3] @ [0, 1, 0], [0, 0, 1], atol=1e-12)  # z forward


def test_cameras_step_out_of_a_neighbour():
    crown = np.array([[2.4, 0.0, 1.1], [2.5, 0.1, 1.2]])
    ring = [Ring(12, 1.1, 2.4, 1.0)]
    free = ring_poses(ring, CameraModel(), seed=1)
    poses = ring_poses(ring, CameraModel(), seed=1, obstacles=crown)
    gap = np.linalg.norm(poses.centers[:, None] - crown, axis=2).min(1)
    assert gap.min() > 0.39
    moved = np.linalg.norm(poses.centers - free.centers, axis=1) > 1e-9
    assert 1 <= moved.sum() <= 2


def test_backdrop_has_sky_above_and_land_below():
    azimuth = np.linspace(-np.pi, np.pi, 500)
    for sky in ("clear", "broken", "overcast"):
        for elevation, wanted in ((60.0, True), (-2.0, False)):
            e = np.radians(elevation)
            rays = np.column_stack(
                [np.cos(e) * np.cos(azimuth), np.cos(e) * np.sin(azimuth), 0 * azimuth + np.sin(e)]
            )
            radiance, is_sky = backdrop(rays, sky, 3)
            assert (is_sky == wanted).all()
            assert radiance.min() >= 0.0
            assert radiance.max() <= 1.3


def test_truth_is_written_and_agrees_with_itself(tmp_path):
    scene = generate_scene(15, habit="leader", height=2.2, ring=True, neighbours=1)
    poses = ring_poses([Ring(6, 1.1, 2.4, 1.0)], CameraModel(), seed=1)
    write_truth(tmp_path, scene, poses, n_points=8000)
    cloud = read_cloud(tmp_path / "cloud.ply", required=("label", "tree"))
    assert cloud.unit == "m"
    assert 6000 < len(cloud) <= 8000
    np.testing.assert_allclose(
        read_poses(tmp_path / "poses.npz").cam_from_world, poses.cam_from_world
    )
    table = np.genfromtxt(tmp_path / "skeleton.csv", delimiter=",", names=True)
    traits = tree_traits(scene.target)
    assert table["parent"][0] == -1
    assert len(table) == len(scene.target.skeleton().points)
    assert traits["total_length_m"] == pytest.approx(
        scene.target.skeleton().edge_length.sum(), rel=1e-6
    )
    assert sum(traits["length_by_order_m"].values()) == pytest.approx(traits["total_length_m"])
    assert traits["height_m"] == pytest.approx(2.2, rel=0.05)


@pytest.mark.parametrize("height", [0.6, 1.0, 1.4])
def test_small_vases_fork_below_their_height(height):
    for seed in range(3):
        tree = grow_tree(seed, "vase", height=height, trunk_radius=0.02)
        skeleton = tree.skeleton()
        assert np.isfinite(skeleton.points).all()
        assert tree.axes[0].points[-1, 2] < 0.55 * height
        assert skeleton.points[:, 2].max() > 0.7 * height


def test_scenes_take_the_weber_penn_forms():
    scene = generate_scene(3, habit="cherry_whip", neighbours=1)
    assert {tree.habit for tree in scene.trees} == {"cherry_whip"}
    with pytest.raises(ValueError, match="habit"):
        generate_scene(3, habit="oak")
