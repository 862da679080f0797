"""What photos say of places, learnt from the scan's own wood, whatever one photo gets wrong."""

import functools
from itertools import product

import cv2
import numpy as np
import pytest
from sky_scene import BARK as DARK
from sky_scene import SKIES, Rod, draw, ring, without_twigs

from cherrypicker.evidence.existence import (
    Witnesses,
    _along,
    ask_points,
    weigh,
    words_of_clear_sky,
)
from cherrypicker.evidence.witnesses import N_KINDS, UNASKED, Depth, look
from cherrypicker.mvs.raster import CLEAR_BELOW, HIDDEN, SOLID, THIN, make_raster

STEM = Rod((0.0, 0.0, 0.80), (0.0, 0.0, 1.25), 0.012, DARK)
#: Thin rods all around, from which the photos learn, and one that is asked about.
TWIGS = tuple(
    Rod((0.0, 0.0, z), (0.14 * np.cos(a), 0.14 * np.sin(a), z + 0.08), 0.002, DARK)
    for z, a in ((1.02, 0.2), (1.05, 2.3), (1.08, 4.4), (1.11, 1.2), (1.14, 3.3))
)
ASKED = Rod((0.03, -0.04, 1.07), (0.10, -0.13, 1.19), 0.002, DARK)
PIXEL = 2.5 / 700


def places(rod, n=60):
    return np.linspace(rod.start, rod.end, n + 2)[6:-1]


@functools.cache
def drawn(rods, sky, n):
    """Photos of a ring with their exact masks, drawn once."""
    poses = ring(n, focal=700.0, size=(300, 320))
    return [draw(poses, i, rods, sky) for i in range(n)]


class Photos:
    """Rasters of a drawn scene in memory; the cameras of some photos are off by pixels."""

    def __init__(self, rods, sky="overcast", mask=lambda free: free, n=20, off=(), depth=None):
        self.poses = ring(n, focal=700.0, size=(300, 320))
        none = np.zeros((320, 300), bool)
        pairs = drawn(rods, sky, n)
        self.rasters = [make_raster(photo, mask(free), none) for photo, free in pairs]
        self.slack_px = np.ones(n)
        self._depth = depth  # of all photos, or a function of one
        for i in off:
            self.poses.K[i, 0, 2] += 12.0

    def raster(self, i):
        return self.rasters[i]

    def depth(self, i):
        if self._depth is None or callable(self._depth):
            return self._depth and self._depth(self.poses[i])
        return np.full(self.rasters[i].shape, self._depth)


def maps_of(rods):
    """Depth maps that hold rods as wide as `SAME_PX`, and ground far behind them."""

    def depth(view):
        found = np.full((view.height, view.width), 9.0)
        for uv, own in zip(*view.project(np.vstack([places(rod, 200) for rod in rods]))):
            cv2.circle(found, np.round(uv).astype(int).tolist(), 3, float(own), -1)
        return found

    return depth


def tree(photos, asked, holds_points=True):
    """The places of stem, twigs and one rod more, asked of the photos: probabilities of it."""
    known = [places(rod) for rod in (STEM, *TWIGS)]
    points = np.vstack([*known, places(asked)])
    radius = np.repeat([0.012, *[0.002] * 6], len(known[0]))
    parent = np.arange(len(points)) - 1
    parent[:: len(known[0])] = -1
    rows = slice(len(points) - len(known[0]), None)
    wood = points if holds_points else points[: rows.start]
    found = Witnesses(photos, points, radius, parent, PIXEL, wood)
    return found, found.tree.probability[rows], found.tree.words[:, rows]


@pytest.mark.parametrize("mask", [lambda free: free, without_twigs], ids=["exact", "twigs lost"])
@pytest.mark.parametrize("sky", SKIES)
def test_wood_is_there_and_air_is_not_however_wrong_the_mask(sky, mask):
    whole = Photos((STEM, *TWIGS, ASKED), sky, mask)
    assert tree(whole, ASKED)[1].min() > 0.95
    without = Photos((STEM, *TWIGS), sky, mask)
    assert tree(without, ASKED)[1].max() < 0.05


def test_photos_that_are_off_have_no_word_and_never_outvote_the_others():
    off = range(0, 20, 4)
    found, probability, words = tree(Photos((STEM, *TWIGS, ASKED), off=off), ASKED)
    is_off = np.isin(np.arange(20), off)
    assert probability.min() > 0.95
    assert np.abs(words[is_off].mean()) < 0.3
    assert words[~is_off].mean() > 0.6
    assert found.clear_word[is_off].min() > -1.5 and found.clear_word[~is_off].max() < -2.0


def test_two_photos_with_clear_sky_do_not_outvote_twenty():
    photos = Photos((STEM, *TWIGS, ASKED))
    bare = Photos((STEM, *TWIGS))
    for i in (3, 11):
        photos.rasters[i] = bare.rasters[i]
    _, probability, words = tree(photos, ASKED)
    assert np.median(words[[3, 11]], axis=1).max() < -0.3
    assert probability.min() > 0.9


