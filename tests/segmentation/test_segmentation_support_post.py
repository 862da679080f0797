"""The support post is told from the stem by shape alone."""

import numpy as np
import pytest

from cherrypicker.classes import Label
from cherrypicker.segmentation.spheres import TreeFrame
from cherrypicker.segmentation.standing_posts import split_standing_posts, standing_columns
from cherrypicker.segmentation.support_post import PostModel, find_post, split_support_post

FRAME = TreeFrame(np.zeros(3), 1.0)


def _tube(rng, n, foot, height, radius_foot, radius_top, lean=(0.0, 0.0), bend=0.0, noise=0.0015):
    """Surface points of an upright tube; `bend` is the amplitude of a slow wiggle, m."""
    z = rng.uniform(0, height, n)
    angle = rng.uniform(0, 2 * np.pi, n)
    radius = radius_foot + (radius_top - radius_foot) * z / height + rng.normal(0, noise, n)
    x = foot[0] + lean[0] * z + bend * np.sin(5 * z) + radius * np.cos(angle)
    y = foot[1] + lean[1] * z + bend * np.cos(4 * z) + radius * np.sin(angle)
    return np.column_stack([x, y, z])


def _stem(rng, bend=0.02):
    return _tube(rng, 6000, (0, 0), 2.2, 0.045, 0.018, lean=(0.02, -0.03), bend=bend)


@pytest.mark.parametrize("place", [(0.13, 0.02), (-0.18, 0.05)])
def test_post_beside_a_stem_is_found_with_its_radius_and_axis(place):
    rng = np.random.default_rng(0)
    stem = _stem(rng)
    post = _tube(rng, 3000, place, 1.6, 0.025, 0.025, lean=(0.01, 0.0))
    found = find_post(np.vstack([stem, post]), PostModel())
    assert found is not None
    assert found.radius == pytest.approx(0.025, abs=0.002)
    assert found.high == pytest.approx(1.6, abs=0.1)
    assert np.hypot(found.x - place[0], found.y - place[1]) < 0.005


def test_split_labels_the_post_and_leaves_the_stem():
    rng = np.random.default_rng(1)
    stem, post = _stem(rng), _tube(rng, 3000, (0.15, 0.0), 1.8, 0.03, 0.03)
    points = np.vstack([stem, post]) + [5.0, -3.0, 2.0]
    labels = np.full(len(points), Label.TRUNK, np.uint8)
    labels[-100:] = Label.BRANCH  # what the network took for branch goes along
    frame = TreeFrame(np.array([5.0, -3.0, 2.0]), 1.0)
    after = split_support_post(points, labels, frame, PostModel())
    assert (after[: len(stem)] == Label.TRUNK).mean() > 0.99
    assert (after[len(stem) :] == Label.SUPPORT_POST).mean() > 0.95
    assert (labels != Label.SUPPORT_POST).all()  # the input is untouched


def test_half_seen_post_is_found():
    rng = np.random.default_rng(2)
    stem, post = _stem(rng), _tube(rng, 5000, (0.15, 0.0), 1.8, 0.03, 0.03)
    post = post[post[:, 0] > 0.15 - 0.005]
    assert find_post(np.vstack([stem, post]), PostModel()) is not None


def test_a_lone_straight_stem_is_no_post():
    rng = np.random.default_rng(3)
    straight = _tube(rng, 6000, (0, 0), 2.0, 0.03, 0.03)
    assert find_post(straight, PostModel()) is None
    labels = np.full(len(straight), Label.TRUNK, np.uint8)
    assert (split_support_post(straight, labels, FRAME, PostModel()) == Label.TRUNK).all()


def test_two_crooked_or_tapered_stems_are_no_post():
    rng = np.random.default_rng(4)
    other = _tube(rng, 5000, (0.2, 0.0), 1.8, 0.05, 0.02)
    assert find_post(np.vstack([_stem(rng), other]), PostModel()) is None
    crooked = _tube(rng, 5000, (0.25, 0.0), 1.8, 0.03, 0.03, bend=0.025)
    assert find_post(np.vstack([_stem(rng), crooked]), PostModel()) is None


