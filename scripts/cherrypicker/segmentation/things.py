"""A thing in the orchard has one class, and a marker that was solved is known.

Signs, markers, calibration units and roofs come in more shapes than a network has seen. What hangs
together is one thing, so its points decide together; and `estimate_scale` has solved where the
markers stand, so that what lies in a marker's plane is its board, what hangs below it its stand,
and nothing else is one. A post or a rim that passes for wood stands under the thing that it
carries.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cherrypicker.classes import CHANNELS, WOOD, Label
from cherrypicker.segmentation.refine import ground_below, link_components

__all__ = ["Square", "one_class_a_thing", "solved_squares", "wood_under_things"]

logger = logging.getLogger(__name__)

THINGS = (Label.SIGN, Label.MARKER, Label.CALIBRATION_UNIT, Label.ROOF)
LINK = 2.5  # voxels: parts of a thing lie no farther apart (a guess: neighbours with one missing)
THICKNESS = 1.5  # voxels: how far off a marker's plane its print is looked for (a guess)
QUIET_ZONE = 1 / 6  # of the side: a module of a 4 x 4 marker, white around the print (OpenCV)
BOARD = 0.5  # sides beyond the print: its board reaches no farther (a guess)
STANDS_M = 0.5  # a thing that stands comes this near to the ground (as `trunk_base_height_m`)
UNDER = 0.9  # share of a piece of wood that must lie under a thing (a guess)
THICKEST_M = 0.14  # a post or a board, seen from above (as the widest of `PostModel`)
STAND = 1.0  # sides from its middle, in plan: its stand reaches no farther (a guess)


@dataclass(frozen=True)
class Square:
    """The black square of a solved marker.

    Attributes
    ----------
    corners : ndarray of shape (4, 3), float64
        One after the other.
    """

    corners: NDArray[np.float64]

    @property
    def middle(self) -> NDArray[np.float64]:
        """Its centre, (3,)."""
        return self.corners.mean(axis=0)

    @property
    def side(self) -> float:
        """Mean length of its sides."""
        steps = self.corners - np.roll(self.corners, 1, axis=0)
        return float(np.linalg.norm(steps, axis=1).mean())

    def has_below(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which points (n, 3), z up, lie below its board, where its stand is."""
        aside = np.linalg.norm(points[:, :2] - self.middle[:2], axis=1)
        return (aside <= STAND * self.side) & (points[:, 2] <= self.corners[:, 2].max())

    def holds(
        self, points: NDArray[np.float64], thickness: float, margin: float
    ) -> NDArray[np.bool_]:
        """Which points (n, 3) lie in its plane, on the print or up to `margin` sides off it."""
        across = np.linalg.svd(self.corners - self.middle, full_matrices=False)[2]
        edge = self.corners[1] - self.corners[0]
        edge = edge - (edge @ across[2]) * across[2]
        edge /= np.linalg.norm(edge)
        offset = points - self.middle
        in_plane = np.abs(offset @ np.stack([edge, np.cross(across[2], edge)], axis=1))
        on_it = in_plane.max(axis=1) <= (0.5 + margin) * self.side
        return on_it & (np.abs(offset @ across[2]) <= thickness)


def solved_squares(scale: dict[str, Any], align: dict[str, Any]) -> list[Square] | None:
    """The markers of a scan that were solved, in the metric frame.

    Parameters
    ----------
    scale, align : dict
        scale.json and align.json, which lead from the sparse model's frame to the metric one.

    Returns
    -------
    list of Square or None
        None where not all markers that the photos show were solved: others may stand there.
    """
    if scale["mode"] != "marker" or any(n > 1 for n in scale["other_ids"].values()):
        return None
    matrix = np.array(align["transform"], dtype=np.float64)
    matrix[:3] *= scale["scale"] or 1.0
    return [
        Square(np.asarray(marker["corners"]) @ matrix[:3, :3].T + matrix[:3, 3])
        for marker in scale["markers"]
        if marker.get("corners") is not None
    ]


