"""Voxels, limits and draws by chance."""

import numpy as np

from cherrypicker.geometry.sampling import draw_evenly, majority_label, thin_to_limit, voxel_thin

NOISE_M = 0.005


def test_a_voxel_has_the_mean_of_its_points_and_most_of_their_class():
    points = np.random.default_rng(0).random((2000, 3))
    means, source, member = voxel_thin(points, 0.2)
    assert (np.diff(source) > 0).all() and len(means) == 125
    few = np.random.default_rng(1).random(len(points)) < 0.1
    assert (majority_label(np.where(few, 2, 1), member, len(means)) == 1).all()
    np.testing.assert_allclose(means[member[5]], points[member == member[5]].mean(axis=0))
    thinned, *_, size = thin_to_limit(points, 0.01, 300)
    assert len(thinned) <= 300 and size > 0.01


def noisy_plane(n_points, seed=0):
    """A square metre at z = 0, off by `NOISE_M`."""
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.random((n_points, 2)), rng.normal(0, NOISE_M, n_points)])


def test_by_chance_a_dense_noisy_cloud_keeps_its_noise():
    """One point a voxel alone keeps nearly all that err far of the few that do."""
    points = noisy_plane(400_000)
    far = np.abs(points[:, 2]) > 3 * NOISE_M
    for by_chance, at_least, at_most in ((False, 0.02, 1.0), (True, 0.0, 0.006)):
        _, source, member, size = thin_to_limit(points, 0.002, 40_000, by_chance=by_chance)
        assert 20_000 < len(source) <= 40_000 and size < NOISE_M * 2
        assert at_least < far[source].mean() < at_most  # of all points 0.0027
    assert (member[source] == np.arange(len(source))).all()
    assert (member == -1).mean() > 0.5


def test_sparse_wood_beside_dense_wood_keeps_its_points():
    dense, sparse = noisy_plane(200_000), noisy_plane(2_000, 1) + [2.0, 0.0, 0.0]
    points = np.vstack([dense, sparse])
    drawn = draw_evenly(points, 0.01)
    assert (drawn >= len(dense)).sum() == len(sparse)
    assert 0.05 * len(dense) < (drawn < len(dense)).sum() < 0.3 * len(dense)
    assert (drawn == draw_evenly(points, 0.01)).all() and (np.diff(drawn) > 0).all()
