"""Points of a known layout in space: located from the photos, and the scale that they give.

A marker is a layout of four corners, a ChArUco board one of many, a scale bar one of two centres, a
checker cube one of faces. Each point is where its rays meet (paper, section Scale Factor Estimator,
eq. objective), with rays that count by their pixels; sightings that disagree are left out. The
scale is that of the layout with the least reprojection error, whose one size is known better than
the mean of many distances between free points, above all from few photos.
"""

from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from cherrypicker.geometry.directions import unit
from cherrypicker.geometry.lines import intersect_rays
from cherrypicker.geometry.sampling import thin_randomly
from cherrypicker.geometry.similarity import best_turn
from cherrypicker.poses import camera_centers

# Pairs of photos that are tried: twice as many find no more in three scans and the tests, half of
# them miss the tests' cube
_MAX_PAIRS = 600
# What points may be off their layout, a share of its size: a sighting that agrees, corners of a
# square, a board (a wrong number of squares is off by far more)
MOST_OFF = 0.02
# The least reprojection error within which a sighting agrees, px; with 1 and 4 four scans have the
# same scale
AGREES_PX = 2.0
_N_ROUNDS = 10  # of locating the points and asking again which sightings agree
_MIN_PARALLAX_DEG = 1.0  # of a pair; with half and twice as much three scans have the same scale
_POSES_PX = 0.25  # what the poses add to a point's noise
_LEAST_VARIANCE = 0.04  # of the residuals, in their noise: few photos may agree by chance


@dataclass
class Sightings:
    """Points of one layout as photos show them: a marker, a board or a face in a photo a row."""

    photos: np.ndarray  # (n,) int: index of the photo
    cam_from_world: np.ndarray  # (n, 3, 4)
    focal: np.ndarray  # (n,): pixels per unit of normalised coordinates
    # (n, k, 2): of each point of the layout, normalised undistorted camera coordinates; NaN where
    # the row does not show it
    places: np.ndarray
    std: np.ndarray  # (n,): standard deviation of a coordinate, px
    side_px: np.ndarray  # (n,): of a marker, 0 of what has none

    def __len__(self) -> int:
        return len(self.photos)

    def select(self, index: np.ndarray) -> Self:
        """The rows of a mask or an index array."""
        return type(self)(**{each.name: getattr(self, each.name)[index] for each in fields(self)})

    @property
    def centers(self) -> np.ndarray:
        """Camera centres, (n, 3)."""
        return camera_centers(self.cam_from_world)

    @property
    def rays(self) -> np.ndarray:
        """Unit directions in the world through the places, (n, k, 3)."""
        homogeneous = np.concatenate([self.places, np.ones((*self.places.shape[:2], 1))], axis=2)
        return unit(np.einsum("nji,nkj->nki", self.cam_from_world[:, :, :3], homogeneous))

    @property
    def middles(self) -> np.ndarray:
        """Where a marker's diagonals cross, which is the square's middle from any side, (n, 2)."""
        corners = np.concatenate([self.places, np.ones((*self.places.shape[:2], 1))], axis=2)
        diagonals = np.cross(corners[:, :2], corners[:, 2:])  # (n, 2, 3): lines
        crossing = np.cross(diagonals[:, 0], diagonals[:, 1])
        return crossing[:, :2] / crossing[:, 2:]

    @property
    def noise_px(self) -> np.ndarray:
        """Noise floor of each row, px, (n,): its own, and the poses' error."""
        return np.hypot(self.std, _POSES_PX)

    @property
    def tolerance_px(self) -> np.ndarray:
        """Reprojection error within which a row agrees, px, (n,)."""
        return np.maximum(AGREES_PX, MOST_OFF * self.side_px)

    def in_cameras(self, points: np.ndarray) -> np.ndarray:
        """Points (k, 3) in each row's camera, (n, k, 3)."""
        rotation, shift = self.cam_from_world[:, :, :3], self.cam_from_world[:, :, 3]
        return np.einsum("nij,kj->nki", rotation, points) + shift[:, None]

    def residuals_px(self, points: np.ndarray) -> np.ndarray:
        """Reprojection error of points (k, 3) in each row, px, (n, k, 2)."""
        in_camera = self.in_cameras(points)
        depth = in_camera[..., 2:]
        with np.errstate(divide="ignore", invalid="ignore"):
            error = (in_camera[..., :2] / depth - self.places) * self.focal[:, None, None]
        return np.where(depth <= 0, 1e6, error)  # a point behind a camera is as wrong as can be


