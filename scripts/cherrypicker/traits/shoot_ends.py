"""Ends of a tree's shoots, and how much of them a scan likely lost.

A scan loses the end of a shoot, and no point that it has tells by how much; but where points lie
far apart along a shoot's last stretch, more is missing than where they are dense. The loss of one
shoot is a few of these spacings: a short exponential loss for most, a long one for some.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.geometry.error_terms import FACTORS
from cherrypicker.geometry.lines import Line
from cherrypicker.geometry.stem_slabs import cut_slab
from cherrypicker.skeleton import Axis, Skeleton
from cherrypicker.traits.support import NEAR_RADII


@dataclass
class ShootEnds:
    """Where shoots end in a skeleton."""

    nodes: np.ndarray  # (n_ends,) int64
    # points, directions: (n_ends, 3) float64: tips, and the way that each shoot runs there
    points: np.ndarray
    directions: np.ndarray
    # (n_ends,) float64: scale of what each has likely lost, in the skeleton's unit
    scale: np.ndarray
    beyond: float  # length that a tip may reach beyond the wood, by the noise of its points


def find_shoot_ends(
    skeleton: Skeleton, axis_list: list[Axis], kept: np.ndarray, wood: cKDTree, reach: float
) -> ShootEnds:
    """Find the tips of a skeleton and how far apart the wood points lie there.

    The axes are those of `cherrypicker.skeleton.axes`, the nodes ``kept``, (n_nodes,) bool, those
    that belong to the tree. The points of the wood have company within ``reach``.
    """
    is_tip = (skeleton.n_children == 0) & kept
    ways = [axis.way for axis in axis_list if is_tip[axis.nodes[-1]]]
    ways.sort(key=lambda way: way[-1])
    tips = np.array([way[-1] for way in ways], dtype=np.int64)
    lines = [Line(skeleton.points[way]) for way in ways]
    points = skeleton.points[tips]
    directions = np.array(
        [line.direction(line.along[-1] - reach, line.along[-1]) for line in lines]
    ).reshape(-1, 3)
    half = 0.5 * reach  # of a shoot's last stretch, in a tube as wide as it is long
    aside = np.maximum(half, NEAR_RADII * skeleton.radius[tips])
    middle = points - half * directions
    around = wood.query_ball_point(middle, np.hypot(half, aside))
    n_points = [
        len(cut_slab(wood.data[near], *tube)[0])
        for near, *tube in zip(around, middle, directions, [half] * len(tips), aside, strict=True)
    ]
    spacing = reach / np.maximum(n_points, 1)
    scale = np.minimum(FACTORS["loss_spacings"] * spacing, FACTORS["largest_loss"] * reach)
    return ShootEnds(tips, points, directions, scale, FACTORS["tip_beyond"] * reach)


def draw_tips(ends: ShootEnds, n_samples: int, rng: np.random.Generator) -> np.ndarray:
    """Draw where shoots truly end, (n_samples, n_ends, 3) float64: farther on by what they lost.

    Some end before: their points overshoot.
    """
    shape = (n_samples, len(ends.scale))
    is_long = rng.random(shape) < FACTORS["long_share"]
    mean = np.where(is_long, FACTORS["long_loss"], FACTORS["short_loss"])
    losses = ends.scale * mean * rng.exponential(size=shape) - ends.beyond
    return ends.points + losses[..., None] * ends.directions
