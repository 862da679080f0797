"""A tree a year later and after pruning: what stays, what goes, what is new."""

import numpy as np
import pytest

from cherrypicker_lab.orchard.grow.growth import grow_tree
from cherrypicker_lab.orchard.grow.seasons import NEW, Pruning, first_date, grow_a_year, prune
from cherrypicker_lab.orchard.grow.templates import grow_any


def length_of(dated, only=slice(None)):
    return dated.tree.skeleton().edge_length[only].sum()


@pytest.fixture(scope="module")
def first():
    return first_date(grow_tree(4, "leader", height=2.0))


def test_every_node_has_one_number(first):
    numbers = first.node_numbers
    assert len(numbers) == len(first.tree.skeleton().points)
    assert len(np.unique(numbers)) == len(numbers)


def test_pruning_takes_what_it_notes(first):
    pruned = prune(first, np.random.default_rng(0))
    assert len(pruned.cuts) == Pruning().n_limbs
    taken = sum(cut["length_m"] for cut in pruned.cuts)
    assert length_of(first) - length_of(pruned) == pytest.approx(taken)
    assert set(pruned.node_numbers) < set(first.node_numbers)
    wood = [
        np.pi * tree.tree.skeleton().radius ** 2 @ tree.tree.skeleton().edge_length
        for tree in (first, pruned)
    ]
    volume = sum(cut["volume_m3"] for cut in pruned.cuts)
    assert wood[0] - wood[1] == pytest.approx(volume, rel=0.1)
    points = pruned.tree.skeleton().points
    for cut in pruned.cuts:
        assert np.linalg.norm(points - cut["place"], axis=1).min() < 1e-9


@pytest.mark.parametrize("habit", ["leader", "bearing_vase"])
def test_a_year_adds_wood_and_keeps_what_there_was(habit):
    first = first_date(grow_any(3, habit, height=2.5))
    grown = grow_a_year(first, np.random.default_rng(0))
    numbers = grown.node_numbers
    assert set(numbers[numbers != NEW]) == set(first.node_numbers)
    old = length_of(grown, numbers != NEW)
    assert old == pytest.approx(length_of(first), rel=1e-4)  # bent, not stretched
    assert 1.1 < length_of(grown) / length_of(first) < 1.8
    foot = grown.tree.axes[0].radii[0] / first.tree.axes[0].radii[0]
    assert 1.03 < foot < 1.11
    by_number = dict(zip(first.node_numbers, first.tree.skeleton().radius))
    radii = [by_number[n] for n in numbers if n != NEW]
    assert (grown.tree.skeleton().radius[numbers != NEW] > 0.9 * np.array(radii)).all()
    for axis in grown.tree.axes[1:]:
        mother = grown.tree.axes[axis.parent]
        np.testing.assert_allclose(axis.points[0], mother.points[axis.parent_node], atol=1e-9)


def test_a_stub_does_not_grow(first):
    pruned = prune(first, np.random.default_rng(0))
    grown = grow_a_year(pruned, np.random.default_rng(1))
    for before, after in zip(pruned.tree.axes, grown.tree.axes):
        assert after.is_cut == before.is_cut
        assert not before.is_cut or len(after.points) == len(before.points)
