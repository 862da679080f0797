"""How probable it is that wood is there: the photos' words summed, and carried along the tree."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.spatial import cKDTree

from cherrypicker.compiled import compiled
from cherrypicker.evidence.witnesses import (
    SAME_PX,
    Seen,
    beside,
    bounded,
    by_raster,
    clear_words,
    count,
    information,
    look,
    shares,
    without_depth,
    words,
)
from cherrypicker.mvs.scan_photos import ScanPhotos

# Wood that stereo found, of a skeleton or a cloud, that is there before any photo is asked, a share
PRIOR = 0.95
# How far wood that is there, or is not, goes on in the mean, in steps between places: the most
# likely on two scenes with truth, each by itself
RUN_STEPS = 10.0
# Points of a cloud that the photos learn from
MOST_SURE = 20_000
# Rounds in which what is there and how photos show it tell one another
N_ROUNDS = 10


class Existence(NamedTuple):
    """What the photos say of places."""

    probability: np.ndarray  # (n_places,) float64: that wood is there
    # (n_photos, n_places) float32: each photo's, the logarithm of a likelihood ratio; 0 where it
    # has none
    words: np.ndarray
    # (n_places,) float64: between 0 and 1: how far photos with sky behind the place can tell wood
    # from none
    told: np.ndarray


class Witnesses:
    """The photos of a scan, once they have shown how they show wood that is there.

    Most wood at the ``points`` (n, 3) of a ``radius`` (n,) is there; ``pixel`` is the size of one
    there. Each place hangs on its ``parent`` (n,), int64, which is always before it, or on none
    where that is -1. The photos learn from places that hold points of a cloud, ``wood`` (n_wood,
    3); of a tree's places that hold none the depth maps are not asked: they lose thin wood before
    ground.

    What they say of these places is ``tree``, what each says of thin wood at a place where it shows
    clear sky ``clear_word``, (n_photos,) float64.
    """

    def __init__(
        self,
        photos: ScanPhotos,
        points: np.ndarray,
        radius: np.ndarray,
        parent: np.ndarray,
        pixel: float,
        wood: np.ndarray,
        *,
        seed: int = 0,
    ) -> None:
        self._photos = photos
        rng = np.random.default_rng(seed)
        aside, rows = beside(points, radius, pixel, rng, wood)
        both = np.vstack([points, aside]), np.concatenate([radius, radius[rows]])
        seen, n = look(photos, *both, by_depth=True), len(points)
        is_aside = np.arange(len(both[0])) >= n
        away = count(seen, is_aside.astype(float))
        is_sure = cKDTree(wood).query(points)[0] <= radius + SAME_PX * pixel
        bare = np.flatnonzero(~is_sure)
        bare_seen = by_raster(seen.at(bare))
        probability, share = np.ones(n), np.zeros(len(both[0]))
        for _ in range(N_ROUNDS):
            share[:n] = is_sure * probability
            there = count(seen, share)
            learnt = shares(there, away)
            told = words(seen, learnt)
            self._by_raster = without_depth(learnt)
            told[:, bare] = words(bare_seen, self._by_raster)
            weight = weigh(told, share, is_aside)
            # to learn from what is likeliest there, rather than to say how sure that is
            probability = carried(parent, told[:, :n], weight)
        self._weight = weigh(words(by_raster(seen), self._by_raster), share, is_aside)
        # Places of one run are as far beside the wood as one another, so that their words are
        # alike, by a factor less with every step; the design effect of that is twice the run
        probability = carried(parent, told[:, :n], weight / (2.0 * RUN_STEPS))
        self.tree = Existence(probability, told[:, :n], self._told(seen)[:n])
        self.clear_word = clear_words(there, away)

    def judge(self, points: np.ndarray, radius: np.ndarray) -> Existence:
        """What the photos say of other places, each by itself and whatever the depth maps lack."""
        seen = look(self._photos, points, radius)
        told = words(seen, self._by_raster)
        odds = np.exp(summed(told, self._weight))
        return Existence(odds / (1.0 + odds), told, self._told(seen))

    def _told(self, seen: Seen) -> np.ndarray:
        return 1.0 - np.exp(-information(seen, self._by_raster))


def ask_points(
    photos: ScanPhotos, asked: np.ndarray, sure: np.ndarray, *, seed: int = 0
) -> np.ndarray:
    """What all photos say of points of a cloud, (n_asked,) float64, a likelihood ratio's logarithm.

    In the photos' frame are the points that are ``asked`` about, (n_asked, 3), and those that
    nothing speaks against, (n_sure, 3), from which the photos learn. How wide the wood is that they
    lie on nobody knows yet.
    """
    if not len(sure):
        return np.zeros(len(asked))
    known, is_sure, there, away = _look_beside(photos, sure, seed)
    learnt = shares(there, away)
    weight = weigh(words(known, learnt), is_sure, ~is_sure)
    return summed(words(look(photos, asked, np.zeros(len(asked))), learnt), weight)


def words_of_clear_sky(photos: ScanPhotos, sure: np.ndarray, *, seed: int = 0) -> np.ndarray:
    """What each photo says of wood where it shows clear sky, see `clear_words`, (n_photos,)."""
    if not len(sure):
        return np.zeros(len(photos.poses))
    return clear_words(*_look_beside(photos, sure, seed)[2:])


def _look_beside(
    photos: ScanPhotos, sure: np.ndarray, seed: int
) -> tuple[Seen, np.ndarray, np.ndarray, np.ndarray]:
    """Look at points of a cloud and beside them.

    Returns what is seen, which of these places are such points, and how often what is shown at
    them and beside them, see `count`.
    """
    rng = np.random.default_rng(seed)
    if len(sure) > MOST_SURE:
        sure = sure[np.sort(rng.choice(len(sure), MOST_SURE, replace=False))]
    distance = np.linalg.norm(photos.poses.centers - np.median(sure, axis=0), axis=1)
    pixel = float(np.median(distance / photos.poses.K[:, 0, 0]))
    aside, _ = beside(sure, np.zeros(len(sure)), pixel, rng)
    both = np.vstack([sure, aside])
    seen, is_sure = look(photos, both, np.zeros(len(both))), np.arange(len(both)) < len(sure)
    there, away = (count(seen, each.astype(float)) for each in (is_sure, ~is_sure))
    return seen, is_sure, there, away


def weigh(told: np.ndarray, wood: np.ndarray, none: np.ndarray) -> float:
    """How much each photo's word counts in their sum, from words on places that are known.

    Photos beside one another see the same twigs before and behind a place, and a map that misses a
    twig is seldom alone: their words are no independent ones. The weight is the slope of a logistic
    regression of wood on the sum, without a constant: no word is no knowledge (Platt 1999). It lies
    between 0, where no place is known of one kind, and 1, as of independent photos. The words are
    (n_photos, n_places); ``wood`` and ``none`` (n_places,) say how sure there is wood at each
    place, and how sure there is none.
    """
    if not (wood.any() and none.any()):
        return 0.0
    total = told.sum(axis=0, dtype=np.float64)

    def log_loss(weight: float) -> float:
        of_wood = np.average(np.logaddexp(0.0, -weight * total), weights=wood)
        return float(of_wood + np.average(np.logaddexp(0.0, weight * total), weights=none))

    return float(minimize_scalar(log_loss, bounds=(0.0, 1.0), method="bounded").x)


def summed(told: np.ndarray, weight: float) -> np.ndarray:
    """Sum of the photos' words on places, (n_places,) float64."""
    return bounded(weight * told.sum(axis=0, dtype=np.float64))


