"""Which way is up, by what the photos say: how they were held, and what their phones measured.

One robust least-squares problem over the direction up. What measures it (the photos' rolls, the
gravity that they state, the ground's normal) differs only in its rows, its noise, and the error
that all of its rows share, which is solved for: no accelerometer is without an offset.

A photo may be stored in any of four quarter turns (COLMAP ignores the EXIF orientation): each takes
the turn at which it is upright, with EXIF as a hint.
"""

import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from cherrypicker.geometry.directions import angle_deg, tangent_basis, unit
from cherrypicker.geometry.robust import CAUCHY, robust_sigma
from cherrypicker.photos import MIN_PHOTOS, UPRIGHT
from cherrypicker.poses import Poses

logger = logging.getLogger(__name__)

# Scales of roll and pitch of hand-held photos, by which a photo chooses its quarter turn, and what
# each turn away from EXIF's costs of a cost below 1; the tag may be missing or wrong. Half and
# twice of each move up by less than 0.001 degrees on nine scans
_ROLL_DEG, _PITCH_DEG, _TURN_COST = 8.0, 45.0, 0.15
_LEAST_NOISE_DEG = 0.2  # nobody holds a camera, and no phone measures, better than this
_N_ROUNDS = 3  # of turns and noise, each by the direction before
# Rolls that differ by more, or a less sure up, tell no vertical, and gravity further off the rolls'
# up is none: eleven walks roll by 0.5 to 5 degrees, photos turned at random by 20 to 29
MOST_DEG = 15.0
# Largest median angle of stated gravity to its common direction, degrees: a phone's photos have
# 1.1, six simulated walks 0.8 to 1.5, with half of it they are used too
_MOST_SPREAD_DEG = 5.0
# Of an accelerometer, in all photos alike: on six simulated walks half and twice as much leave up
# as far off, 0.23 to 0.25 degrees, none 0.26
_OFFSET_DEG = 0.5


@dataclass(frozen=True)
class Evidence:
    """Measurements of the way up."""

    # By how much each of n would be off in k components, (n, k) rad, were a unit vector the way up
    off: Callable[[np.ndarray], np.ndarray]
    noise: float  # standard deviation of each component, rad
    shared: float = 0.0  # of the error that all n have in common, one a component, rad


@dataclass(frozen=True)
class PhotosUp:
    """Vertical direction that the photos agree on."""

    up: np.ndarray  # (3,): unit vector, world frame
    sigma_deg: float  # standard deviation in the direction least known
    # (n_photos,) int: quarter turn of each photo, 0 stored upright, 1 EXIF 6, 2 upside down, 3
    # EXIF 8
    turns: np.ndarray
    roll_std_deg: float  # robust spread of the rolls about the up of the rolls alone
    evidence: Evidence  # to be joined with other evidence
    gravity: dict  # what align.json says of the stated gravity
    warnings: list[str]


def solve_up(evidence: Sequence[Evidence], start: ArrayLike) -> tuple[np.ndarray, float]:
    """Direction (3,) that fits all evidence best, by least squares with Cauchy's loss.

    What no evidence tells stays at the start, (3,). With it comes its standard deviation in the
    direction least known, degrees, at most some 45.
    """
    from scipy.optimize import least_squares

    start = unit(start)
    basis = tangent_basis(start)
    ends = 2 + np.cumsum([one.off(start).shape[1] for one in evidence])

    def residuals(unknown: np.ndarray) -> np.ndarray:
        """Of the tilt from the start, then of each evidence and its shared errors."""
        tilt, *errors = np.split(unknown, [2, *ends[:-1]])
        up, parts = unit(start + tilt @ basis), [tilt / np.radians(_PITCH_DEG)]
        for one, error in zip(evidence, errors, strict=True):
            parts += [((one.off(up) - one.shared * error) / one.noise).ravel(), error]
        return np.concatenate(parts)

    fit = least_squares(residuals, np.zeros(ends[-1]), loss="cauchy", f_scale=CAUCHY, x_scale="jac")
    covariance = np.linalg.inv(fit.jac.T @ fit.jac)[:2, :2]
    sigma = np.sqrt(np.linalg.eigvalsh(covariance)[-1])
    return unit(start + fit.x[:2] @ basis), float(np.degrees(sigma))


def turns_from_exif(orientations: Iterable[int]) -> np.ndarray:
    """Quarter turns, shape (n,), that EXIF orientations (1 to 8) state; mirrored count as 1."""
    brought = [UPRIGHT[orientation] for orientation in orientations]
    return np.array([0 if is_mirrored else -turns % 4 for is_mirrored, turns in brought], int)


def photographer_axes(poses: Poses) -> tuple[np.ndarray, np.ndarray]:
    """Right and up axes of every photo at each quarter turn, world, each (n_cameras, 4, 3)."""
    x, down = poses.rotations[:, 0], poses.rotations[:, 1]
    # As stored; EXIF 6: up is the image's left; EXIF 3: upside down; EXIF 8
    return np.stack([x, -down, -x, down], axis=1), np.stack([-down, -x, down, x], axis=1)


