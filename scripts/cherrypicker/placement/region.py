"""Region of interest from the cameras alone: the place that they look at, as far as they stand.

The paper (section Region of Interest) takes the box of the camera origins, on the assumption that
the cameras stand around the tree. A ball around the point that they look at, as wide as they are
far, is the same for a ring of cameras, and holds for half a ring or two alleys as well; it needs
neither a cloud nor the vertical, so that the dense stereo can use it.
"""

import logging
from dataclasses import dataclass

import numpy as np

from cherrypicker.geometry.lines import intersect_rays
from cherrypicker.geometry.robust import CAUCHY
from cherrypicker.poses import Poses

logger = logging.getLogger(__name__)

# Nearest wood in a camera's own distance to the centre; nobody photographs a twig before the lens
# (guess: a crown of 1.5 m radius seen from 2.2 m)
NEAREST = 0.3
# Mean squared sine of the cameras' directions below which they look at no common place; half and
# twice as much tell eleven walks round a tree (0.24 to 0.52) from parallel cameras as well
LEAST_SPREAD = 0.01
N_ROUNDS = 20  # in search of the crossing
# Samples of the region: 14 cm apart in a ball of 3 m radius
N_SAMPLES = 3000


@dataclass(frozen=True)
class Region:
    """A ball around what the cameras look at, in their frame and unit."""

    center: np.ndarray  # (3,): point that the cameras look at
    radius: float
    distance: float  # median distance of the cameras to the centre
    samples: np.ndarray  # (n_samples, 3): evenly spread points of the ball

    def holds(self, points: np.ndarray) -> np.ndarray:
        """Whether points of shape (..., 3) lie in the ball, bool (...)."""
        return np.linalg.norm(points - self.center, axis=-1) <= self.radius


def find_region(poses: Poses, *, several: bool = False) -> Region | None:
    """Find the region of interest of a scan, in whatever frame and unit its poses are.

    None where the cameras look at no common place (a facade, a walk along a row). With `several`
    trees, which stand wherever the walk goes, the ball holds all cameras, few photos need to frame
    its middle, and there is none only where parallel axes leave the depth of all open.
    """
    from scipy.stats import qmc  # half a second to load, and a ready cloud has no cameras

    # The mean squared sine of the axes' angles to a common direction: 0 for parallel axes
    spread = max(0.0, 1.0 - np.linalg.eigvalsh(poses.forward.T @ poses.forward)[2] / len(poses))
    center = _crossing(poses)
    away = np.linalg.norm(center - poses.centers, axis=1)
    distance = float(np.median(away))
    share = float(poses.frames(center[None]).mean())
    if spread < LEAST_SPREAD or (2 * share < 1 and not several):
        logger.warning(
            "the cameras look at no common place: %.0f %% frame the point where their axes cross "
            "(spread of the axes %.1f degrees); all that the photos share is the region",
            100.0 * share,
            np.degrees(np.sqrt(spread)),
        )
        return None
    radius = float(away.max()) if several else distance  # as wide as the paper's box
    cube = 2.0 * qmc.Halton(3, scramble=False).random(3 * N_SAMPLES)[1:] - 1.0
    ball = cube[np.linalg.norm(cube, axis=1) <= 1.0][:N_SAMPLES]
    return Region(center, radius, distance, center + radius * ball)


def _crossing(poses: Poses) -> np.ndarray:
    """Return where the viewing axes cross, (3,), by iteratively reweighted least squares.

    What an axis misses it by counts with Cauchy's loss, whose scale follows the median miss.
    """
    middle = poses.centers.mean(axis=0)  # where parallel axes leave it open
    reach = CAUCHY / np.sqrt(np.log(4))  # of Cauchy's loss, in Rayleigh's medians
    offsets, weights, point = poses.centers - middle, np.ones(len(poses)), np.zeros(3)
    for _ in range(N_ROUNDS):
        point = np.nan_to_num(intersect_rays(offsets, poses.forward, weights))
        ways = point - offsets
        depth = np.einsum("ni,ni->n", ways, poses.forward)
        misses = np.linalg.norm(ways - depth[:, None] * poses.forward, axis=1)
        scale = reach * np.median(misses) + np.finfo(float).tiny
        # An axis that meets the point behind its camera says nothing about where it looks
        weights = (depth > 0) / (1.0 + (misses / scale) ** 2)
    return middle + point


def look_at_point(poses: Poses, points: np.ndarray) -> tuple[np.ndarray, float, bool]:
    """Point that the cameras look at: the centre of their region of interest.

    Where they look at no common place (a walk along a row) it is the median over the cameras of
    what a photo shows of a cloud (n_points, 3), on its axis at the median depth. With the point,
    (3,), come the median distance of the cameras to it, the unit of thresholds where no scale is
    known, and whether they look at a common place.
    """
    region = find_region(poses)
    if region is not None:
        return region.center, region.distance, True
    framed = zip(poses.centers, poses.forward, poses.frames(points), strict=True)
    seen = [
        place + np.median((points[shown] - place) @ way) * way
        for place, way, shown in framed
        if shown.any()
    ]
    point = np.median(seen or points, axis=0)
    return point, float(np.median(np.linalg.norm(point - poses.centers, axis=1))), False


def framing(poses: Poses, region: Region) -> np.ndarray:
    """Which photo frames which sample of the region, (n_photos, n_samples) bool.

    What lies nearer than 0.3 of a camera's own distance to the centre does not count.
    """
    own = np.linalg.norm(poses.centers - region.center, axis=1)
    return poses.frames(region.samples, NEAREST * own)
