"""Where the stem meets the ground: the height that a tree's heights are measured from."""

from dataclasses import dataclass

import numpy as np

from cherrypicker.classes import Label, wood_mask
from cherrypicker.geometry.ground_surface import REACH_M, ground_level
from cherrypicker.skeleton.model import Skeleton

# Of the root: wood of the stem; with 2 radii and 3 cm a trunk of 25 cm has its foot too high
_BESIDE_RADII, _BESIDE_M = 3.0, 0.05
# Of that wood lies below its lowest point: noise. Without their ground the feet of six trees are
# off by 7 mm in the mean, 9 with half the share, 4 with twice, 14 with none
_LOWEST_SHARE = 0.01


@dataclass
class Foot:
    """Where the stem meets the ground."""

    point: np.ndarray  # (3,): in the cloud's frame and unit; heights are measured from its z
    # ``ground`` (a plane fitted to the ground around the stem), ``wood`` (the lowest stem points,
    # where no ground was seen) or ``root`` (the skeleton's root, where neither was)
    source: str
    gap: float  # height of the lowest wood at the stem over the foot, in the cloud's unit
    # Standard error of the foot's height: none over ground, whose error the height's own holds (on
    # trees whose truth is known it does not follow how rough the ground is); without ground, how
    # far the lowest points lie from the skeleton's root; without either, the stem's radius.
    error: float


def find_foot(skeleton: Skeleton, stem: np.ndarray, points: np.ndarray, labels: np.ndarray) -> Foot:
    """Find the stem's foot: the ground below the root, or else the lowest points of the stem.

    The nodes of the stem, (n,) int64, are the trunk's: twigs that hang about the foot have nodes
    there, too. Points (n_points, 3), z up, and labels (n_points,) are those of the whole cloud.
    """
    root = skeleton.points[0]
    near_root = stem[np.linalg.norm(skeleton.points[stem] - root, axis=1) < REACH_M]
    radius = float(np.median(skeleton.radius[near_root]))
    wood = points[wood_mask(labels)]
    beside = np.hypot(*(wood[:, :2] - root[:2]).T) < max(_BESIDE_RADII * radius, _BESIDE_M)
    beside &= np.abs(wood[:, 2] - root[2]) < REACH_M
    low = float(np.quantile(wood[beside, 2], _LOWEST_SHARE)) if beside.any() else float(root[2])
    level = ground_level(points[labels == Label.GROUND], root[:2], radius)
    # A tree stands on the ground, however far up its lowest points lie; ground that lies well over
    # them is none (low branches of a scan without ground may pass for it)
    if level is None or (beside.any() and level - low > REACH_M):
        foot = np.array([root[0], root[1], low])
        if beside.any():
            return Foot(foot, "wood", 0.0, abs(low - float(root[2])))
        return Foot(foot, "root", 0.0, radius)
    foot = np.array([root[0], root[1], level])
    return Foot(foot, "ground", max(low - level, 0.0), 0.0)