def test_what_a_user_hides_is_not_asked():
    photos = Photos((STEM, *TWIGS), n=4)
    photos.rasters[1][:] = HIDDEN
    seen = look(photos, places(ASKED), np.full(55, 0.002))
    assert (seen.shown[1] == UNASKED).all() and (seen.shown[0] != UNASKED).all()


def test_a_map_that_looks_through_speaks_against_and_one_that_holds_it_says_nothing():
    at = places(STEM)
    radius = np.full(len(at), 0.012)
    far, own = (
        look(Photos((STEM,), n=4, depth=depth), at, radius, by_depth=True).shown // N_KINDS
        for depth in (9.0, 2.5)
    )
    assert (far == Depth.BEHIND).all()
    assert (own == Depth.OPEN).all()
    unasked = look(Photos((STEM,), n=4, depth=9.0), at, radius).shown // N_KINDS
    assert (unasked == Depth.OPEN).all()


def test_maps_are_no_witness_of_wood_that_they_lost_before_ground():
    ground = {"mask": np.zeros_like, "depth": maps_of((STEM, *TWIGS))}
    photos = Photos((STEM, *TWIGS, ASKED), **ground)
    assert tree(photos, ASKED)[1].mean() < 0.1
    assert tree(photos, ASKED, holds_points=False)[1].min() > 0.9


def test_an_uncertain_camera_is_given_slack():
    photos = Photos((STEM, ASKED), n=8, off=range(8))
    strict = look(photos, places(ASKED), np.full(55, 0.002)).shown
    photos.slack_px[:] = 13.0
    slack = look(photos, places(ASKED), np.full(55, 0.002)).shown
    assert (slack == THIN).mean() > 0.85
    assert (strict == THIN).mean() < 0.6


@pytest.mark.parametrize("sky", SKIES)
def test_points_on_a_twig_are_told_from_those_beside_it(sky):
    rng = np.random.default_rng(0)
    photos = Photos((STEM, *TWIGS, ASKED), sky, without_twigs)
    sure = np.vstack([rod.surface(300, rng) for rod in (STEM, *TWIGS)])
    on, beside = (ASKED.surface(300, rng, off=off) for off in (0.0, 0.012))
    told = ask_points(photos, np.vstack([on, beside]), sure)
    assert (told[:300] > 0).mean() > 0.95
    assert (told[300:] < 0).mean() > 0.8
    assert (words_of_clear_sky(photos, sure) < -1.0).all()
    assert (ask_points(photos, on + [0.0, 0.0, 9.0], sure) == 0.0).all(), "out of every frame"


def test_photos_that_say_the_same_count_as_one():
    rng = np.random.default_rng(3)
    seen = rng.normal(size=(5, 20_000))  # at wood one more, without it one less
    told = 2.0 * np.hstack([seen + 1.0, seen - 1.0])  # logarithms of likelihood ratios
    is_wood = np.arange(40_000) < 20_000
    assert weigh(told, is_wood, ~is_wood) > 0.95
    alike = np.repeat(told[:1], 5, axis=0)
    assert weigh(alike, is_wood, ~is_wood) == pytest.approx(0.2, abs=0.01)
    assert weigh(told, is_wood, np.zeros(40_000)) == 0.0, "nothing to learn from"


def test_the_tree_of_probabilities_is_that_of_all_states():
    rng = np.random.default_rng(1)
    parent = np.array([-1, 0, 1, 1, 3, -1, 5])
    change, told, prior = rng.uniform(0.05, 0.5, 7), rng.normal(0, 2, 7), 0.8
    total, there = 0.0, np.zeros(7)
    for states in product((0, 1), repeat=7):
        chance = 1.0
        for i, state in enumerate(states):
            stay = prior
            if parent[i] >= 0:
                stay = (1 - change[i]) * states[parent[i]] + change[i] * prior
            chance *= (stay if state else 1 - stay) * np.exp(told[i] * state)
        total += chance
        there += chance * np.array(states)
    np.testing.assert_allclose(_along(parent, change, told, prior), there / total, rtol=1e-9)


def test_a_raster_tells_levels_of_sky_thin_solid_and_hidden():
    sky = np.zeros((60, 80), bool)
    sky[:30] = True
    sky[5:25, 20:22] = False
    photo = np.full((60, 80, 3), 200, np.uint8)
    photo[10:20, 60:62] -= 60  # a twig that the mask lost
    hidden = np.zeros_like(sky)
    hidden[:, 76:] = True
    raster = make_raster(photo, sky, hidden)
    assert (raster[:28, :15] == 0).all()
    assert (raster[8:22, 20:22] == THIN).all() and (raster[35:, :70] == SOLID).all()
    assert (raster[12:18, 60:62] >= CLEAR_BELOW).all() and (raster[12:18, 60:62] < SOLID).all()
    assert (raster[:, 76:] == HIDDEN).all()
