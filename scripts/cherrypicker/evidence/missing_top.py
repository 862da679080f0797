"""A top that the photos show before the sky and the cloud does not hold."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from cherrypicker.evidence.coverage import ask_voxels
from cherrypicker.mvs.scan_photos import ScanPhotos

# Side of a voxel, and how far above, below and beside the highest wood is looked, as shares of the
# tree's height: cut down to 0.95 and 0.85 of their height three trees were found 1.5 cm too low to
# 1.7 cm too tall, within a voxel; halved and doubled, each tells of three whole scans that no top
# lacks. So that a third may be gone, half is looked at
VOXEL = 0.02
ABOVE = 0.5
BESIDE = 0.125
# Wood of the cloud within so many voxels explains what a photo shows there; so much of the top may
# be missing without a word
NEAR_VOXELS = 2.0


@dataclass(frozen=True)
class MissingTop:
    """How much taller the photos show a tree than its cloud is."""

    height: float  # highest wood that the photos show, over the foot, unit of the cloud
    found: float  # highest wood of the cloud, over the foot
    n_photos: int  # photos that frame what is missing, median over its voxels


def find_missing_top(photos: ScanPhotos, wood: np.ndarray, foot: np.ndarray) -> MissingTop | None:
    """Look for wood above a tree that the photos show and its cloud does not hold.

    Beside the crown silhouettes cross one another and show wood where there is none; above it there
    is nothing but sky, and wood that many photos agree on is wood. The tree's points (n_wood, 3)
    and its foot (3,) are in the frame and unit of the photos, z up. None where the cloud reaches as
    high as the photos show, or nobody can tell.
    """
    top = wood[:, 2].max()
    height = float(top - foot[2])
    size = VOXEL * height
    upper = wood[wood[:, 2] > top - ABOVE * height]
    low, high = upper.min(axis=0) - BESIDE * height, upper.max(axis=0) + BESIDE * height
    low[2], high[2] = top - 2 * NEAR_VOXELS * size, top + ABOVE * height
    shape = np.ceil((high - low) / size).astype(int)
    cells = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
    centers = low + size * (cells.reshape(-1, 3) + 0.5)
    distance = cKDTree(upper).query(centers, distance_upper_bound=NEAR_VOXELS * size)[0]
    near = distance < np.inf
    n_framing, p_wood = ask_voxels(photos, centers, size, distance < 0.5 * size, ~near)
    is_wood = p_wood > 0.5
    # What hangs together with the tree; a neighbour's twigs do not
    label = ndimage.label(is_wood.reshape(shape), structure=np.ones((3, 3, 3)))[0].ravel()
    own = is_wood & np.isin(label, np.unique(label[near & is_wood]))
    missing = own & ~near & (centers[:, 2] > top + NEAR_VOXELS * size)
    if not missing.any():
        return None
    return MissingTop(
        height=float(centers[missing, 2].max() - foot[2]),
        found=height,
        n_photos=int(np.median(n_framing[missing])),
    )
