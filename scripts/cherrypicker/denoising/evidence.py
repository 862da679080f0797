"""What the photos say about single points of a cloud: sky seen through them, or something there.

A point that stereo put beside a branch bears the sky's colour, and so does a point on a twig that
is thinner than a pixel. Their colour does not tell them apart, their place does: a twig covers
every photo's line of sight to within the cloud's error, which is about a pixel of the depth maps,
while the sky shows clear through a point beside it in all photos but those that look along it. So
sky counts against a point only with nothing else within that pixel.

Nor does the mask decide alone, since masks lose twigs: a thin dark structure that the photo itself
shows is no clear sky, whatever its mask says.

Most photos look past a branch at the ground and say nothing: their pixel is no sky, whether the
branch is there or not. They would outvote the few that look up. So a photo that shows no sky at a
point counts only where it could have shown some, with sky a few pixels aside.

None of this is in the paper, whose sky filter goes by colour alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from cherrypicker.poses import Poses
from cherrypicker.progress import Progress

#: Photos are asked at so many times the size of the depth maps, where they are that large: points
#: are about that much more exact than a pixel of theirs.
DETAIL = 1.5
#: A photo could show sky at a pixel when it has sky this near, pixels.
SKY_REACH = 6
#: A pixel of a reduced photo is sky when its mask says so for this share of it.
SKY_SHARE = 0.75
#: Widest structure that counts as thin, and how far one structure drowns fainter ones, pixels.
THIN_WIDTH, THIN_REACH = 10, 4
#: The sky around a pixel is what lies this near, pixels.
SKY_AROUND = 32
#: A pixel belongs to a thin structure from this share of the strongest contrast around it: less is
#: the blur beside a twig.
THIN_SHARE = 0.5
#: Contrast of thin structures over that of most of the sky, which is noise.
NOISE_RATIO = 2.0

#: What a photo shows at a pixel: no sky near, clear sky, or something with sky near.
AWAY, CLEAR, SOLID = 0, 1, 2


@dataclass(frozen=True)
class SkyEvidence:
    """How the photos see some points."""

    n_clear: np.ndarray  # (n,) int32: photos that show clear sky where the point should be
    n_solid: np.ndarray  # (n,) int32: photos that show something there, though sky is near


@dataclass(frozen=True)
class EvidenceOptions:
    """Settings of `sky_evidence`: config keys of ``denoise``, and the depth maps' size of ``mvs``.

    Photos are reduced to `DETAIL` times the size of the depth maps (0: photos as they are); the
    clearance is in pixels of that size.
    """

    max_image_size_px: int = 1600
    sky_clearance_px: int = 1
    twig_contrast: float = 0.05


def _square(reach: int) -> np.ndarray:
    return np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)


def _mean_sky(blue: np.ndarray, clear: np.ndarray) -> np.ndarray:
    """Blue of the sky around each pixel, (H, W) uint8; white where there is none."""
    size = (2 * SKY_AROUND + 1, 2 * SKY_AROUND + 1)
    share = cv2.blur(clear.astype(np.float32), size)
    total = cv2.blur(np.where(clear, blue, 0).astype(np.float32), size)
    mean = total / np.maximum(share, 1e-6)
    return np.where(share > 0.01, np.rint(mean), 255).astype(np.uint8)


def thin_structures(image: np.ndarray, clear: np.ndarray, contrast: float) -> np.ndarray:
    """Find what is thin and stands out of its surroundings in blue, to a pixel, (H, W) bool.

    It is darker than what surrounds it, or brighter than that and the sky. Wood and sky differ most
    in blue.

    Parameters
    ----------
    image : ndarray of shape (H, W, 3), uint8
    clear : ndarray of shape (H, W), bool
        Sky by the mask, from which the noise is learnt.
    contrast : float
        Least contrast, a share of the full range.
    """
    blue = np.ascontiguousarray(image[..., 2])
    window = _square(THIN_WIDTH // 2)
    depth = cv2.morphologyEx(blue, cv2.MORPH_BLACKHAT, window)
    # A gap between twigs is as bright as the sky around it, lichen before a low sun is brighter.
    others = cv2.max(cv2.morphologyEx(blue, cv2.MORPH_OPEN, window), _mean_sky(blue, clear))
    depth = cv2.max(depth, cv2.subtract(blue, others))
    near = cv2.dilate(depth, _square(1))
    # Most of the sky shows no twig, even where the mask took all twigs for sky.
    noise = float(np.median(near[clear])) if clear.any() else 0.0
    least = max(255 * contrast, NOISE_RATIO * noise)
    around = cv2.dilate(depth, _square(THIN_REACH))
    return (near >= least) & (near >= THIN_SHARE * around)


def photo_evidence(
    image: np.ndarray, sky: np.ndarray, options: EvidenceOptions
) -> tuple[np.ndarray, np.ndarray]:
    """Say of every pixel of a photo whether it shows clear sky or something before the sky.

    Parameters
    ----------
    image : ndarray of shape (H, W, 3), uint8
    sky : ndarray of shape (H, W), bool

    Returns
    -------
    kind : ndarray of shape (h, w), uint8
        `AWAY`, `CLEAR` or `SOLID`; at most `DETAIL` times ``max_image_size_px`` on the longer side.
    image : ndarray of shape (h, w, 3), uint8
        The photo at that size.
    """
    scale = round(DETAIL * options.max_image_size_px) / max(sky.shape)
    if 0 < scale < 1:
        size = (max(1, round(sky.shape[1] * scale)), max(1, round(sky.shape[0] * scale)))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        share = cv2.resize(sky.astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA)
        sky = share >= 255 * SKY_SHARE
    is_sky = sky.astype(np.uint8)
    clear = cv2.erode(is_sky, _square(options.sky_clearance_px)) > 0
    if options.twig_contrast > 0 and clear.any():
        clear &= ~thin_structures(image, clear, options.twig_contrast)
    kind = np.where(cv2.dilate(is_sky, _square(SKY_REACH)) > 0, SOLID, AWAY).astype(np.uint8)
    kind[clear] = CLEAR
    return kind, image


def sky_evidence(
    asked: np.ndarray,
    poses: Poses,
    to_photo: Callable[[int, np.ndarray], np.ndarray],
    look: Callable[[int], tuple[np.ndarray, np.ndarray, np.ndarray]],
    options: EvidenceOptions,
) -> SkyEvidence:
    """Ask all photos about some points.

    Parameters
    ----------
    asked : ndarray of shape (n, 3), float64
    poses : Poses
        In the cloud's frame; undistorted pinhole.
    to_photo : callable
        ``to_photo(i, in_camera)`` projects camera coordinates (m, 3) to the pixels (m, 2) of the
        photo as stored, lens distortion included.
    look : callable
        ``look(i)`` returns the photo, (H, W, 3) uint8, its sky mask and what a user hides of it,
        each (H, W) bool.
    """
    counts = np.zeros((2, len(asked)), np.int32)
    with Progress(len(poses), "photos asked about sky silhouettes") as bar:
        for i in range(len(poses)):
            pixels, depth = poses.project(asked, i)
            size = np.array([poses.width[i], poses.height[i]])
            rows = np.flatnonzero((depth > 0) & ((pixels >= 0) & (pixels < size)).all(axis=1))
            if len(rows):
                photo, sky, hidden = look(i)
                uv = to_photo(i, asked[rows] @ poses.rotations[i].T + poses.cam_from_world[i, :, 3])
                with np.errstate(invalid="ignore"):
                    within = np.logical_and(uv >= 0, uv < np.array(sky.shape[::-1]))
                inside: np.ndarray = np.asarray(within.all(axis=1))
                column, line = np.where(inside[:, None], uv, 0).astype(np.int64).T
                inside = inside & ~hidden[line, column]
                kind, _ = photo_evidence(photo, sky, options)
                ratio = np.divide(kind.shape[::-1], sky.shape[::-1])
                column, line = (uv[inside] * ratio).astype(np.int64).T
                counts[0, rows[inside]] += kind[line, column] == CLEAR
                counts[1, rows[inside]] += kind[line, column] == SOLID
            bar.step()
    return SkyEvidence(*counts)
