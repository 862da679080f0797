"""Models that share photos become one, and one that shares none does not."""

import numpy as np
import pycolmap
import pytest

from cherrypicker.sfm.export import registered_photos
from cherrypicker.sfm.joining import join_models

N_PHOTOS = 12


@pytest.fixture(scope="module", params=[1, 2, N_PHOTOS])
def truth(request):
    """A synthetic model of photos of so many cameras."""
    pycolmap.set_random_seed(1)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig = request.param, 1
    options.num_frames_per_rig = N_PHOTOS // request.param
    options.num_points3D = 150
    return pycolmap.synthesize_dataset(options)


def part_of(truth, numbers, moved=None):
    """The model of some of the photos, in a frame of its own."""
    part = pycolmap.Reconstruction(truth)
    for number, image in enumerate(registered_photos(truth)):
        if number not in numbers:
            part.deregister_frame(image.frame_id)
    part.tear_down()
    if moved is not None:
        part.transform(moved)
    return part


def moved_by(scale, turn, shift):
    return pycolmap.Sim3d(scale, pycolmap.Rotation3d(np.array(turn)), np.array(shift))


def test_photos_come_in_by_those_that_models_share(truth):
    first = part_of(truth, range(6))
    far = part_of(truth, range(6, 12), moved_by(2.0, [0.5, 0, 0], [1.0, 0, 0]))
    bridge = part_of(truth, range(3, 9), moved_by(0.3, [0, -0.4, 1.0], [0, 2.0, 5.0]))
    whole, others = join_models([first, far, bridge])
    assert not others and whole is first
    assert whole.num_reg_images() == N_PHOTOS and whole.is_valid()
    for found, true in zip(registered_photos(whole), registered_photos(truth), strict=True):
        assert found.image_id == true.image_id and found.frame_id == true.frame_id
        np.testing.assert_allclose(found.projection_center(), true.projection_center(), atol=1e-4)
    assert whole.compute_mean_reprojection_error() < 0.01
    assert all(image.num_points3D > 20 for image in registered_photos(whole))


def test_models_without_a_photo_in_common_stay_apart(truth):
    first, other = part_of(truth, range(6)), part_of(truth, range(6, 12))
    whole, others = join_models([first, other])
    assert whole.num_reg_images() == 6 and others == [other]


def test_one_model_is_what_it_was(truth):
    whole, others = join_models([part_of(truth, range(6))])
    assert whole.num_reg_images() == 6 and not others


def test_a_model_that_brings_no_photo_brings_no_points(truth):
    first, part = part_of(truth, range(6)), part_of(truth, range(2, 6))
    n_points = first.num_points3D()
    whole, others = join_models([first, part])
    assert not others and whole.num_points3D() == n_points
