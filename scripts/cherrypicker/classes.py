"""The semantic classes of a point."""

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


def wood_mask(labels):
    """Points of trunk or branch, (n_points,) bool."""
    return (labels == Label.TRUNK) | (labels == Label.BRANCH)
