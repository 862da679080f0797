"""The vertical that the photos' own accelerometers agree on.

A phone knows which way is down to about a degree; the rolls of photos merely guess it, since people
hold the camera askew, and all photos of a half ring the same way. Never trusted alone: photos that
were turned by a program keep what the phone wrote, so that readings that contradict one another, or
the way the photos were held, count for nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cherrypicker.placement.camera_geometry import CameraUp, angle_deg, tangent_basis, unit
from cherrypicker.poses import Poses

# Photos that must state it; their largest median angle to their common direction, and its largest
# to the rolls' up, degrees (guesses; a phone's photos of a trunk: 23, 1.1 and 4.6)
_FEWEST, _MOST_SPREAD_DEG, _MOST_OFF_DEG = 3, 5.0, 20.0
# What an accelerometer is off in all photos alike (guess)
_FLOOR_DEG = 0.5
_N_ROUNDS = 20
_OUTLIER = 2.0  # median angles at which a photo's weight has fallen to a half
_LEAST_SPREAD_DEG = 0.2
# Median angle to the middle of a two-dimensional normal distribution, in its standard deviations
_MEDIAN_OF_RAYLEIGH = 1.1774


@dataclass(frozen=True)
class GravityUp:
    """Vertical direction that the photos state."""

    up: np.ndarray  # (3,): unit vector, world frame
    covariance: np.ndarray  # (3, 3): of `up` in rad^2, zero along `up` itself
    n_photos: int  # that state it
    spread_deg: float  # median angle of a photo's up to the common one, degrees


def gravity_up(poses: Poses, stated: Sequence[np.ndarray | None]) -> GravityUp | None:
    """Join what the photos state.

    Parameters
    ----------
    stated : sequence of (ndarray of shape (3,) or None)
        Of each photo the way up in its camera's axes, see
        :func:`cherrypicker.intake.gravity.stated_up`.

    Returns
    -------
    GravityUp or None
        None where fewer than three photos state it.
    """
    known = [(i, up) for i, up in enumerate(stated) if up is not None]
    if len(known) < _FEWEST:
        return None
    ups = np.stack([poses.rotations[i].T @ unit(up) for i, up in known])
    up = unit(np.median(ups, axis=0))
    weights = np.ones(len(ups))
    for _ in range(_N_ROUNDS):
        angles = np.arccos(np.clip(ups @ up, -1.0, 1.0))
        scale = max(np.median(angles), np.radians(_LEAST_SPREAD_DEG))
        weights = 1.0 / (1.0 + (angles / (_OUTLIER * scale)) ** 2)
        up = unit(weights @ ups)
    angles = np.arccos(np.clip(ups @ up, -1.0, 1.0))
    spread = float(max(np.median(angles), np.radians(_LEAST_SPREAD_DEG)))
    variance = (spread / _MEDIAN_OF_RAYLEIGH) ** 2 / weights.sum() + np.radians(_FLOOR_DEG) ** 2
    basis = tangent_basis(up)
    return GravityUp(up, variance * basis.T @ basis, len(known), float(np.degrees(spread)))


def contradiction(gravity: GravityUp, rolls: CameraUp) -> str | None:
    """Say why the stated gravity cannot be right; None where nothing speaks against it."""
    off = angle_deg(gravity.up, rolls.up)
    if gravity.spread_deg > _MOST_SPREAD_DEG:
        return f"they differ by {gravity.spread_deg:.0f} degrees among themselves"
    if off > _MOST_OFF_DEG:
        return f"they are {off:.0f} degrees off the way that the photos were held"
    return None
