"""Bearing trees: thick limbs, heavy cuts, burls, and stems that are no circles."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from cherrypicker_lab.orchard.grow.templates import BEARING, grow_any
from cherrypicker_lab.orchard.grow.tree import Axis, Tree
from cherrypicker_lab.orchard.scene.mesh import tree_mesh
from cherrypicker_lab.orchard.seen.tubes import inside_wood, sample_tubes
from cherrypicker_lab.orchard.truth import tree_traits

SEEDS = range(40, 46)


@pytest.fixture(scope="module")
def trees():
    return [grow_any(seed, form) for form in BEARING for seed in SEEDS]


@pytest.fixture(scope="module")
def oval():
    """A stem of 6 cm radius and 0.5 m whose section is twice as broad as deep."""
    angle = np.arange(36) * np.pi / 18
    outline = 1.0 / np.hypot(np.cos(angle) / np.sqrt(2), np.sin(angle) * np.sqrt(2))
    outline /= np.sqrt((outline**2).mean())
    points = np.linspace([0, 0, 0], [0, 0, 0.5], 51)
    return Tree("oval", [Axis(points, np.full(51, 0.06), 0, section=np.tile(outline, (51, 1)))])


def test_stems_scaffolds_and_cuts_are_those_of_bearing_trees(trees):
    stems = [tree_traits(tree)["trunk_diameter_m"] for tree in trees]
    assert 0.08 < min(stems) < max(stems) < 0.21
    for tree in trees:
        limbs = [a.radii[len(a.radii) // 8] for a in tree.axes if a.order == 1 and not a.is_cut]
        assert 0.03 < 2 * max(limbs) < 0.11
        cuts = [a for a in tree.axes if a.is_cut]
        assert len(cuts) >= 3
        assert all(0.02 < 2 * a.radii[-1] < 0.085 for a in cuts)
        assert not any(a.parent == number for number, c in enumerate(tree.axes) if c.is_cut
                       for a in tree.axes)  # fmt: skip
    assert max(2 * a.radii[-1] for tree in trees for a in tree.axes if a.is_cut) > 0.045


def test_a_limb_thins_at_a_fork_by_what_the_branch_carries(trees):
    forks = []
    for tree in trees:
        for number, limb in enumerate(tree.axes):
            if limb.section is not None or limb.is_cut:
                continue
            reach = int(limb.radii[0] / 0.01) + 1
            for child in (a for a in tree.axes if a.parent == number):
                below = limb.radii[max(child.parent_node - reach, 0)]
                above = limb.radii[min(child.parent_node + reach, len(limb.radii) - 1)]
                assert above <= below and child.radii[0] < below
                forks.append((below, above, child.radii[0]))
    below, above, child = np.array(forks).T
    heavy = child > 0.6 * below
    assert heavy.sum() > 50
    assert np.median((above[heavy] ** 2 + child[heavy] ** 2) / below[heavy] ** 2) == pytest.approx(
        1.0, abs=0.15
    )


def test_equal_seeds_give_equal_bearing_trees():
    one, same, other = (grow_any(seed, "bearing_vase") for seed in (4, 4, 5))
    np.testing.assert_array_equal(one.skeleton().radius, same.skeleton().radius)
    np.testing.assert_array_equal(one.axes[0].section, same.axes[0].section)
    assert len(other.skeleton().radius) != len(one.skeleton().radius)


def test_radii_are_those_of_circles_of_the_sections_area(trees):
    tree = trees[0]
    stem = tree.axes[0]
    bare = Tree("stem", [stem])
    surface = sample_tubes(np.random.default_rng(0), bare, 400_000)
    areas = []
    for node in range(25, 36):
        near = np.abs(surface.s - stem.arclength[node]) < 0.004
        off = surface.points[near] - stem.points[node]
        off -= (off @ stem.tangents[node])[:, None] * stem.tangents[node]
        order = np.argsort(surface.angle[near])
        span = np.roll(surface.angle[near][order], -1) - surface.angle[near][order]
        distance = np.linalg.norm(off[order], axis=1)
        areas.append(0.5 * (distance**2 * (span % (2 * np.pi))).sum() / stem.radii[node] ** 2)
    np.testing.assert_allclose(areas, np.pi, rtol=0.02)
    assert np.ptp(stem.section[30]) > 0.04  # no circle


def test_points_and_mesh_of_an_oval_stem_lie_on_one_surface(oval):
    surface = sample_tubes(np.random.default_rng(1), oval, 200_000)
    tube = surface.s < 0.49
    assert np.abs(surface.points[tube, 2] - surface.s[tube]).max() < 1e-9
    mesh = tree_mesh(oval)
    row = np.abs(mesh.vertices[:, 2] - 0.25) < 0.002
    for points in (surface.points[tube, :2], mesh.vertices[row, :2]):
        extent = np.sort(np.ptp(points @ _turn(points), axis=0))
        np.testing.assert_allclose(extent, 0.12 * np.array([np.sqrt(0.5), np.sqrt(2)]), rtol=0.02)
        assert ConvexHull(points).volume == pytest.approx(np.pi * 0.06**2, rel=0.01)
    # normals stand on the surface: across the long sides, not away from the axis
    across = _turn(surface.points[tube, :2])
    flat = surface.points[tube, :2] @ across, surface.normals[tube, :2] @ across
    slope = np.array([0.5, 2.0])[np.argsort(np.ptp(flat[0], axis=0))[::-1]]
    expected = flat[0] * slope
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    assert np.quantile((expected * flat[1]).sum(axis=1), 0.01) > 0.97


def _turn(points):
    """The principal axes of points in a plane, (2, 2)."""
    return np.linalg.eigh(np.cov(points.T))[1]


def test_inside_is_within_the_section_not_within_the_circle(oval):
    axes = _turn(sample_tubes(np.random.default_rng(1), oval, 100_000).points[:, :2])
    # 5 cm from the axis: outside the short way (4.2 cm), inside the long way (8.5 cm)
    points = np.column_stack([0.05 * axes.T, [0.25, 0.25]])
    far = np.column_stack([0.08 * axes.T, [0.25, 0.25]])
    owner = np.full(2, -1)
    assert inside_wood(oval, points, owner).tolist() == [False, True]
    assert inside_wood(oval, far, owner).tolist() == [False, True]


def test_a_cut_is_flat_and_evenly_sampled():
    points = np.linspace([0, 0, 0], [0, 0, 0.1], 11)
    tree = Tree("stub", [Axis(points, np.full(11, 0.03), 0, is_cut=True)])
    surface = sample_tubes(np.random.default_rng(0), tree, 1_000_000)
    end = surface.normals[:, 2] > 0.99
    np.testing.assert_allclose(surface.points[end, 2], 0.1)
    assert end.sum() == pytest.approx(1e6 * np.pi * 0.03**2, rel=0.06)
    inner = np.hypot(*surface.points[end, :2].T) < 0.015
    assert inner.mean() == pytest.approx(0.25, abs=0.03)
    assert tree_mesh(tree).vertices[:, 2].max() == pytest.approx(0.1)
