"""What is not there: places of a skeleton at which the photos show nothing but sky.

Sky lies behind everything, so whatever stands between, a photo that shows clear sky at a place says
that no wood is there; a photo that shows something with sky beside it says that wood may be. The
rest, with hills or other wood behind, says nothing. What is clear sky the denoising knows
(`cherrypicker.denoising.evidence`).
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from cherrypicker.denoising.evidence import SKY_REACH
from cherrypicker.photo_check.places import Places
from cherrypicker.poses import Poses

# A place is refuted where sky alone lies this near, px: what poses and the middle of a tube may be
# off. On two scenes with truth no place inside of wood was refuted by any photo; at half of it one
# in a thousand was
MARGIN_PX = 1.0


class Votes(NamedTuple):
    """What photos say of places, each ndarray of shape (n_photos, n_places), bool.

    Attributes
    ----------
    clear : ndarray
        Nothing but sky lies about the place.
    solid : ndarray
        Something does, and sky lies beside the tube.
    """

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


def judge(votes: Votes, least_photos: int) -> Verdict:
    """Say which places the photos can judge, and which of them are not there.

    Parameters
    ----------
    votes : Votes
    least_photos : int
        Photos that must have a say, and that must show clear sky to refute a place.
    """
    n_clear, n_solid = votes.clear.sum(axis=0), votes.solid.sum(axis=0)
    return Verdict(n_clear + n_solid >= least_photos, n_clear >= least_photos)


def vote(is_clear: np.ndarray, poses: Poses, i: int, places: Places) -> tuple:
    """Ask photo ``i``, whose clear sky is ``is_clear`` (height, width), about every place.

    Returns
    -------
    clear, solid : ndarray of shape (n_places,), bool
        A row of `Votes`.
    """
    pixels = is_clear.astype(np.uint8)
    to_solid = cv2.distanceTransform(pixels, cv2.DIST_L2, 5)
    to_clear = cv2.distanceTransform(1 - pixels, cv2.DIST_L2, 5)
    uv, depth = poses.project(places.points, i)
    framed = (depth > 0) & ((uv >= 0) & (uv < pixels.shape[::-1])).all(axis=1)
    x, y = uv[framed].astype(int).T
    radius = places.radius[framed] * poses.K[i, 0, 0] / depth[framed]
    clear, solid = np.zeros((2, len(framed)), dtype=bool)
    clear[framed] = to_solid[y, x] > MARGIN_PX
    solid[framed] = ~clear[framed] & (to_clear[y, x] <= radius + SKY_REACH)
    return clear, solid
