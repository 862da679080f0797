"""What surface points say about a skeleton: lines of thin wood, bridges, spurs, missing twigs."""

import numpy as np
import pytest
from skeleton_shapes import tube

from cherrypicker.graph.bridges import bridge_pieces
from cherrypicker.graph.line_points import axis_points, line_shift
from cherrypicker.graph.prune import prune_stem_strays, prune_unseen
from cherrypicker.graph.radius import fit_radii
from cherrypicker.graph.regrow import regrow
from cherrypicker.graph.samples import without_foot
from cherrypicker.skeleton.model import Skeleton

STEP, NOISE = 0.012, 0.0045


def chain(*corners, parent=-1, first=0):
    """Nodes every `STEP` along a polyline and their parents."""
    pieces = [np.array([corners[0]], dtype=float)]
    for a, b in zip(np.array(corners[:-1], float), np.array(corners[1:], float)):
        n = max(1, int(round(np.linalg.norm(b - a) / STEP)))
        pieces.append(a + (np.arange(n) + 1)[:, None] / n * (b - a))
    points = np.vstack(pieces)
    if parent >= 0:
        points = points[1:]
    return points, np.concatenate([[parent], first + np.arange(len(points) - 1)])


def limb_and_twig(twig_length, rng, *, with_twig):
    """A limb along x with a twig upwards in its middle: skeleton, surface and noise."""
    limb, parent = chain((0, 0, 0), (0.6, 0, 0))
    parts = [(limb, parent, np.full(len(limb), 0.012))]
    if with_twig:
        foot = len(limb) // 2
        twig, up = chain((0.3, 0, 0), (0.3, 0, twig_length), parent=foot, first=len(limb))
        parts.append((twig, up, np.full(len(twig), 0.004)))
    points, parents, radius = (np.concatenate([part[i] for part in parts]) for i in range(3))
    skeleton = Skeleton(points, parents, radius, np.full(len(points), 2))
    wood = [tube((0, 0, 0), (0.6, 0, 0), 0.012, density=20_000, rng=rng, noise=NOISE)]
    wood.append(tube((0.3, 0, 0.01), (0.3, 0, 0.1), 0.004, density=30_000, rng=rng, noise=NOISE))
    return skeleton, np.vstack(wood)


def fitted(skeleton, surface):
    return fit_radii(skeleton, surface, spacing=STEP, max_radius=0.05, recentre=False)


def test_points_of_a_twig_move_onto_its_axis():
    rng = np.random.default_rng(1)
    surface = tube((0, 0, 0), (0.2, 0.1, 0.4), 0.004, density=40_000, rng=rng, noise=NOISE)
    direction = np.array([0.2, 0.1, 0.4]) / np.linalg.norm([0.2, 0.1, 0.4])
    elsewhere = surface + [0.0, 0.015, 0.0]  # a contraction that pulled the twig aside
    found, keep, along = axis_points(surface, elsewhere, STEP)
    aside = np.linalg.norm(found - np.outer(found @ direction, direction), axis=1)
    assert np.median(aside) < 0.002 and keep.all()
    assert np.median(np.abs(along @ direction)) > 0.98


def test_a_flat_patch_keeps_its_contracted_place():
    rng = np.random.default_rng(2)
    surface = np.column_stack([rng.uniform(0, 0.1, (400, 2)), np.zeros(400)])
    contracted = surface + [0, 0, -0.05]
    found, _, along = axis_points(surface, contracted, STEP)
    inner = np.abs(surface[:, :2] - 0.05).max(axis=1) < 0.03
    np.testing.assert_array_equal(found[inner], contracted[inner])
    assert not along[inner].any()


def test_line_shift_knows_eigenvalues_and_directions():
    rng = np.random.default_rng(3)
    points = rng.normal(size=(500, 3)) * [0.03, 0.006, 0.002]
    _, line, width, count, direction = line_shift(points, np.zeros((1, 3)), 1.0, 1)
    values, vectors = np.linalg.eigh(np.cov(points.T, bias=True))
    assert count[0] == 500
    assert line[0] == pytest.approx(1 - values[1] / values[2], rel=1e-6)
    assert width[0] == pytest.approx(np.sqrt(values[0] + values[1]), rel=1e-6)
    assert abs(direction[0] @ vectors[:, 2]) == pytest.approx(1, abs=1e-6)


