"""What is not there: places of a skeleton at which the photos show nothing but sky.

Sky lies behind everything, so whatever stands between, a photo that shows clear sky at a place says
that no wood is there; a photo that shows something with sky beside it says that wood may be. The
rest, with hills or other wood behind, says nothing. What is clear sky the denoising knows
(`cherrypicker.denoising.evidence`).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np
from scipy.ndimage import percentile_filter

from cherrypicker.denoising.evidence import CLEAR, SKY_REACH, EvidenceOptions, photo_evidence
from cherrypicker.mvs.clear_sky import SkyMasks
from cherrypicker.photo_check.places import MetricWorkspace, Places
from cherrypicker.photos import read_photo
from cherrypicker.poses import Poses
from cherrypicker.progress import Progress

# The undistorted photos are asked at their own size
AS_THEY_ARE = EvidenceOptions(max_image_size_px=0)

# A place is refuted where sky alone lies this near, px: what poses and the middle of a tube may be
# off. On two scenes with truth no place inside of wood was refuted by any photo; at half of it one
# in a thousand was
MARGIN_PX = 1.0
# The places that a place is asked against, a share of all, those whose radii are most like its own;
# and the percentile of them that tells how many photos show clear sky at wood that is there. With
# both, twigs that swayed by 3 to 12 mm from photo to photo cost 0.2 % of recall at most on three
# scenes, at the median 2.1 %; in still scans either is 0
ALIKE, USUAL = 0.5, 75
# Standard deviations beyond which more photos are no chance
BY_CHANCE = 3.0


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


class Shown(NamedTuple):
    """What a photo shows, each ndarray of shape (height, width), bool.

    Attributes
    ----------
    clear : ndarray
        Clear sky.
    hidden : ndarray
        What a user's mask hides.
    """

    clear: np.ndarray
    hidden: np.ndarray


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


def stands_out(votes: Votes, radius: np.ndarray, least_photos: int) -> np.ndarray:
    """Say which places are refuted beyond what moves the whole tree in single photos.

    In wind, or where poses are off, photos show clear sky at wood that is there, the thinner the
    more often. So a place is asked against those of like radius: more photos must show clear sky
    than at three quarters of them, and more than chance adds. In a still scan that is none, and the
    rule is that of `judge`.

    Parameters
    ----------
    votes : Votes
    radius : ndarray of shape (n_places,), float64
    least_photos : int
        Photos that must show clear sky.

    Returns
    -------
    ndarray of shape (n_places,), bool
    """
    n_clear = votes.clear.sum(axis=0)
    n_asked = n_clear + votes.solid.sum(axis=0)
    rows = np.flatnonzero(n_asked >= least_photos)
    rows = rows[np.argsort(radius[rows], kind="stable")]
    usual = np.zeros(len(radius))
    if len(rows):
        share = n_clear[rows] / n_asked[rows]
        usual[rows] = percentile_filter(share, USUAL, int(ALIKE * len(rows)) | 1, mode="reflect")
    chance = BY_CHANCE * np.sqrt(n_asked * usual * (1 - usual))
    return (n_clear >= least_photos) & (n_clear > n_asked * usual + chance)


def clear_skies(
    workspace: MetricWorkspace, masks: SkyMasks
) -> Iterator[tuple[int, np.ndarray, Shown]]:
    """Yield the row of each photo, the photo (height, width, 3) and what of it is to be asked."""
    with Progress(len(workspace.views), "photos asked about the skeleton") as bar:
        for i, view in enumerate(workspace.views):
            photo = read_photo(workspace.photo_path(view))
            sky, hidden = masks.both(view)
            yield i, photo, Shown(photo_evidence(photo, sky, AS_THEY_ARE)[0] == CLEAR, hidden)
            bar.step()


def vote(shown: Shown, poses: Poses, i: int, places: Places) -> tuple:
    """Ask photo ``i``, which shows ``shown``, about every place that its user does not hide.

    Returns
    -------
    clear, solid : ndarray of shape (n_places,), bool
        A row of `Votes`.
    """
    pixels = shown.clear.astype(np.uint8)
    to_solid = cv2.distanceTransform(pixels, cv2.DIST_L2, 5)
    to_clear = cv2.distanceTransform(1 - pixels, cv2.DIST_L2, 5)
    uv, depth = poses.project(places.points, i)
    framed = (depth > 0) & ((uv >= 0) & (uv < pixels.shape[::-1])).all(axis=1)
    framed[framed] = ~shown.hidden[tuple(uv[framed].astype(int).T[::-1])]
    x, y = uv[framed].astype(int).T
    radius = places.radius[framed] * poses.K[i, 0, 0] / depth[framed]
    clear, solid = np.zeros((2, len(framed)), dtype=bool)
    clear[framed] = to_solid[y, x] > MARGIN_PX
    solid[framed] = ~clear[framed] & (to_clear[y, x] <= radius + SKY_REACH)
    return clear, solid
