"""The semantic classes of a point and the colours they are drawn in."""

from __future__ import annotations

from enum import IntEnum


class Label(IntEnum):
    """Label ids in ``segmented.ply`` and everything after it.

    0 to 6 are the seven classes of the network (paper, Sec. 3.4); the support post is split off
    from the trunk afterwards.
    """

    GROUND = 0
    TRUNK = 1
    BRANCH = 2
    SIGN = 3
    MARKER = 4
    CALIBRATION_UNIT = 5
    ROOF = 6
    SUPPORT_POST = 7
    UNLABELLED = 255


CLASS_NAMES: dict[int, str] = {int(label): label.name.lower() for label in Label}
CLASS_IDS: dict[str, int] = {name: number for number, name in CLASS_NAMES.items()}

N_NETWORK_CLASSES = 7

CLASS_COLORS: dict[int, tuple[float, float, float]] = {
    Label.GROUND: (0.62, 0.55, 0.42),
    Label.TRUNK: (0.45, 0.24, 0.10),
    Label.BRANCH: (0.18, 0.55, 0.24),
    Label.SIGN: (0.95, 0.77, 0.06),
    Label.MARKER: (0.84, 0.15, 0.16),
    Label.CALIBRATION_UNIT: (0.12, 0.47, 0.71),
    Label.ROOF: (0.55, 0.34, 0.76),
    Label.SUPPORT_POST: (0.50, 0.50, 0.50),
    Label.UNLABELLED: (0.80, 0.80, 0.80),
}


def wood_mask(labels):
    """Points of trunk or branch, (n_points,) bool."""
    return (labels == Label.TRUNK) | (labels == Label.BRANCH)