def carried(parent: np.ndarray, told: np.ndarray, weight: float) -> np.ndarray:
    """Probabilities that the places of a tree are wood, (n_places,) float64."""
    change = np.full(len(parent), 1.0 - np.exp(-1.0 / RUN_STEPS))
    return _along(parent, change, summed(told, weight), PRIOR)


@compiled
def _along(parent: np.ndarray, change: np.ndarray, told: np.ndarray, prior: float) -> np.ndarray:
    """Probabilities of a tree of two states whose change along an edge has a probability.

    The sum-product algorithm (Pearl 1988), from the tips to the root and back; ``told`` holds the
    logarithm of the likelihood ratio of each place.
    """
    n = len(parent)
    up = np.exp(told)  # likelihood ratio of all that lies at and beyond a place
    sent = np.ones(n)  # the same as its parent sees it
    for i in range(n - 1, -1, -1):
        there = 1.0 - change[i] * (1.0 - prior)  # of the place, where the parent is there
        not_there = change[i] * prior  # where it is not
        sent[i] = (there * up[i] + 1.0 - there) / (not_there * up[i] + 1.0 - not_there)
        if parent[i] >= 0:
            up[parent[i]] = min(max(up[parent[i]] * sent[i], 1e-30), 1e30)
    found = np.empty(n)
    for i in range(n):
        if parent[i] < 0:
            before = prior / (1.0 - prior)
        else:
            # what the parent knows but for what this place told it
            odds = found[parent[i]] / (1.0 - found[parent[i]]) / sent[i]
            share = odds / (1.0 + odds)
            there = share * (1.0 - change[i] * (1.0 - prior)) + (1.0 - share) * change[i] * prior
            before = there / (1.0 - there)
        odds = before * up[i]
        found[i] = min(max(odds / (1.0 + odds), 1e-12), 1.0 - 1e-12)
    return found
