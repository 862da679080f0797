"""The last round finds pairs that matching missed, and straightens poses that noise moved."""

import numpy as np
import pycolmap
import pytest
from scan_scene import look_at_poses
from sfm_scene import similarity_errors

from cherrypicker.sfm import refine
from cherrypicker.sfm.places import places_shown, shifts_of_places
from cherrypicker.sfm.refine import (
    drop_short_tracks,
    match_by_poses,
    overlapping_pairs,
    refine_model,
)

N_PHOTOS = 12
N_POINTS = 250
FOCAL = 800.0
SIZE = (640, 480)


def pose_of(center):
    return pycolmap.Rigid3d(look_at_poses(center[None], np.zeros(3)).cam_from_world[0])


@pytest.fixture
def orbit(tmp_path):
    """A database of an orbit (0.3 px noise) in which neighbours only are verified; centres."""
    rng = np.random.default_rng(3)
    angles = np.radians(np.arange(N_PHOTOS) * 12.0)
    centers = np.column_stack([4 * np.cos(angles), 4 * np.sin(angles), np.full(N_PHOTOS, 0.5)])
    points = rng.uniform(-1, 1, (N_POINTS, 3))
    looks = np.abs(rng.normal(size=(N_POINTS, 128)))
    looks = np.rint(512 * looks / np.linalg.norm(looks, axis=1, keepdims=True)).astype(np.uint8)
    path = tmp_path / "orbit.db"
    camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", FOCAL, *SIZE)
    camera.has_prior_focal_length = True
    pixels = []
    with pycolmap.Database.open(path) as database:
        camera_id = database.write_camera(camera)
        for i, center in enumerate(centers):
            image_id = database.write_image(pycolmap.Image(name=f"{i:02d}", camera_id=camera_id))
            local = pose_of(center) * points
            pixels.append(camera.img_from_cam(local) + rng.normal(0, 0.3, (N_POINTS, 2)))
            database.write_keypoints(image_id, pixels[-1].astype(np.float32))
            database.write_descriptors(
                image_id,
                pycolmap.FeatureDescriptors(data=looks, type=pycolmap.FeatureExtractorType.SIFT),
            )
        for i in range(N_PHOTOS - 1):
            geometry = pycolmap.TwoViewGeometry()
            geometry.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
            geometry.inlier_matches = np.arange(40, dtype=np.uint32).repeat(2).reshape(-1, 2)
            database.write_two_view_geometry(i + 1, i + 2, geometry)
    return path, centers, points


def moved_model(path, centers, rng, noise):
    """A model of cameras off by ``noise`` with the verified tracks' points."""
    model = pycolmap.Reconstruction()
    with pycolmap.Database.open(path) as database:
        model.add_camera_with_trivial_rig(database.read_all_cameras()[0])
        for image, center in zip(database.read_all_images(), centers):
            pose = pose_of(center + rng.normal(0, noise, 3))
            points = [pycolmap.Point2D(xy) for xy in database.read_keypoints(image.image_id)[:, :2]]
            photo = pycolmap.Image(
                name=image.name, points2D=points, camera_id=1, image_id=image.image_id
            )
            model.add_image_with_trivial_frame(photo, pose)
    return model


@pytest.fixture
def moved(orbit):
    path, centers, points = orbit
    model = moved_model(path, centers, np.random.default_rng(5), 0.003)
    for i in range(40):
        track = pycolmap.Track()
        for image_id in sorted(model.reg_image_ids()):
            track.add_element(image_id, i)
        model.add_point3D(points[i], track, np.zeros(3, np.uint8))
    model.update_point_3d_errors()
    return model, path, centers


def centers_in(model):
    return np.array([model.images[i].projection_center() for i in sorted(model.reg_image_ids())])


def test_pairs_that_see_the_same_from_similar_sides(moved):
    pairs = set(overlapping_pairs(moved[0]))
    assert (1, 2) in pairs and (1, 4) in pairs
    assert (1, 6) not in pairs, "60 degrees apart"


def test_match_by_poses_finds_pairs_that_were_not_verified(moved):
    model, path, _ = moved
    found = match_by_poses(model, path, 2)
    matches = np.concatenate([np.array(each.inlier_matches) for each in found.values()])
    assert len(matches) > 10 * 11 * 40
    assert len(found) > 25
    assert (matches[:, 0] == matches[:, 1]).mean() > 0.98


def test_pair_that_contradicts_the_poses_keeps_its_matches(moved):
    model, path, _ = moved
    image = model.images[1]
    turn = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0.15, 0.0, 0.0])), np.zeros(3))
    image.frame.rig_from_world = turn * image.frame.rig_from_world
    kept = np.array(match_by_poses(model, path, 1)[1, 2].inlier_matches)
    np.testing.assert_array_equal(kept, np.arange(40).repeat(2).reshape(-1, 2))


def test_refined_cameras_are_nearer_the_truth(moved):
    model, path, centers = moved
    start = centers_in(model)
    refined = refine_model(model, path, seed=0, threads=1)
    before = similarity_errors(start, centers)
    after = similarity_errors(centers_in(refined), centers)
    assert np.median(after) < 0.5 * np.median(before)
    assert refined.num_points3D() > 0.8 * N_POINTS
    np.testing.assert_array_equal(centers_in(model), start)


def test_matching_is_repeated_until_the_cameras_stand_still(moved, monkeypatch):
    model, path, _ = moved
    asked = []

    def match(model, *args):
        asked.append(pycolmap.Reconstruction(model))
        return match_by_poses(model, *args)

    monkeypatch.setattr(refine, "match_by_poses", match)
    refined = refine_model(model, path, seed=0, threads=1)
    n_of_a_moved_one = len(asked)
    again = refine_model(refined, path, seed=0, threads=1)
    assert n_of_a_moved_one > len(asked) - n_of_a_moved_one == 1
    shift = shifts_of_places(again, refined, places_shown(refined))
    assert np.median(shift) < refined.compute_mean_reprojection_error()


def test_two_view_points_go_unless_a_photo_has_no_others(moved):
    model = pycolmap.Reconstruction(moved[0])
    for image_ids, i in (((1, 2), 50), ((2, 3), 51)):
        track = pycolmap.Track()
        for image_id in image_ids:
            track.add_element(image_id, i)
        model.add_point3D(np.zeros(3), track, np.zeros(3, np.uint8))
    drop_short_tracks(model)
    assert model.num_points3D() == 40
    for point_id in list(model.points3D):
        model.delete_point3D(point_id)
    track = pycolmap.Track()
    track.add_element(1, 60)
    track.add_element(2, 60)
    model.add_point3D(np.zeros(3), track, np.zeros(3, np.uint8))
    drop_short_tracks(model)
    assert model.num_points3D() == 1
