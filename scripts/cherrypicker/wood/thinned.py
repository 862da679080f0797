"""Which wood of a cloud is looked at, and the classes of its thinned points."""

from dataclasses import dataclass

import numpy as np

from cherrypicker.classes import WOOD
from cherrypicker.geometry.neighbors import Neighbors
from cherrypicker.geometry.sampling import majority_label

FEWEST_WOOD = 50  # points of which a tree is looked for; the sparsest clouds at hand have 3,000
# Points of a piece or a stem; fewer are strays. With 3 the worst of eight laser scans changes by
# 0.2 % of its wood, with 10 by 12
FEWEST_OF_PIECE = 5
# Neighbours of a point that it may touch, and whose most frequent class with its own is its own. Of
# the wood of eight scans and a tree of the set 6 and 16 change 0.2 % of the worst cloud
N_NEIGHBORS = 12


@dataclass(frozen=True)
class GrowthOptions:
    """Which wood limbs are grown from; the fields are config keys of ``contract``."""

    classes: tuple[int, ...] = WOOD
    voxel_size_m: float = 0.005
    gap_m: float = 0.25
    stem_gap_m: float = 0.6
    min_density: float = 0.05
    max_points: int = 100_000


def agreed_labels(
    points: np.ndarray, labels: np.ndarray, near: Neighbors | None = None
) -> np.ndarray:
    """Class of each point (n,): that of most of its `N_NEIGHBORS` neighbours and itself.

    A class is a class of a place: a lone label of the stem far out would let the wood there be
    taken for a piece of the stem. `near` are at least so many, where they are known.
    """
    around = (near or Neighbors(points, N_NEIGHBORS)).index[:, : N_NEIGHBORS + 1]
    member = np.repeat(np.arange(len(around)), around.shape[1])
    return majority_label(labels[around].ravel(), member, len(around))
