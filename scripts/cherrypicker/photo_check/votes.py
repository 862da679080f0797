"""What is not there: places of a skeleton at which the photos show nothing but sky.

Sky lies behind everything, so whatever stands between, a photo that shows clear sky at a place says
that no wood is there; a photo that shows something with sky beside it says that wood may be. The
rest, with hills or other wood behind, says nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from cherrypicker.mvs.lines.lines import CLEAR, Lines
from cherrypicker.photo_check.places import Places
from cherrypicker.poses import Poses

# Sky this near a tube's edge, px, could have been seen had the tube not been there
SKY_REACH_PX = 6.0


class Votes(NamedTuple):
    """What photos say of places, each ndarray of shape (n_photos, n_places), bool.

    Attributes
    ----------
    framed : ndarray
        The photo frames the place.
    clear : ndarray
        Nothing but sky lies within the tube's radius of the place.
    solid : ndarray
        Something does, and sky lies beside it.
    """

    framed: np.ndarray
    clear: np.ndarray
    solid: np.ndarray


class Verdict(NamedTuple):
    """What all photos say of places, each ndarray of shape (n_places,), bool.

    Attributes
    ----------
    is_judged : ndarray
        Enough photos have a say.
    is_refuted : ndarray
        They say that nothing is there.
    """

    is_judged: np.ndarray
    is_refuted: np.ndarray


def judge(votes: Votes, least_photos: int, most_clear_share: float) -> Verdict:
    """Say which places the photos can judge, and which of them are not there.

    Parameters
    ----------
    votes : Votes
    least_photos : int
        Photos that must have a say, and that must show clear sky to refute a place.
    most_clear_share : float
        Share of the photos with a say that may show clear sky where wood is.
    """
    n_clear, n_solid = votes.clear.sum(axis=0), votes.solid.sum(axis=0)
    n_say = n_clear + n_solid
    is_refuted = (n_clear >= least_photos) & (n_clear > most_clear_share * n_say)
    return Verdict(n_say >= least_photos, is_refuted)


def ask_photos(lines: Lines, poses: Poses, places: Places) -> Votes:
    """Ask every photo about every place."""
    votes = Votes(*(np.zeros((len(poses), len(places.points)), dtype=bool) for _ in range(3)))
    for i in range(len(poses)):
        is_clear = clear_pixels(lines, i).astype(np.uint8)
        to_solid = cv2.distanceTransform(is_clear, cv2.DIST_L2, 5)
        to_clear = cv2.distanceTransform(1 - is_clear, cv2.DIST_L2, 5)
        uv, depth = poses.project(places.points, i)
        size = is_clear.shape[::-1]
        rows = np.flatnonzero((depth > 0) & ((uv >= 0) & (uv < size)).all(axis=1))
        x, y = uv[rows].astype(int).T
        radius = places.radius[rows] * poses.K[i, 0, 0] / depth[rows]
        clear = to_solid[y, x] > radius
        votes.framed[i, rows] = True
        votes.clear[i, rows] = clear
        votes.solid[i, rows] = ~clear & (to_clear[y, x] <= radius + SKY_REACH_PX)
    return votes


def clear_pixels(lines: Lines, i: int) -> np.ndarray:
    """Return where photo ``i`` shows nothing but sky, (height, width) bool."""
    width, height = lines.sizes[i]
    maps = lines.maps[lines.starts[i] : lines.starts[i] + width * height]
    return maps.reshape(height, width) == CLEAR