def meet(seen: Sightings, tolerance: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Where the rays of most rows meet that show all points, whatever outliers are among them.

    It starts from the pair of photos that most other rows agree with, to the tolerance of each,
    (n,) px, as of `locate`. The points are (k, 3), and with them come the rows that agree on all;
    None where no two photos do.
    """
    pairs = np.column_stack(np.triu_indices(len(seen), 1))
    rays, centers = seen.rays, seen.centers
    middle = unit(rays.mean(axis=1))
    cosine = np.einsum("pi,pi->p", middle[pairs[:, 0]], middle[pairs[:, 1]])
    are_two = seen.photos[pairs[:, 0]] != seen.photos[pairs[:, 1]]
    pairs = pairs[are_two & (cosine < np.cos(np.radians(_MIN_PARALLAX_DEG)))]
    pairs = thin_randomly(pairs, _MAX_PAIRS, seed)
    candidates = intersect_rays(centers[pairs][:, None], rays[pairs].transpose(0, 2, 1, 3))
    candidates = candidates[np.isfinite(candidates).all(axis=(1, 2))]
    if len(candidates) == 0:
        return None
    errors = np.array(
        [np.linalg.norm(seen.residuals_px(each), axis=-1).max(axis=-1) for each in candidates]
    )
    # Each row counts less the worse it fits, so that equal counts are told apart.
    best = np.argmax(np.clip(1 - (errors / tolerance) ** 2, 0, None).sum(axis=1))
    points, agree = locate(seen, tolerance, candidates[best])
    rows = np.flatnonzero(agree.all(axis=1))
    return (points, rows) if len(np.unique(seen.photos[rows])) > 1 else None


def locate(
    seen: Sightings, tolerance: np.ndarray, start: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Where the rays of each point meet, (k, 3), by those that agree, (n, k) bool.

    A point is NaN where the rays leave it open. A sighting agrees within a reprojection error of
    its tolerance, (n,), px. With a first guess ``start``, (k, 3), the points of a row agree all or
    none; left out, each agrees by itself, at first with where all rays meet.
    """
    origins, rays = seen.centers[None], seen.rays.transpose(1, 0, 2)  # (k, n, 3)
    points = intersect_rays(origins, rays) if start is None else start
    for _ in range(_N_ROUNDS):
        errors = np.linalg.norm(seen.residuals_px(points), axis=-1)
        agree = errors < tolerance[:, None]
        if start is not None:
            agree &= agree.all(axis=1, keepdims=True)
        away = np.linalg.norm(points - seen.centers[:, None], axis=-1)
        noise = seen.noise_px[:, None]
        weights = (seen.focal[:, None] / (np.maximum(away, 1e-12) * noise)) ** 2
        weights /= np.sqrt(1 + (errors / noise) ** 2)
        points = intersect_rays(origins, rays, np.where(agree, weights, 0.0).T)
    return points, agree


@dataclass(frozen=True)
class Similarity:
    """A layout laid over points that were located, each copy turned and shifted by itself."""

    size: float  # of the layout's unit
    misfit: float  # root mean square distance of the points from the layout, of its extent
    middles: np.ndarray  # (n_copies, 3): of the located points; NaN for a copy that is not laid
    turned: np.ndarray  # (n_copies, k, 3): the layout from there, turned but in its own unit


def lay_over(points: np.ndarray, layout: np.ndarray) -> Similarity | None:
    """Similarity of a layout and located points (Umeyama, TPAMI 1991); None for fewer than two.

    Points (n_copies * k, 3) are of any frame, copy by copy, NaN where not located; how the copies
    lie to one another is not known. The layout has those of a copy, (k, 3), of known unit.
    """
    copies = points.reshape(-1, *layout.shape)
    middles, turned = np.full((len(copies), 3), np.nan), np.full_like(copies, np.nan)
    gain, extents = 0.0, np.zeros(2)
    for copy, located in enumerate(np.isfinite(copies).all(axis=2)):
        if located.sum() < 2:
            continue
        middles[copy] = copies[copy, located].mean(axis=0)
        there = copies[copy, located] - middles[copy]
        here = layout[located] - layout[located].mean(axis=0)
        rotation, trace = best_turn(there.T @ here)
        turned[copy, located] = here @ rotation.T
        gain += trace
        extents += np.square(there).sum(), np.square(here).sum()
    if gain <= 0:
        return None
    left = max(1 - gain**2 / extents.prod(), 0.0)
    return Similarity(float(gain / extents[1]), float(np.sqrt(left)), middles, turned)


def fit_layout(seen: Sightings, laid: Similarity) -> tuple[float, float]:
    """Size of a layout by the sightings that agree, from where it was laid over their points.

    It is that of the layout's unit, in that of the poses, with the least reprojection error. Its
    relative standard error is a sandwich estimate that takes each photo as one independent draw,
    since all points of a photo share the error of its pose; with few photos the plain one where
    larger.
    """
    located = np.isfinite(laid.turned[..., 0])
    copies, copy = np.unique(np.nonzero(located)[0], return_inverse=True)
    middles, turned = laid.middles[copies], laid.turned[located]
    seen = replace(seen, places=seen.places[:, located.ravel()])
    is_shown = np.isfinite(seen.places[..., 0])
    row = np.nonzero(is_shown)[0]
    noise = seen.noise_px[:, None, None]

    def residuals(model: np.ndarray) -> np.ndarray:
        shifts, turns = model[:-1].reshape(2, -1, 3)
        arms = np.exp(model[-1]) * Rotation.from_rotvec(turns[copy]).apply(turned)
        moved = middles[copy] + laid.size * (shifts[copy] + arms)
        return (seen.residuals_px(moved) / noise)[is_shown].ravel()

    start = np.zeros(6 * len(middles) + 1)
    found = least_squares(residuals, start, loss="soft_l1")
    inverse = np.linalg.pinv(found.jac.T @ found.jac)  # scaled by the robust loss
    variance = np.sum(found.fun**2) / max(len(found.fun) - len(start), 1)
    plain = max(variance, _LEAST_VARIANCE) * inverse[-1, -1]
    pulls = (found.jac @ inverse[-1] * found.fun).reshape(-1, 2).sum(axis=1)
    by_photo = np.bincount(seen.photos[row], pulls)
    n_photos = len(np.unique(seen.photos[row]))
    sandwich = np.sum(by_photo**2) * n_photos / max(n_photos - 1, 1)
    return float(laid.size * np.exp(found.x[-1])), float(np.sqrt(max(plain, sandwich)))
