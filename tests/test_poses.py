import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cherrypicker.errors import StageError
from cherrypicker.files import write_npz
from cherrypicker.poses import Poses, read_poses, write_poses


@pytest.fixture
def poses():
    rotations = Rotation.random(4, random_state=1).as_matrix()
    offsets = np.random.default_rng(1).normal(size=(4, 3, 1))
    K = np.tile([[800.0, 0, 320], [0, 800, 240], [0, 0, 1]], (4, 1, 1))
    names = [f"photo_{i}.jpg" for i in range(4)]
    return Poses(names, np.concatenate([rotations, offsets], 2), K, [640] * 4, [480] * 4)


def test_round_trip(poses, tmp_path):
    write_poses(tmp_path / "p.npz", poses)
    back = read_poses(tmp_path / "p.npz")
    assert list(back.names) == list(poses.names)
    np.testing.assert_array_equal(back.cam_from_world, poses.cam_from_world)


def test_errors_go_along_and_are_zero_where_nobody_measured(poses, tmp_path):
    assert not poses.error_px.any()
    write_npz(
        tmp_path / "old.npz",
        **{
            name: getattr(poses, name)
            for name in ("names", "cam_from_world", "K", "width", "height")
        },
    )
    assert not read_poses(tmp_path / "old.npz").error_px.any()
    poses.error_px = np.arange(len(poses)) / 4
    write_poses(tmp_path / "p.npz", poses)
    moved = read_poses(tmp_path / "p.npz").transformed(2.0).select(np.array([2, 1]))
    np.testing.assert_array_equal(moved.error_px, [0.5, 0.25])


def test_a_point_on_the_optical_axis_hits_the_principal_point(poses):
    point = poses.centers[2] + 3.0 * poses.forward[2]
    uv, depth = poses[2].project(point[None])
    np.testing.assert_allclose(uv, [[320, 240]], atol=1e-9)
    np.testing.assert_allclose(depth, [3.0])


def test_projection_is_kept_by_a_similarity(poses):
    rotation = Rotation.from_euler("xyz", [0.3, -1.0, 2.0]).as_matrix()
    points = np.random.default_rng(2).normal(size=(20, 3))
    moved = poses.transformed(2.5, rotation, [1, 2, 3])
    uv, depth = poses[1].project(points)
    uv_moved, depth_moved = moved[1].project(2.5 * points @ rotation.T + [1, 2, 3])
    np.testing.assert_allclose(uv_moved, uv, rtol=1e-6)
    np.testing.assert_allclose(depth_moved, 2.5 * depth, rtol=1e-9)


def test_in_a_photo_of_another_size_a_point_lies_at_the_same_share_of_it(poses):
    points = poses.centers[2] + poses.forward[2] + np.random.default_rng(0).normal(size=(5, 3)) / 9
    other = poses.resized(2 * poses.width, 3 * poses.height)
    assert (other[2].width, other[2].height) == (1280, 1440)
    np.testing.assert_allclose(other[2].project(points)[0], poses[2].project(points)[0] * [2, 3])


def test_the_top_of_the_image_is_up(poses):
    above = poses.centers[0] + 5 * poses.forward[0] + 0.5 * poses.up[0]
    uv, _ = poses[0].project(above[None])
    assert uv[0, 1] < 240


def test_a_missing_array_is_named(poses, tmp_path):
    write_npz(tmp_path / "p.npz", names=poses.names, K=poses.K)
    with pytest.raises(StageError, match="cam_from_world"):
        read_poses(tmp_path / "p.npz")
