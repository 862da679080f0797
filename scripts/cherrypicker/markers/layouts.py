"""Points of a known layout in space: located from the photos, and the scale that they give.

Two markers' centres, the corners of a ChArUco board, the corners on the faces of a checker cube:
each is a set of points whose distances are known. Each point is where its rays meet (paper, section
Scale Factor Estimator, eq. objective), and the scale is that of the similarity that brings the
located points onto the layout (Umeyama, TPAMI 1991). Its standard error is the jackknife's over
photos, since all points of a photo share the error of its pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cherrypicker.geometry.similarity import best_turn
from cherrypicker.markers.sightings import PosedSightings

_N_ROUNDS = 5  # of locating the points and asking again which sightings agree (guess)
FEWEST_PHOTOS = 3  # that the jackknife over photos needs to tell an error


@dataclass(kw_only=True)
class Sightings(PosedSightings):
    """Sightings of single points."""

    points: np.ndarray  # (n,) int: row of the layout
    places: np.ndarray  # (n, 2): normalised undistorted camera coordinates

    @property
    def rays(self) -> np.ndarray:
        """Unit directions in the world, (n, 3)."""
        return self.rays_through(self.places[:, None])[:, 0]

    def errors_px(self, located: np.ndarray) -> np.ndarray:
        """Reprojection error of points (n_points, 3), px, (n,); NaN for a point that has none."""
        at = located[self.points]
        seen = np.einsum("nij,nj->ni", self.cam_from_world[:, :, :3], at)
        seen += self.cam_from_world[:, :, 3]
        with np.errstate(invalid="ignore", divide="ignore"):
            off = np.linalg.norm(seen[:, :2] / seen[:, 2:] - self.places, axis=1) * self.focal
        return np.where(seen[:, 2] > 0, off, np.where(np.isnan(off), np.nan, np.inf))


@dataclass
class LayoutScale:
    """What a layout says about the scale."""

    scale: float  # of the layout's unit a model unit
    error: float  # relative standard error, by the jackknife over photos
    inliers: np.ndarray  # (n,) bool: sightings that agree
    located: np.ndarray  # (n_points, 3): NaN where fewer than two photos agree
    misfit: float  # root mean square distance of the points from the layout, of its extent
    rms_px: float  # root mean square reprojection error


def scale_of_layout(
    sightings: Sightings, layout: np.ndarray, parts: np.ndarray, *, max_error_px: float
) -> LayoutScale | None:
    """Scale of points of known layout.

    Parameters
    ----------
    layout : ndarray of shape (n_points, 3), float64
        Places of the points in any frame, of known unit.
    parts : ndarray of shape (n_points,), int
        Points of one part lie as `layout` says; how parts lie to one another is not known.
    max_error_px : float
        Largest reprojection error of a sighting that agrees.

    Returns
    -------
    LayoutScale or None
        None where fewer than two points are located, or fewer than three photos used.
    """
    inliers = np.ones(len(sightings), bool)
    for _ in range(_N_ROUNDS):
        matrices, rights = _normals(sightings, inliers, len(layout))
        located = _solved(matrices.sum(axis=0), rights.sum(axis=0))
        with np.errstate(invalid="ignore"):
            agree = sightings.errors_px(located) <= max_error_px
        if (agree == inliers).all():
            break
        inliers = agree
    fitted = scale_and_misfit(located, layout, parts)
    photos = np.unique(sightings.photos[inliers])
    if fitted is None or len(photos) < FEWEST_PHOTOS:
        return None
    scale, misfit = fitted
    used = sightings.select(inliers)
    left_out = []
    for photo in range(len(matrices)):
        if not (used.photos == photo).any():
            continue
        rest = _solved(matrices.sum(axis=0) - matrices[photo], rights.sum(axis=0) - rights[photo])
        fitted = scale_and_misfit(rest, layout, parts)
        if fitted is not None:
            left_out.append(np.log(fitted[0] / scale))
    n = len(left_out)
    is_known = n >= FEWEST_PHOTOS
    error = np.sqrt((n - 1) / n * np.sum(np.square(left_out))) if is_known else np.inf
    rms = float(np.sqrt(np.mean(np.square(used.errors_px(located)))))
    return LayoutScale(scale, float(error), inliers, located, misfit, rms)


def _normals(
    sightings: Sightings, kept: np.ndarray, n_points: int
) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of each point by photo: (n_photos, n_points, 3, 3) and (..., 3).

    Rays count by the inverse square of their camera's distance from the scene's middle, which
    stands for equal pixels.
    """
    rays, centers = sightings.rays, sightings.centers
    projectors = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    middle = np.linalg.lstsq(
        projectors.reshape(-1, 3), np.einsum("nij,nj->ni", projectors, centers).ravel(), rcond=None
    )[0]
    weight = kept * (sightings.focal / np.linalg.norm(centers - middle, axis=1)) ** 2
    projectors *= (weight / max(weight.max(), 1e-300))[:, None, None]
    shape = (int(sightings.photos.max()) + 1, n_points, 3)
    matrices, rights = np.zeros((*shape, 3)), np.zeros(shape)
    at = sightings.photos, sightings.points
    np.add.at(matrices, at, projectors)
    np.add.at(rights, at, np.einsum("nij,nj->ni", projectors, centers))
    return matrices, rights


def _solved(matrices: np.ndarray, rights: np.ndarray) -> np.ndarray:
    """Points (n, 3) of their normal equations, NaN where the rays leave them open."""
    size = np.trace(matrices, axis1=1, axis2=2)
    open_ = np.linalg.det(matrices / np.where(size > 0, size, 1.0)[:, None, None]) < 1e-9
    matrices = np.where(open_[:, None, None], np.eye(3), matrices)
    points = np.linalg.solve(matrices, rights[..., None])[..., 0]
    return np.where(open_[:, None], np.nan, points)


def scale_and_misfit(
    located: np.ndarray, layout: np.ndarray, parts: np.ndarray
) -> tuple[float, float] | None:
    """Scale from the located points to the layout, and what is left, of the layout's extent."""
    above, below, left, extent = 0.0, 0.0, 0.0, 0.0
    for part in np.unique(parts):
        rows = (parts == part) & np.isfinite(located).all(axis=1)
        if rows.sum() < 2:
            continue
        source, target = located[rows], layout[rows]
        source, target = source - source.mean(axis=0), target - target.mean(axis=0)
        above += best_turn(target.T @ source)[1]
        below += float(np.square(source).sum())
        extent += float(np.square(target).sum())
    if below <= 0 or above <= 0:
        return None
    scale = above / below
    left = max(extent - above**2 / below, 0.0)
    return scale, float(np.sqrt(left / extent))
