"""What a point is, and what took it out: the tables that every stage, file and page follows.

What a class looks like on the pages is `cherrypicker.report.style`, whose edits rerun the report
alone; how it is trained and what its things are, docs/architecture.md tells.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Label(IntEnum):
    """Label ids in ``segmented.ply`` and everything after it."""

    GROUND = 0
    TRUNK = 1
    BRANCH = 2
    SIGN = 3
    MARKER = 4
    CALIBRATION_UNIT = 5
    ROOF = 6
    SUPPORT_POST = 7
    UNLABELLED = 255

    @property
    def channel(self) -> int | None:
        """Of the network; None of the class that it never sees."""
        return None if self is Label.UNLABELLED else int(self)

    @property
    def title(self) -> str:
        """Its name on the pages."""
        return self.name.lower().replace("_", " ")


CLASS_NAMES: dict[int, str] = {int(label): label.name.lower() for label in Label}
CLASS_IDS: dict[str, int] = {name: number for number, name in CLASS_NAMES.items()}

#: Classes of the network by channel (paper, Sec. 3.4, which has the support post as trunk).
CHANNELS = tuple(label for label in Label if label.channel is not None)
#: Wood of the tree: contracted, and measured.
WOOD = (Label.TRUNK, Label.BRANCH)


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
