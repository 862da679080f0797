"""A sparse model with the true cameras of a rendered scene."""

import numpy as np
import pycolmap
import pytest
from stereo_scene import Surface, write_scene

from cherrypicker.errors import StageError
from cherrypicker.photos import list_photos
from cherrypicker.poses import Poses, write_poses
from cherrypicker.sfm.features import FeatureOptions, extract_features
from cherrypicker.sfm.matching import MatchingOptions, match_features
from cherrypicker_lab.dense.true_cameras import triangulate_true_cameras


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """An upright cylinder before a plane, five photos; their true poses beside them."""
    folder = tmp_path_factory.mktemp("scene")
    surfaces = [Surface(seed=1), Surface(radius=0.3, center=(0.2, 0.0, 3.4), seed=2)]
    K, poses, _ = write_scene(folder, surfaces, n_views=5, width=480, height=360)
    names = [path.name for path in list_photos(folder / "images")]
    motions = np.array([np.c_[R, t] for R, t in poses])
    true = Poses(names, motions, np.repeat([K], 5, axis=0), [480] * 5, [360] * 5)
    write_poses(folder / "poses.npz", true)
    return folder, true


@pytest.fixture(scope="module")
def matched(scene, tmp_path_factory):
    folder, _ = scene
    out = tmp_path_factory.mktemp("matched")
    photos = list_photos(folder / "images")
    extract_features(photos, out / "features.db", out / "photos.json", FeatureOptions())
    match_features(out / "features.db", out / "database.db", MatchingOptions())
    return out / "database.db"


def test_true_cameras_stay_and_points_come_from_the_photos(scene, matched, tmp_path):
    folder, true = scene
    report = triangulate_true_cameras(
        matched, folder / "images", folder / "poses.npz", tmp_path / "model"
    )
    model = pycolmap.Reconstruction(tmp_path / "model")
    assert report["n_photos"] == len(model.images) == 5
    assert model.num_points3D() > 50
    for image in model.images.values():
        pose = true.cam_from_world[list(true.names).index(image.name)]
        np.testing.assert_allclose(image.cam_from_world().matrix(), pose, atol=1e-12)
        np.testing.assert_allclose(image.camera.calibration_matrix(), true.K[0])
    points = np.array([point.xyz for point in model.points3D.values()])
    off_plane = np.abs(points[:, 2] - 4.0)
    off_cylinder = np.abs(np.hypot(points[:, 0] - 0.2, points[:, 2] - 3.4) - 0.3)
    assert np.median(np.minimum(off_plane, off_cylinder)) < 0.02
    # triangulated, not copied from the surface
    assert np.minimum(off_plane, off_cylinder).max() > 1e-6


def test_photos_without_a_true_pose_are_named(scene, matched, tmp_path):
    folder, true = scene
    write_poses(tmp_path / "poses.npz", true.select(np.arange(4)))
    with pytest.raises(StageError, match=str(true.names[4])):
        triangulate_true_cameras(
            matched, folder / "images", tmp_path / "poses.npz", tmp_path / "model"
        )
