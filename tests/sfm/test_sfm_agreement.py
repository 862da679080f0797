"""A bent model is found out by the verified pairs."""

import numpy as np
import pycolmap
import pytest

from cherrypicker.sfm.agreement import measure_agreement, read_verified_pairs


@pytest.fixture(scope="module")
def ring(tmp_path_factory):
    """A synthetic model and the database of its matches."""
    path = tmp_path_factory.mktemp("ring") / "database.db"
    pycolmap.set_random_seed(1)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 1, 10
    options.num_points3D = 150
    with pycolmap.Database.open(path) as database:
        model = pycolmap.synthesize_dataset(options, database)
    return model, path


def test_a_true_model_agrees(ring):
    model, path = ring
    share, n_pairs = measure_agreement(model, read_verified_pairs(path))
    assert n_pairs > 5
    assert share == 1.0


def test_a_bent_model_does_not(ring):
    model, path = ring
    pairs = read_verified_pairs(path)
    bent = pycolmap.Reconstruction(model)
    for i, image_id in enumerate(sorted(bent.reg_image_ids())):
        image = bent.images[image_id]
        turn = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0.0, 0.02 * i, 0.0])), np.zeros(3))
        image.frame.rig_from_world = turn * image.frame.rig_from_world
    assert measure_agreement(bent, pairs)[0] < 0.7


def test_pairs_of_unregistered_photos_do_not_count(ring):
    model, path = ring
    pairs = read_verified_pairs(path)
    assert measure_agreement(pycolmap.Reconstruction(), pairs) == (0.0, 0)