def roll_costs(
    poses: Poses, directions: ArrayLike, stated_turns: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """How badly each photo fits each hypothetical up direction (..., 3), at its best quarter turn.

    A level photo has its right axis orthogonal to up (roll) and its up axis not too far from up
    (pitch); the second term rejects the horizontal directions to which the image axes of a level
    ring of cameras are orthogonal as well. Without `stated_turns` (:func:`turns_from_exif`) all are
    taken to be 0. Returns robust costs in [0, 1) and these turns, int, both (..., n_cameras).
    """
    right, up = photographer_axes(poses)
    directions = unit(directions)
    roll = np.degrees(np.arcsin(np.clip(np.einsum("nki,...i->...nk", right, directions), -1, 1)))
    pitch = np.degrees(np.arccos(np.clip(np.einsum("nki,...i->...nk", up, directions), -1, 1)))
    squared = (roll / _ROLL_DEG) ** 2 + (pitch / _PITCH_DEG) ** 2
    misfit = squared / (1.0 + squared)
    stated = np.zeros(len(right), int) if stated_turns is None else stated_turns
    turned = (np.arange(4) - stated[:, None]) % 4
    costs = misfit + _TURN_COST * np.minimum(turned, 4 - turned) * (1.0 - misfit)
    return costs.min(axis=-1), costs.argmin(axis=-1)


def photos_up(
    poses: Poses,
    *,
    stated_turns: np.ndarray | None = None,
    stated_ups: Sequence[np.ndarray | None] = (),
    start: np.ndarray | None = None,
) -> PhotosUp:
    """Estimate the vertical from how the photos were held and from the gravity that they state.

    Every photo contributes its horizontal axis (image x, or y for a portrait photo stored
    sideways), which ought to be orthogonal to up whatever the pitch. What counts is the angle that
    it was rolled by, about the view: products with the axes would see less roll in photos of one
    direction, the more of them up looks at. Readings of gravity that contradict one another or the
    rolls by too much count for nothing: a program that turned the photos has kept them.

    What is stated is as of :func:`cherrypicker.placement.align.align`. The solution is the one near
    the start (3,), a ground normal, sign included; without it one of the photos' own starts.
    """
    right, upward = photographer_axes(poses)
    if start is None:
        directions = upward.reshape(-1, 3)
        start = directions[roll_costs(poses, directions, stated_turns)[0].mean(axis=1).argmin()]
    up = start = unit(start)
    for _ in range(_N_ROUNDS):
        photo = np.arange(len(poses)), roll_costs(poses, up, stated_turns)[1]
        rolls = partial(_rolls, right[photo], upward[photo])
        # The median of |roll| also feels a shared bias, which is then part of the noise.
        noise = max(robust_sigma(rolls(up)), np.radians(_LEAST_NOISE_DEG))
        evidence = Evidence(rolls, noise)
        up, sigma_deg = solve_up([evidence], start)
    turns = roll_costs(poses, up, stated_turns)[1]
    stated, report, warnings = _stated_gravity(poses, stated_ups, up)
    if stated is not None:
        evidence = stated  # what hands do, all of a half ring alike, is no better than a guess
        up, sigma_deg = solve_up([evidence], up)
    return PhotosUp(up, sigma_deg, turns, float(np.degrees(noise)), evidence, report, warnings)


def _rolls(right: np.ndarray, upward: np.ndarray, up: np.ndarray) -> np.ndarray:
    """By how much photos of these axes, (n, 3), were rolled about their view, (n, 1) rad."""
    return np.arctan2(right @ up, upward @ up)[:, None]


def _stated_gravity(
    poses: Poses, stated: Sequence[np.ndarray | None], rolls_up: np.ndarray
) -> tuple[Evidence | None, dict, list[str]]:
    """What the phones measured, None where it cannot be right; for align.json; and warnings."""
    known = {i: up for i, up in enumerate(stated) if up is not None}
    if len(known) < MIN_PHOTOS:
        return None, {"gravity_is_used": False}, []
    values, rows = unit(list(known.values())), poses.rotations[list(known)]
    ups = np.einsum("nij,ni->nj", rows, values)
    common = np.median(ups, axis=0)
    spread_deg = max(float(np.median([angle_deg(up, common) for up in ups])), _LEAST_NOISE_DEG)
    off_deg = angle_deg(common, rolls_up)
    is_used = spread_deg <= _MOST_SPREAD_DEG and off_deg <= MOST_DEG
    report = {
        "gravity_is_used": is_used,
        "gravity_n_photos": len(known),
        "gravity_spread_deg": spread_deg,
        "gravity_to_rolls_deg": off_deg,
    }
    says = (
        f"{len(known)} photos state gravity, to {spread_deg:.1f} degrees in the median, "
        f"{off_deg:.1f} degrees off the way that they were held"
    )
    if not is_used:
        return None, report, [f"{says}: gravity is not used"]
    logger.info("%s", says)
    noise = np.radians(spread_deg) / np.sqrt(np.log(4))  # Rayleigh's median in its sigmas
    return Evidence(lambda up: rows @ up - values, noise, np.radians(_OFFSET_DEG)), report, []
