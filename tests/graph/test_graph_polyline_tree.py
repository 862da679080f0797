"""Axes as strands: cut, joined, straightened and carried on."""

import numpy as np
import pytest
from skeleton_shapes import tube

from cherrypicker.graph.polyline_tree import join_strands, split_strands
from cherrypicker.graph.refine import refine_skeleton
from cherrypicker.skeleton.model import Skeleton

STEP = 0.01


def stem_with_twig(twig, start=50, gap_at=None):
    """Stem of 1 m and 3 cm radius with nodes every `STEP`, and a thin twig on one of its nodes."""
    stem = np.column_stack([np.zeros(101), np.zeros(101), np.arange(101) * STEP])
    points = np.vstack([stem, twig])
    parent = np.arange(-1, len(points) - 1)
    parent[101] = start
    radius = np.concatenate([np.full(101, 0.03), np.full(len(twig), 0.005)])
    gap = np.zeros(len(points), dtype=np.int64)
    if gap_at is not None:
        gap[gap_at] = 1
    label = np.where(np.arange(len(points)) < 101, 1, 2)
    return Skeleton(points, parent, radius, label, {"gap": gap})


def along_x(first, last, z=0.5):
    x = np.arange(first, last + STEP / 2, STEP)
    return np.column_stack([x, np.zeros(len(x)), np.full(len(x), z)])


def test_strands_of_a_stem_with_a_twig():
    strands = split_strands(stem_with_twig(along_x(0.01, 0.3)))
    assert strands.start.tolist() == [0, 101, 132]
    assert strands.parent.tolist() == [-1, 0]
    np.testing.assert_allclose(strands.at, [0, 0.5])
    np.testing.assert_allclose(strands.points[101], [0, 0, 0.5])
    assert strands.radius[101] == 0.005 and strands.label[101] == 2  # not those of the stem


def test_joined_strands_are_the_skeleton_again():
    skeleton = stem_with_twig(along_x(0.01, 0.3))
    joined = join_strands(split_strands(skeleton), STEP, unit="m", frame="metric")
    np.testing.assert_allclose(np.sort(joined.points, axis=0), np.sort(skeleton.points, axis=0))
    fork = np.flatnonzero(joined.n_children == 2)
    np.testing.assert_allclose(joined.points[fork], [[0, 0, 0.5]])
    assert joined.edge_length.sum() == pytest.approx(1.3)
    assert (joined.radius == 0.03).sum() == 101 and (joined.label == 2).sum() == 30


def test_no_nodes_are_put_where_nothing_was_seen():
    twig = np.vstack([along_x(0.01, 0.1), along_x(0.2, 0.3)])
    seen = join_strands(split_strands(stem_with_twig(twig)), STEP, unit="m", frame="metric")
    bare = stem_with_twig(twig, gap_at=101 + 10)
    bare = join_strands(split_strands(bare), STEP, unit="m", frame="metric")
    assert seen.edge_length.max() < 1.5 * STEP and not seen.fields["gap"].any()
    assert bare.edge_length.max() == pytest.approx(0.1)
    assert np.flatnonzero(bare.fields["gap"]).tolist() == [np.argmax(bare.edge_length)]
    assert len(seen) - len(bare) == 9


def test_further_side_axes():
    strands = split_strands(stem_with_twig(along_x(0.01, 0.3)))
    twig = along_x(-0.2, 0.0, z=0.7)[::-1]
    columns = {"points": twig, "radius": np.full(21, 0.004), "label": np.full(21, 2)}
    more = {**columns, "gap": np.zeros(21, dtype=np.int64), "parent": 0, "at": 0.7}
    joined = join_strands(strands.with_more([more]), STEP, unit="m", frame="metric")
    forks = joined.points[joined.n_children == 2]
    np.testing.assert_allclose(np.sort(forks[:, 2]), [0.5, 0.7])
    assert joined.edge_length.sum() == pytest.approx(1.5)
    assert len(strands.with_more([])) == 2


def test_bent_start_is_straightened_and_short_tips_reach_the_end_of_their_points():
    rng = np.random.default_rng(0)
    stem = tube((0, 0, -0.02), (0, 0, 1.0), 0.03, density=30_000, rng=rng)
    twig_points = tube((0, 0, 0.4), (0.3, 0, 0.7), 0.005, density=60_000, rng=rng)
    x = np.arange(0.01, 0.261, STEP)
    twig = np.column_stack(
        [x, np.zeros(len(x)), np.maximum(0.4 + x, 0.45)]
    )  # pulled along the stem
    skeleton = stem_with_twig(twig, start=45)
    refined = refine_skeleton(skeleton, np.vstack([stem, twig_points]), STEP)
    fork = refined.points[refined.n_children == 2]
    assert len(fork) == 1 and fork[0, 2] == pytest.approx(0.4, abs=0.02)  # it was 0.45
    tip = refined.points[np.argmax(refined.points[:, 0])]
    assert np.linalg.norm(tip - [0.3, 0, 0.7]) < 0.01  # it was 57 mm short
    assert refined.points[0, 2] == pytest.approx(-0.015, abs=0.01)
    line = refined.points[refined.label == 2]
    assert np.abs(line[:, 2] - line[:, 0] - 0.4).max() < 0.015


def test_side_axes_of_side_axes_stay_where_they_are():
    skeleton = stem_with_twig(along_x(0.01, 0.3))
    up = np.arange(1, 21) * STEP
    shoot = np.column_stack([np.full(20, 0.15), np.zeros(20), 0.5 + up])
    points = np.vstack([skeleton.points, shoot])
    parent = np.concatenate([skeleton.parent, [115], 131 + np.arange(19)])
    radius = np.concatenate([skeleton.radius, np.full(20, 0.003)])
    label = np.concatenate([skeleton.label, np.full(20, 2)])
    strands = split_strands(Skeleton(points, parent, radius, label))
    assert strands.parent.tolist() == [-1, 0, 1]
    joined = join_strands(strands, STEP, unit="m", frame="metric")
    forks = joined.points[joined.n_children == 2]
    np.testing.assert_allclose(forks[np.argsort(forks[:, 0])], [[0, 0, 0.5], [0.15, 0, 0.5]])
    assert joined.edge_length.max() < 1.5 * STEP
