"""The naive floor: OpenCV's semi-global matching on rectified pairs of photos.

Each reference is matched with its best sources one at a time (the same plan of views as the
PatchMatch backend), disparities become depths in the reference's pixels, a second pair fills what
the first left open. Depth and normal maps are written as COLMAP lays them out, so that the same
fusion with the same options makes the cloud.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import cv2
import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.mvs.backends.map_keys import GEOMETRIC
from cherrypicker.mvs.clear_sky import SkyMasks, clear_sky
from cherrypicker.mvs.estimate import StereoOptions, field_to_maps
from cherrypicker.mvs.views import StereoProblem, plan_views
from cherrypicker.mvs.workspace import View, Workspace
from cherrypicker.photos import read_photo
from cherrypicker.progress import Progress

logger = logging.getLogger(__name__)

# OpenCV keeps sixteenths of a disparity in 16 bits
_MAX_DISPARITIES = 1600
_SUBPIXELS = 16
# Neighbours whose inverse depths differ by less, relatively, lie on one surface
_SAME_SURFACE = 0.01
_NORMAL_RADIUS = 2
# A rectified photo whose corner is turned further off (cosine) grows out of bounds
_LEAST_FORWARD = 0.3


@dataclass(frozen=True)
class SgbmOptions:
    """Semi-global matching as OpenCV's samples set it up.

    Attributes
    ----------
    n_pairs : int
        Sources that are matched, the best first.
    block_size : int
        Side of the matched block, px.
    max_difference : int
        Left-right check: largest difference of the two disparities, px.
    uniqueness : int
        By how much (%) the best cost must win.
    speckle_size, speckle_range : int
        Regions of fewer pixels whose disparities differ by less are removed.
    """

    n_pairs: int = 2
    block_size: int = 5
    max_difference: int = 1
    uniqueness: int = 10
    speckle_size: int = 60
    speckle_range: int = 2


@dataclass(frozen=True)
class RectifiedPair:
    """Two virtual cameras side by side: rows are epipolar lines, the reference is the left one."""

    rotation: np.ndarray  # (3, 3): virtual cameras from world
    # K_left, K_right: (3, 3): intrinsics, pixel centres at (0.5, 0.5); they differ in the principal
    # point only
    K_left: np.ndarray
    K_right: np.ndarray
    baseline: float  # distance of the centres, units of the model
    # width, height: size of both, px; the first ``n_disparities`` columns are there for the search
    # alone
    width: int
    height: int
    n_disparities: int  # range of the search, a multiple of 16
    shift: float  # disparity of the search's zero, px: depth = f * baseline / (disparity + shift)

    def from_view(self, view: View, K: np.ndarray) -> np.ndarray:
        """Homography of pixel indices, (3, 3): virtual camera from a view at its centre."""
        half = np.array([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1.0]])
        H = K @ self.rotation @ view.R.T @ np.linalg.inv(view.K)
        return np.linalg.inv(half) @ H @ half


def rectify(left: View, right: View, depth_min: float, depth_max: float) -> RectifiedPair:
    """Turn two views about their centres until the rows of both are epipolar lines.

    The x axis is the baseline, from left to right view, whatever its direction in the photos: pairs
    above one another end up turned by a right angle, which the matcher does not mind (Fusiello et
    al. 2000). Where the disparities would not fit into OpenCV's numbers, the virtual cameras get a
    shorter focal length.

    Parameters
    ----------
    depth_min, depth_max : float
        Depths in the left view, units of the model.

    Raises
    ------
    StageError
        If one camera stands in the other's line of sight, or they look in too different directions.
    """
    x = right.center - left.center
    baseline = float(np.linalg.norm(x))
    forward = left.R[2] + right.R[2]
    x = x / max(baseline, 1e-12)
    z = forward - (forward @ x) * x
    if baseline < 1e-9 or np.linalg.norm(z) < 0.5 * np.linalg.norm(forward):
        raise StageError(f"{left.name} and {right.name} stand behind one another")
    z /= np.linalg.norm(z)
    rotation = np.stack([x, np.cross(z, x), z])
    corners = np.array([[0.0, 0], [left.width, 0], [left.width, left.height], [0, left.height]])
    rays = np.c_[corners, np.ones(4)] @ np.linalg.inv(left.K).T @ left.R @ rotation.T
    if (rays[:, 2] < _LEAST_FORWARD * np.linalg.norm(rays, axis=1)).any():
        raise StageError(f"{left.name} and {right.name} look in too different directions")
    # depths along the virtual axis of what the reference sees between its nearest and farthest
    depths = np.outer([depth_min, depth_max], rays[:, 2])
    span = baseline * (1.0 / depths.min() - 1.0 / depths.max())
    focal = min(0.5 * (left.K[0, 0] + right.K[0, 0]), _MAX_DISPARITIES / span)
    least = focal * baseline / depths.max()
    n = int(np.ceil(focal * span / _SUBPIXELS) + 1) * _SUBPIXELS
    corners = focal * rays[:, :2] / rays[:, 2:]
    low, high = np.floor(corners.min(axis=0)), np.ceil(corners.max(axis=0))
    K = np.diag([focal, focal, 1.0])
    K[:2, 2] = [n - low[0], -low[1]]
    K_right = K.copy()
    K_right[0, 2] += least
    width, height = (high - low).astype(int)
    return RectifiedPair(rotation, K, K_right, baseline, int(width) + n, int(height), n, least)


def match_pair(
    pair: RectifiedPair, left: View, right: View, photos: tuple, options: SgbmOptions
) -> np.ndarray:
    """Match a pair.

    Parameters
    ----------
    photos : tuple of ndarray of shape (height, width), uint8
        Grey photos of left and right view.

    Returns
    -------
    ndarray of shape (pair.height, pair.width), float32
        Inverse depth along the virtual axis, NaN where there is none.
    """
    size, margin = (pair.width, pair.height), options.block_size
    warped, framed = [], []
    for view, photo, K in ((left, photos[0], pair.K_left), (right, photos[1], pair.K_right)):
        H = pair.from_view(view, K)
        warped.append(cv2.warpPerspective(photo, H, size, flags=cv2.INTER_CUBIC))
        # blocks across a photo's border match the border
        inner = np.zeros_like(photo)
        inner[margin:-margin, margin:-margin] = 1
        framed.append(cv2.warpPerspective(inner, H, size, flags=cv2.INTER_NEAREST) > 0)
    matcher = cv2.StereoSGBM_create(
        minDisparity=0,
        numDisparities=pair.n_disparities,
        blockSize=options.block_size,
        P1=8 * options.block_size**2,
        P2=32 * options.block_size**2,
        disp12MaxDiff=options.max_difference,
        uniquenessRatio=options.uniqueness,
        speckleWindowSize=options.speckle_size,
        speckleRange=options.speckle_range,
        preFilterCap=31,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    disparity = matcher.compute(*warped).astype(np.float32) / _SUBPIXELS
    known = (disparity >= 0.0) & framed[0]
    row, column = np.nonzero(known)
    matched = np.rint(column - disparity[known]).astype(int)
    known[row, column] = framed[1][row, np.clip(matched, 0, pair.width - 1)] & (matched >= 0)
    inverse = (disparity + np.float32(pair.shift)) / np.float32(pair.K_left[0, 0] * pair.baseline)
    return np.where(known & (inverse > 0.0), inverse, np.float32(np.nan))


def to_reference(pair: RectifiedPair, view: View, inverse: np.ndarray) -> np.ndarray:
    """Turn inverse depths of a pair into inverse depths in the reference's pixels.

    Interpolated where all four pixels around lie on one surface, else taken from the nearest.

    Returns
    -------
    ndarray of shape (view.height, view.width), float32
        0 where unknown.
    """
    H = pair.from_view(view, pair.K_left)
    flags = cv2.WARP_INVERSE_MAP | cv2.INTER_NEAREST
    size = (view.width, view.height)
    nearest = cv2.warpPerspective(inverse, H, size, flags=flags, borderValue=np.nan)
    linear = cv2.warpPerspective(
        inverse, H, size, flags=cv2.WARP_INVERSE_MAP | cv2.INTER_LINEAR, borderValue=np.nan
    )
    with np.errstate(invalid="ignore"):
        smooth = np.abs(linear - nearest) < _SAME_SURFACE * nearest
    along = np.where(smooth, linear, nearest)
    x, y = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    axis = pair.rotation[2] @ view.R.T @ np.linalg.inv(view.K)  # depth along it per depth in view
    result = along * (axis[0] * x + axis[1] * y + axis[2]).astype(np.float32)
    return np.where(np.isfinite(result) & (result > 0.0), result, np.float32(0.0))


def slopes(inverse: np.ndarray) -> np.ndarray:
    """Fit a plane around every pixel, over the neighbours on its surface.

    Parameters
    ----------
    inverse : ndarray of shape (height, width), float32
        Inverse depth, 0 where unknown; planes have linear inverse depth.

    Returns
    -------
    ndarray of shape (height, width, 2), float32
        Slopes along x and y per pixel; 0 where fewer than five neighbours lie on the surface.
    """
    r = _NORMAL_RADIUS
    padded = np.pad(inverse, r)
    height, width = inverse.shape
    total = np.zeros((8, height, width), dtype=np.float32)
    for dy in range(-r, r + 1):
        for dx in range(-r, r + 1):
            other = padded[r + dy : r + dy + height, r + dx : r + dx + width]
            difference = other - inverse
            weight = ((other > 0.0) & (np.abs(difference) < _SAME_SURFACE * inverse)).astype(
                np.float32
            )
            # normal equations of difference = gx dx + gy dy
            for k, term in enumerate((dx * dx, dx * dy, dy * dy)):
                total[k] += weight * term
            total[3] += weight * difference * dx
            total[4] += weight * difference * dy
            total[5] += weight
    a, b, c, u, v, n = total[:6]
    det = a * c - b * b
    good = (n >= 5) & (det > 1e-3 * np.maximum(a * c, 1e-12))
    safe = np.where(good, det, 1.0)
    gx, gy = (c * u - b * v) / safe, (a * v - b * u) / safe
    return np.where(good[..., None], np.stack([gx, gy], axis=-1), np.float32(0.0))


def run_sgbm(
    workspace: Workspace, options: StereoOptions, threads: int, sky_masks: SkyMasks | None
) -> set[str]:
    """Match every view that has a pair which can be rectified, as OpenCV's samples set it up."""
    cv2.setNumThreads(threads)
    problems, names = plan_views(workspace, options.n_sources), set()
    with Progress(len(problems), "SGBM depth maps") as bar:
        for problem in problems:
            inverse = _match_reference(workspace, problem, SgbmOptions())
            bar.step()
            if inverse is None:
                continue
            view = workspace.views[problem.view]
            if sky_masks is not None:
                photo = read_photo(workspace.photo_path(view))
                sky, hidden = sky_masks.both(view)
                inverse[clear_sky(photo, sky) | hidden] = 0.0
            field = np.dstack([inverse, slopes(inverse), np.zeros_like(inverse)])
            workspace.write_maps(view, GEOMETRIC, *field_to_maps(field, view.K))
            names.add(view.name)
    workspace.write_fusion_config()
    return names


def _match_reference(
    workspace: Workspace, problem: StereoProblem, options: SgbmOptions
) -> np.ndarray | None:
    """Inverse depth of a reference from its best pairs, None where none can be rectified."""
    view = workspace.views[problem.view]
    photo = _grey(workspace, view)
    result, n_pairs = None, 0
    for j in problem.sources:
        other = workspace.views[j]
        try:
            pair = rectify(view, other, problem.depth_min, problem.depth_max)
        except StageError as error:
            logger.info("pair left out: %s", error.cause)
            continue
        photos = (photo, _grey(workspace, other))
        found = to_reference(pair, view, match_pair(pair, view, other, photos, options))
        result = found if result is None else np.where(result > 0.0, result, found)
        n_pairs += 1
        if n_pairs == options.n_pairs:
            break
    return result


def _grey(workspace: Workspace, view: View) -> np.ndarray:
    return cv2.cvtColor(read_photo(workspace.photo_path(view)), cv2.COLOR_RGB2GRAY)
