"""Walks along small trees."""

import numpy as np

from cherrypicker.geometry.tree_walks import chains_of, last_common


def test_chains_are_the_heaviest_ways():
    parent = np.array([-1, 0, 1, 1, 3, -1])
    chains = chains_of(parent, np.array([1, 1, 1, 1, 5, 2]))
    assert [chain.tolist() for chain in chains] == [[0, 1, 3, 4], [5], [2]]


def test_two_nodes_part_at_the_last_node_that_both_hang_on():
    parent = np.array([-1, 0, 1, 1, 3, 2])
    found = [last_common(parent, *pair) for pair in ((5, 4), (4, 5), (3, 4), (0, 5), (2, 2))]
    assert found == [1, 1, 3, 0, 2]