def test_a_piece_has_one_bridge_and_where_its_end_points():
    stem = chain((0, 0, 0), (0, 0, 1))[0]
    lower = chain((0.0, 0, 0.4), (0.5, 0, 0.4))[0][1:]  # a branch that touches nothing else
    piece = chain((0.12, 0, 0.5), (0.5, 0, 0.5))[0]  # its start is missing; 10 cm over the lower
    nodes = np.vstack([stem, lower, piece])
    own = [len(stem), len(lower), len(piece)]
    edges, first = [], 0
    for n in own:
        edges += [(first + i, first + i + 1) for i in range(n - 1)]
        first += n
    edges.append((int(np.argmin(np.abs(stem[:, 2] - 0.4))), len(stem)))
    bridges = bridge_pieces(nodes, np.array(edges), STEP)
    assert len(bridges) == 1
    ends = nodes[bridges[0]]
    ends = ends[np.argsort(ends[:, 0])]
    np.testing.assert_allclose(ends[1], piece[0], atol=1e-9)
    np.testing.assert_allclose(ends[0], (0, 0, 0.5), atol=0.03)


def test_seen_twigs_stay_and_others_go():
    rng = np.random.default_rng(4)
    skeleton, surface = limb_and_twig(0.1, rng, with_twig=True)
    assert len(prune_unseen(fitted(skeleton, surface), surface, STEP, NOISE)) == len(skeleton)
    bare = surface[surface[:, 2] < 0.03]
    pruned = prune_unseen(fitted(skeleton, bare), bare, STEP, NOISE)
    assert pruned.points[:, 2].max() < 0.001


def test_a_twig_that_the_skeleton_lacks_grows_again():
    rng = np.random.default_rng(5)
    skeleton, surface = limb_and_twig(0.1, rng, with_twig=False)
    grown, n_added = regrow(fitted(skeleton, surface), surface, STEP)
    assert n_added == 1
    tip = grown.points[np.argmax(grown.points[:, 2])]
    np.testing.assert_allclose(tip, (0.3, 0, 0.1), atol=0.02)
    fork = np.flatnonzero(grown.n_children > 1)
    np.testing.assert_allclose(grown.points[fork], [(0.3, 0, 0)], atol=0.012)
    bare = surface[surface[:, 2] < 0.03]
    assert regrow(fitted(skeleton, bare), bare, STEP)[1] == 0


def test_strands_inside_the_stem_are_no_branches():
    stem, parent = chain((0, 0, 0), (0, 0, 0.6))
    strand, up = chain((0, 0, 0.3), (0.03, 0, 0.33), (0.03, 0, 0.45), parent=25, first=len(stem))
    branch, on = chain((0, 0, 0.2), (0.12, 0, 0.26), parent=17, first=len(stem) + len(strand))
    points = np.vstack([stem, strand, branch])
    radius = np.concatenate([np.full(len(stem), 0.04), np.full(len(strand) + len(branch), 0.01)])
    parents = np.concatenate([parent, up, on])
    skeleton = Skeleton(points, parents, radius, np.ones(len(points), dtype=int))
    pruned = prune_stem_strays(skeleton, STEP, 0.002)
    assert len(pruned) == len(stem) + len(branch)


def test_the_tree_starts_inside_the_stem():
    rng = np.random.default_rng(6)
    surface = tube((0, 0, 0), (0, 0, 1), 0.05, rng=rng)
    corners = [(0.05, 0, 0.01), (-0.05, 0, 0.02), (0, 0, 0.04), (0, 0, 0.2), (0, 0, 1), (0.5, 0, 0)]
    keep = without_foot(np.array(corners), surface, (0, 0, 0))
    np.testing.assert_array_equal(keep, [False, False, False, True, True, True])
