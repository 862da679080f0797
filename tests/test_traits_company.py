"""Points near places, by cells, against all distances."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from cherrypicker.traits.company import have_company, sort_into_cells


@pytest.mark.parametrize("size", [0.03, 0.1, 0.7])
@pytest.mark.parametrize("n_points", [1, 4])
def test_company_as_all_distances_say(size, n_points):
    rng = np.random.default_rng(0)
    points = rng.random((400, 3)) * [1.0, 0.6, 2.0] - [0.2, 3.0, 0.0]
    places = np.vstack([points, rng.random((300, 3)) * 3.0 - [0.5, 3.5, 0.5]])  # some far outside
    reach = rng.uniform(0.02, 0.3, len(places))
    expected = (cdist(places, points) <= reach[:, None]).sum(axis=1) >= n_points
    cells, order = sort_into_cells(points, size)
    assert 50 < expected.sum() < 650
    np.testing.assert_array_equal(have_company(cells, places, reach, n_points), expected)
    np.testing.assert_array_equal(cells.points, points[order])
    assert (np.diff(cells.key) >= 0).all()


def test_cells_too_many_to_number_are_made_larger():
    points = np.array([[0.0, 0.0, 0.0], [1e9, 1e9, 1e9], [1e9, 1e9, 1e9 - 1.0]])
    cells, _ = sort_into_cells(points, 1e-3)
    assert cells.size > 1e-3
    found = have_company(cells, points[:2], np.array([2.0, 2.0]), 2)
    np.testing.assert_array_equal(found, [False, True])
