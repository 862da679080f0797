"""Cylinders of a structure model as a graph."""

import numpy as np
import pytest

from cherrypicker_lab.skeletons.cylinders import graph_of_cylinders, places_on_cylinders


def model():
    """A stem of two cylinders, and branches that start at its top, by its middle and below it."""
    start = [[0, 0, 0], [0, 0, 1], [0.05, 0, 1.5], [0.05, 0, 2.0], [0.05, 0, 0.9]]
    end = [[0, 0, 1], [0, 0, 2], [1, 0, 1.5], [1, 0, 2.0], [1, 0, 0.9]]
    return {
        "start": np.array(start, float),
        "end": np.array(end, float),
        "radius": np.array([0.05, 0.05, 0.01, 0.01, 0.01]),
        "parent": np.array([-1, 0, 1, 1, 1]),
        "branch": np.array([0, 0, 1, 2, 3]),
    }


def test_branches_leave_the_axis_of_their_parent_where_they_start():
    graph = graph_of_cylinders(model())
    assert len(graph.edges) == len(graph.points) - 1  # one tree
    assert graph.points[graph.root] == pytest.approx([0, 0, 0])
    forks = graph.points[graph.junctions()]
    # the branch at the top goes on from it; the one that starts below its parent leaves its foot
    assert sorted(map(tuple, forks.round(9))) == [(0, 0, 1), (0, 0, 1.5)]
    assert len(graph.tips()) == 3
    assert graph.length.sum() == pytest.approx(2 + 3 * 1.0, abs=0.1)


def test_two_that_continue_one_cylinder_are_a_fork():
    fork = model()
    fork["branch"] = np.array([0, 0, 0, 0, 0])
    graph = graph_of_cylinders(fork)
    assert len(graph.edges) == len(graph.points) - 1
    assert len(graph.tips()) == 3 and len(graph.junctions()) == 2


def test_places_have_the_radius_of_their_cylinder():
    places, radius = places_on_cylinders(model(), 0.25)
    assert len(places) == len(radius) and radius[places[:, 0] == 0].tolist() == [0.05] * 10
    assert set(radius[places[:, 0] > 0.1]) == {0.01}
