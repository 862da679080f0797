"""Sources cover what the cameras look at, whatever stands behind it."""

import numpy as np
from scan_scene import look_at_poses, ring

from cherrypicker.mvs.estimate import find_beyond
from cherrypicker.mvs.views import COVER, Places, choose_sources
from cherrypicker.placement.region import find_region, framing

TARGET = np.array([0.0, 0.0, 1.2])


def crown_walk():
    """Two rings: the lower photos cut the crown, every third of the upper ones shows the top."""
    low = look_at_poses(ring(n=30, heights=(1.2,)), [0.0, 0.0, 0.8])
    high = look_at_poses(ring(n=30, heights=(1.6,)), [0.0, 0.0, 2.6])
    return [*low, *high], low, high


def places_of(views, low, high):
    region = find_region(look_at_poses(np.concatenate([low.centers, high.centers]), TARGET))
    framed = np.concatenate([framing(poses, region) for poses in (low, high)])
    return Places(region.samples, framed.mean(axis=0), framed)


def test_a_photo_of_the_top_gets_sources_that_frame_the_top():
    views, low, high = crown_walk()
    places = places_of(views, low, high)
    for i in (30, 41, 55):
        sources = choose_sources(views, i, places, 6, COVER)
        assert i not in sources
        frames_top = [(places.shown[j] * (places.points[:, 2] > 2.6)).sum() > 0 for j in sources]
        assert sum(frames_top) >= 3


def test_every_part_in_frame_is_seen_by_three_sources_where_three_exist():
    views, low, high = crown_walk()
    places = places_of(views, low, high)
    short = []
    for i in range(len(views)):
        sources = choose_sources(views, i, places, 6, COVER)
        seen = places.shown[list(sources)].sum(axis=0)
        short.append((places.worth * places.shown[i] * (seen < 3)).sum() / places.worth.sum())
    assert max(short) < 0.05


def test_no_more_sources_than_are_worth_their_time():
    views, low, high = crown_walk()
    places = places_of(views, low, high)
    many = choose_sources(views, 3, places, 40, COVER)
    assert 3 <= len(many) < 40


def test_what_lies_beyond_the_region_is_told_by_its_depth():
    region = find_region(look_at_poses(ring(), TARGET))
    depth = np.array([1.0, 3.0, 5.5, 7.0, 60.0, 60.0], dtype=np.float32)
    field = np.zeros((3, 18, 4), dtype=np.float32)
    field[..., 0] = 1.0 / np.repeat(depth, 3)
    field[:, 15:, 3] = 1.5  # no match: nobody knows what it shows
    view = look_at_poses(ring(), TARGET, size=(18, 3), focal=4000.0)[0]
    beyond = find_beyond(region, view, field, (18, 3))
    assert beyond[1, 1::3].tolist() == [False, False, False, True, True, False]
    assert np.flatnonzero(beyond[1]).tolist() == [10, 11, 12, 13]  # and nothing else around them
    assert find_beyond(region, view, field, (36, 6))[2, 20:28].all()
    assert not find_beyond(None, view, field, (18, 3)).any()


def test_a_source_that_sees_as_large_goes_before_one_that_stands_far_off():
    turn = np.radians([0.0, 11.0, -11.0])
    distance = np.array([3.0, 12.0, 3.0])  # of the photo, and of its two sources
    centers = np.column_stack([distance * np.cos(turn), distance * np.sin(turn), np.full(3, 1.2)])
    views = list(look_at_poses(centers, TARGET))
    shown = np.ones((3, 1), bool)
    places = Places(TARGET[None], np.ones(1), shown)
    assert choose_sources(views, 0, places, 1, COVER) == (2,)
