"""The orchard of limbs: every tree's limbs, grown once, that all stages after ask.

The wood of a cloud is shared out to the stems that it hangs on, and each stem's limbs are grown.
Trunk and branch, white rings, the target, the trees of a row, the contraction and the graph are
questions to what this leaves.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import Label
from cherrypicker.errors import StageError
from cherrypicker.geometry.sampling import majority_label, thin_to_limit
from cherrypicker.limbs.growth import Limbs, grow_limbs
from cherrypicker.placement.footprint import Footprint
from cherrypicker.pointcloud import PointCloud
from cherrypicker.wood.target_wood import SharedWood, share_cloud
from cherrypicker.wood.thinned import FEWEST_WOOD, GrowthOptions, agreed_labels

logger = logging.getLogger(__name__)

SELECTION_FACTOR = 2  # wood is shared out by up to so many times the points that a tree grows from
# and of a row by as many points as of ten trees (guess: a walk of a session)
MOST_POINTS = 2_000_000


@dataclass
class Orchard(SharedWood):
    """The limbs of every tree that stands in a cloud, beside whose wood is whose."""

    entered: list[np.ndarray]  # int64: rows that each stem's limbs were grown from, increasing
    limbs: list[Limbs | None]  # of each stem, None of too little wood; ``member`` is of ``entered``

    def limbs_of(self, stem: int, rows: np.ndarray) -> Limbs | None:
        """A stem's limbs, with the ``member`` of some of the rows that entered, in their order."""
        found = self.limbs[stem]
        if found is None:
            return None
        return replace(found, member=found.member[np.searchsorted(self.entered[stem], rows)])

    def select(self, rows: np.ndarray) -> Orchard:
        """The same for a part of the cloud, whose rows are given in increasing order.

        Stems that the part lacks keep their number and have no limbs.
        """
        number = np.full(len(self.owner), -1)
        number[rows] = np.arange(len(rows))
        entered, limbs = [], []
        for own, found in zip(self.entered, self.limbs, strict=True):
            kept = number[own] >= 0
            entered.append(number[own[kept]])
            limbs.append(
                replace(found, member=found.member[kept]) if found and kept.any() else None
            )
        sample = number[self.sample]
        kept = sample[sample >= 0]
        return Orchard(self.owner[rows], kept, self.spacing, self.bases, entered, limbs)


def grow_orchard(
    cloud: PointCloud,
    options: GrowthOptions | None = None,
    *,
    region: Footprint | None = None,
    is_row: bool = False,
    pixel: float | None = None,
) -> Orchard:
    """Share a cloud's wood out to its stems, and grow each stem's limbs.

    The cloud has the field ``label``, z up. Wood at the border of the region of interest (trees
    from photos) is taken to come from trees outside, which are not grown. In a row several trees
    are asked for: as much wood is looked at as ten trees have. The pixel is as of `grow_limbs`. A
    `StageError` where there is too little wood.
    """
    options = options or GrowthOptions()
    labels = np.asarray(cloud["label"])
    most = MOST_POINTS if is_row else SELECTION_FACTOR * options.max_points
    shared = share_cloud(cloud, options, most, region=region)
    entered: list[np.ndarray] = []
    limbs: list[Limbs | None] = []
    for number, base in enumerate(shared.bases):
        rows, found = np.flatnonzero(shared.owner == number), None
        stem_at = "stem at ({:.2f}, {:.2f})".format(*base[:2])
        if np.count_nonzero(shared.owner[shared.sample] == number) >= FEWEST_WOOD:
            points = cloud.points[rows]
            thin, source, member, size = thin_to_limit(
                points, options.voxel_size_m, options.max_points, by_chance=True
            )
            voxels = f"voxels of {1000 * size:.1f} mm"
            logger.info(f"thinned {len(points):,} to {len(thin):,} points ({voxels})")
            drawn = member >= 0
            label = majority_label(labels[rows[drawn]], member[drawn], len(thin))
            stem = agreed_labels(thin, label) == Label.TRUNK
            nearest = cKDTree(points[source]).query(points)[1]
            count = np.bincount(nearest, minlength=len(source))
            try:
                found = grow_limbs(
                    points[source], base, stem=stem, stem_gap=options.stem_gap_m, count=count,
                    pixel=pixel,
                )  # fmt: skip
            except StageError as error:  # no limb
                logger.warning("%s: %s", stem_at, error.cause)
        entered.append(rows[source] if found else rows[:0])
        limbs.append(found)
        n_limbs = len(found.limbs) if found else 0
        logger.info(f"{stem_at}: {len(rows):,} points, {n_limbs} limbs")
    return Orchard(**vars(shared), entered=entered, limbs=limbs)
