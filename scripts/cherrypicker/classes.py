"""What a point is, and what took it out: the tables that every stage, file and page follows.

What a class looks like on the pages is `cherrypicker.report.style`, whose edits rerun the report
alone; how it is trained and what its things are, docs/architecture.md tells.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

_DENDRITE, _AXON = 3, 2


class Label(IntEnum):
    """Label ids in ``segmented.ply`` and everything after it."""

    # Of the network (paper, Sec. 3.4, which has the support post as trunk). None: the network
    # never sees the class.
    channel: int | None
    is_wood: bool  # wood of the tree: contracted, and measured
    swc: int  # type in ``skeleton.swc``, which viewers colour by

    def __new__(
        cls,
        value: int,
        channel: int | None = None,
        is_wood: bool = False,
        swc: int = _DENDRITE,
    ) -> Label:
        """Make a member of the table's row."""
        label = int.__new__(cls, value)
        label._value_ = value
        label.channel, label.is_wood, label.swc = channel, is_wood, swc
        return label

    # id, channel, wood, SWC
    GROUND = 0, 0
    TRUNK = 1, 1, True, _AXON
    BRANCH = 2, 2, True
    SIGN = 3, 3
    MARKER = 4, 4
    CALIBRATION_UNIT = 5, 5
    ROOF = 6, 6
    SUPPORT_POST = 7, 7
    UNLABELLED = 255

    @property
    def title(self) -> str:
        """Its name on the pages."""
        return self.name.lower().replace("_", " ")


CLASS_NAMES: dict[int, str] = {int(label): label.name.lower() for label in Label}
CLASS_IDS: dict[str, int] = {name: number for number, name in CLASS_NAMES.items()}

#: Classes of the network by channel.
CHANNELS = tuple(label for label in Label if label.channel is not None)
WOOD = tuple(label for label in Label if label.is_wood)


def wood_mask(labels: np.ndarray) -> np.ndarray:
    """Points of the tree's wood, (n_points,) bool."""
    return np.isin(labels, WOOD)


class Removal(IntEnum):
    """What took a point out: the field ``removed_by`` of ``removed.ply``."""

    title: str

    def __new__(cls, value: int, title: str) -> Removal:
        """Make a member of the table's row."""
        removal = int.__new__(cls, value)
        removal._value_ = value
        removal.title = title
        return removal

    REGION = 1, "outside the region (crop)"
    ISOLATED = 2, "isolated (denoise.std_ratio)"
    FEW_PHOTOS = 3, "too few photos (denoise.min_view_ratio)"
    SKY = 4, "sky colour (denoise.sky_color_distance)"
    OTHER_TREE = 5, "another tree's wood (crop.target_xy)"
    LOOSE = 6, "wood that hangs on no stem (contract.gap_m)"
