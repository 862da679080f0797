"""Walks along small trees."""

import numpy as np

from cherrypicker.geometry.tree_walks import chains_of


def test_chains_are_the_heaviest_ways():
    parent = np.array([-1, 0, 1, 1, 3, -1])
    chains = chains_of(parent, np.array([1, 1, 1, 1, 5, 2]))
    assert [chain.tolist() for chain in chains] == [[0, 1, 3, 4], [5], [2]]
