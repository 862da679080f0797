"""Why did this point go? Every point that a stage took out, with what took it out."""

import logging
import os
from typing import NamedTuple

import numpy as np

from cherrypicker.classes import Removal, wood_mask
from cherrypicker.errors import StageError
from cherrypicker.files import read_npz
from cherrypicker.pointcloud import PointCloud, joined

logger = logging.getLogger(__name__)


class Earlier(NamedTuple):
    """What a tree from photos was before its cloud was metric."""

    aligned: PointCloud
    cropped: PointCloud
    denoised_by: np.ndarray  # (n_cropped,) uint8: `Removal`, 0 of points that stay
    factor: float  # from their frame to that of the segmented cloud


def read_removed_by(path: str | os.PathLike, cropped: PointCloud) -> np.ndarray:
    """Read what denoising took out of a cropped cloud, ``denoise.npz``: `Removal`, 0 of the rest.

    A `StageError` where it is missing, broken or of another cloud.
    """
    taken = read_npz(path, ("removed_by",))["removed_by"]
    if taken.shape != (len(cropped),):
        raise StageError(
            f"it tells of {taken.size} points, the cropped cloud has {len(cropped)}", file=path
        )
    return taken


def removed_points(
    segmented: PointCloud, owner: np.ndarray, stem: int, earlier: Earlier | None = None
) -> PointCloud:
    """All points that the stages took out, in the frame of a cloud with ``label``.

    They have colours where it has any and ``removed_by`` (uint8, see
    `cherrypicker.classes.Removal`). `owner` (n_segmented,) is the stem on which each point of wood
    hangs, -1 for none, `stem` the target's; only a tree from photos has an `earlier`.
    """
    is_wood = wood_mask(np.asarray(segmented["label"]))
    by = np.zeros(len(segmented), np.uint8)
    by[is_wood & (owner >= 0) & (owner != stem)] = Removal.OTHER_TREE
    by[is_wood & (owner < 0)] = Removal.LOOSE
    parts = [(segmented, by)]
    if earlier is not None:
        before, after = (
            np.ascontiguousarray(cloud.points).view("V24").ravel()  # a point's bytes as one
            for cloud in (earlier.aligned, earlier.cropped)
        )
        is_out = ~np.isin(before, after)
        for cloud, taken in (
            (earlier.aligned, is_out * np.uint8(Removal.REGION)),
            (earlier.cropped, earlier.denoised_by),
        ):
            parts.append((PointCloud(earlier.factor * cloud.points, cloud.colors), taken))
    removed = joined(
        [cloud.with_fields(removed_by=taken).select(taken > 0) for cloud, taken in parts]
    )
    counts = np.bincount(removed["removed_by"], minlength=len(Removal) + 1)
    for reason in Removal:
        logger.info("%s points: %s", f"{counts[reason]:,}", reason.title)
    return removed