def test_few_points_give_no_post():
    assert find_post(np.random.default_rng(5).random((50, 3)), PostModel()) is None


def test_a_straight_stem_that_carries_a_crown_is_no_post():
    rng = np.random.default_rng(8)
    stem = _tube(rng, 6000, (0, 0), 0.9, 0.05, 0.047)
    post = _tube(rng, 3000, (0.2, 0.0), 1.8, 0.025, 0.025)
    arms = [
        _tube(rng, 2500, (0, 0), 0.9, 0.024, 0.02, lean=(0.7 * np.cos(a), 0.7 * np.sin(a)))
        + [0, 0, 0.9]
        for a in (0.5, 2.1, 3.6, 5.2)
    ]
    points = np.vstack([stem, post, *arms])
    labels = np.full(len(points), Label.TRUNK, np.uint8)
    labels[len(stem) + len(post) :] = Label.BRANCH
    after = split_support_post(points, labels, FRAME, PostModel())
    assert (after[: len(stem)] == Label.TRUNK).mean() > 0.98


def _ground(rng, tilt=0.0):
    xy = rng.uniform(-1, 1, (4000, 2))
    return np.column_stack([xy, tilt * xy[:, 0] + rng.normal(0, 0.003, len(xy))])


def _standing(rng, *tubes, tilt=0.0):
    """Points, labels (ground and nothing but branch) and the number of each tube's points."""
    ground = _ground(rng, tilt)
    points = np.vstack([ground, *tubes])
    labels = np.full(len(points), Label.BRANCH, np.uint8)
    labels[: len(ground)] = Label.GROUND
    return points, labels, np.cumsum([len(ground), *map(len, tubes)])


def test_a_post_that_passes_for_a_branch_is_found_beside_a_stem():
    rng = np.random.default_rng(9)
    post = _tube(rng, 3000, (0.35, 0.1), 1.8, 0.03, 0.03)
    points, labels, ends = _standing(rng, _stem(rng), post)
    assert (split_support_post(points, labels, FRAME, PostModel()) == labels).all()
    after = split_standing_posts(points, labels, FRAME, PostModel())
    assert (after[ends[1] :] == Label.SUPPORT_POST).mean() > 0.95
    assert (after[: ends[1]] == labels[: ends[1]]).all()


@pytest.mark.parametrize("far", [False, True])
def test_a_column_with_no_stem_near_it_is_no_post(far):
    rng = np.random.default_rng(10)
    post = _tube(rng, 3000, (0.8, 0.0), 1.8, 0.03, 0.03)
    points, labels, _ = _standing(rng, *([_stem(rng)] if far else []), post)
    assert (split_standing_posts(points, labels, FRAME, PostModel()) == labels).all()


def test_of_two_straight_columns_side_by_side_one_stays_wood():
    rng = np.random.default_rng(11)
    tubes = [_tube(rng, 3000, (x, 0.0), 1.8, 0.03, 0.03) for x in (0.0, 0.3)]
    points, labels, ends = _standing(rng, *tubes)
    after = split_standing_posts(points, labels, FRAME, PostModel())
    kinds = [np.median(after[a:b]) for a, b in zip(ends[:-1], ends[1:])]
    assert sorted(kinds) == [Label.BRANCH, Label.SUPPORT_POST]


def test_columns_rise_from_the_ground_whatever_its_slope():
    rng = np.random.default_rng(12)
    z_at = 0.3 * np.array([-0.6, 0.6])
    low, high = (_tube(rng, 2000, (x, 0), 1.0, 0.03, 0.02) for x in (-0.6, 0.6))
    low[:, 2] += z_at[0]
    high[:, 2] += z_at[1]
    hanging = _tube(rng, 2000, (0.0, 0.5), 1.0, 0.03, 0.02) + [0, 0, 0.4]
    points, labels, _ = _standing(rng, low, high, hanging, tilt=0.3)
    columns = standing_columns(points[labels != Label.GROUND], points[labels == Label.GROUND])
    assert sorted(round(column[:, 0].mean(), 1) for column in columns) == [-0.6, 0.6]