def one_class_a_thing(
    points: NDArray[np.float64],
    probabilities: NDArray[np.float32],
    voxel: float,
    squares: list[Square] | None = None,
) -> NDArray[np.float32]:
    """Let the points of each thing that is no wood and no ground decide together.

    Parameters
    ----------
    points : ndarray of shape (n, 3), float64
        Voxel sample, z up.
    probabilities : ndarray of shape (n, n_channels), float32
    voxel : float
        Distance of neighbouring points.
    squares : list of Square, optional
        All markers of the scene, in the frame of the points; left out where they are not known.

    Returns
    -------
    ndarray of shape (n, n_channels), float32
        A copy; what the points of a thing thought likely of other classes goes to its own.
    """
    likeliest = probabilities.argmax(axis=1)
    marker = Label.MARKER.channel
    is_thing = np.isin(likeliest, [label.channel or 0 for label in THINGS])
    board = np.zeros(len(points), dtype=bool)
    below = np.zeros(len(points), dtype=bool)
    for square in squares or ():
        board |= square.holds(points, THICKNESS * voxel, QUIET_ZONE)
        board |= square.holds(points, THICKNESS * voxel, BOARD) & is_thing
        below |= square.has_below(points)
    result = probabilities.copy()
    rows = np.flatnonzero(is_thing & ~board)
    thing = link_components(points[rows], LINK * voxel)
    is_stand = np.zeros(len(rows), dtype=bool)
    if board.any() and len(rows):
        touches = cKDTree(points[board]).query(points[rows])[0] <= LINK * voxel
        stands_clear = np.bincount(thing, ~below[rows]) == 0
        is_stand = ((np.bincount(thing, touches) > 0) & stands_clear)[thing]
    votes = probabilities[rows].astype(np.float64)
    if squares is not None:
        votes[:, marker] = 0.0
    total = np.stack([np.bincount(thing, weights=column) for column in votes.T], axis=1)
    chosen = np.where(is_stand, marker, total.argmax(axis=1)[thing])
    result[rows] = np.eye(probabilities.shape[1], dtype=np.float32)[chosen]
    result[board] = np.eye(probabilities.shape[1], dtype=np.float32)[marker]
    logger.info(
        "%d things; %s of their %s points changed class; %s points are of %d solved markers",
        thing.max(initial=-1) + 1,
        f"{np.count_nonzero(chosen != likeliest[rows]):,}",
        f"{len(rows):,}",
        f"{np.count_nonzero(board) + np.count_nonzero(is_stand):,}",
        len(squares or ()),
    )
    return result


def wood_under_things(
    points: NDArray[np.float64], probabilities: NDArray[np.float32], voxel: float
) -> NDArray[np.float32]:
    """Give wood that stands under a thing to it: the post of a sign, the rim of its board.

    A piece of wood that touches a standing thing, does not rise above it or reach out of its plan,
    and is as thin as a post or a board, carries it. Trees that touch a thing do reach out.

    Parameters
    ----------
    points : ndarray of shape (n, 3), float64
        Voxel sample, z up.
    probabilities : ndarray of shape (n, n_channels), float32
        After `one_class_a_thing`.
    voxel : float
        Distance of neighbouring points.

    Returns
    -------
    ndarray of shape (n, n_channels), float32
        A copy.
    """
    result, reach = probabilities.copy(), LINK * voxel
    likeliest = probabilities.argmax(axis=1)
    things = np.flatnonzero(np.isin(likeliest, [label.channel or 0 for label in THINGS]))
    wood = np.flatnonzero(np.isin(likeliest, [label.channel or 0 for label in WOOD]))
    if not len(things) or not len(wood):
        return result
    ground = points[likeliest == Label.GROUND.channel]
    thing = link_components(points[things], reach)
    piece = link_components(points[wood], reach)
    apart, nearest = cKDTree(points[things]).query(points[wood])
    for number in np.unique(piece[apart <= reach]):
        own = wood[piece == number]
        touched = np.unique(thing[nearest[(piece == number) & (apart <= reach)]])
        above = things[np.isin(thing, touched)]
        both = points[np.concatenate([own, above])]
        foot = both[both[:, 2].argmin()]
        if foot[2] - ground_below(foot, ground) <= STANDS_M and _is_under(
            points[own], points[above], reach
        ):
            channel = np.bincount(likeliest[above]).argmax()
            result[own] = np.eye(probabilities.shape[1], dtype=np.float32)[channel]
            logger.info(
                "%d voxels of wood stand under a %s", len(own), Label(CHANNELS[channel]).title
            )
    return result


def _is_under(wood: NDArray[np.float64], thing: NDArray[np.float64], reach: float) -> np.bool_:
    """Whether a piece of wood lies under a thing, and is as thin as what carries one."""
    aside = cKDTree(thing[:, :2]).query(wood[:, :2])[0]
    under = (aside <= reach) & (wood[:, 2] <= thing[:, 2].max() + reach)
    plan = wood[:, :2] - wood[:, :2].mean(axis=0)
    across = plan @ np.linalg.svd(plan, full_matrices=False)[2][-1]
    thickness = np.ptp(np.quantile(across, [1 - UNDER, UNDER]))
    return (under.mean() >= UNDER) & (thickness <= THICKEST_M)
