"""Points near places, by cells, against all distances."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from cherrypicker.geometry.cells import have_company, rows_in_box, sort_into_cells


@pytest.mark.parametrize("size", [0.03, 0.1, 0.7])
@pytest.mark.parametrize("n_points", [1, 4])
def test_company_as_all_distances_say(size, n_points):
    rng = np.random.default_rng(0)
    points = rng.random((400, 3)) * [1.0, 0.6, 2.0] - [0.2, 3.0, 0.0]
    places = np.vstack([points, rng.random((300, 3)) * 3.0 - [0.5, 3.5, 0.5]])  # some far outside
    reach = rng.uniform(0.02, 0.3, len(places))
    expected = (cdist(places, points) <= reach[:, None]).sum(axis=1) >= n_points
    cells = sort_into_cells(points, size)
    assert 50 < expected.sum() < 650
    np.testing.assert_array_equal(have_company(cells, places, reach, n_points), expected)
    np.testing.assert_array_equal(cells.points, points[cells.order])
    assert (np.diff(cells.key) >= 0).all()


def test_cells_too_many_to_number_are_made_larger():
    points = np.array([[0.0, 0.0, 0.0], [1e9, 1e9, 1e9], [1e9, 1e9, 1e9 - 1.0]])
    cells = sort_into_cells(points, 1e-3)
    assert cells.size > 1e-3
    found = have_company(cells, points[:2], np.array([2.0, 2.0]), 2)
    np.testing.assert_array_equal(found, [False, True])


def test_chosen_points_alone_are_company():
    rng = np.random.default_rng(1)
    points, places = rng.random((300, 3)), rng.random((100, 3))
    chosen = rng.random(300) < 0.3
    found = have_company(sort_into_cells(points, 0.1).select(chosen), places, np.full(100, 0.2), 2)
    expected = (cdist(places, points[chosen]) <= 0.2).sum(axis=1) >= 2
    assert 10 < expected.sum() < 90
    np.testing.assert_array_equal(found, expected)


def test_rows_in_a_box():
    points = np.array([[0.0, 0, 0], [1, 1, 1], [0.5, 2, 0.5], [0.5, 0.5, 0.5], [1.01, 0.5, 0.5]])
    np.testing.assert_array_equal(rows_in_box(points, np.zeros(3), np.ones(3)), [0, 1, 3])
