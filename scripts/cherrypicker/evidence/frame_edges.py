"""Where the photos end, not the tree: sides of the wood beyond which few photos look."""

from dataclasses import dataclass

import numpy as np

from cherrypicker.geometry.neighbors import RANK
from cherrypicker.poses import Poses

BEYOND = 0.05  # of the tree's extent: what lies so far beyond its outermost wood (guess)
# Of the photos that frame the tree: a tenth do where they cut it off, three quarters and more on
# all sides of the demo's trees (docs/traits.md)
FEWEST = 0.25
N_AZIMUTHS = 8
MOST_POINTS = 2000  # enough to tell how many photos frame the tree


@dataclass(frozen=True)
class FrameEdge:
    """A side of a tree beyond which few photos look."""

    azimuth_deg: float | None  # from +x towards +y; None above the tree
    beyond: float  # how far beyond the outermost wood the photos were asked, unit of the cloud
    # n_photos, n_usual: photos that frame that place, and the median over the wood
    n_photos: int
    n_usual: int


def frame_edges(poses: Poses, wood: np.ndarray) -> list[FrameEdge]:
    """Find the sides, and the top, where the tree may go on outside the photos.

    A tree that ends inside the photos is surrounded by places that they frame as well, sky or
    neighbours; where it is cut off at their edge, what lies `BEYOND` its outermost wood is framed
    by less than `FEWEST` of the photos that frame the wood itself, points (n_wood, 3) in the frame
    and unit of the poses, z up. The top comes first, then the sides by azimuth; none where the
    photos frame all.
    """
    usual = int(np.median(poses.frames(wood[:: 1 + len(wood) // MOST_POINTS]).sum(axis=0)))
    azimuths = np.arange(N_AZIMUTHS) * 2 * np.pi / N_AZIMUTHS
    directions = np.zeros((N_AZIMUTHS + 1, 3))
    directions[0, 2] = 1.0
    directions[1:, 0], directions[1:, 1] = np.cos(azimuths), np.sin(azimuths)
    along = wood @ directions.T
    steps = BEYOND * np.ptp(along, axis=0)
    rank = min(RANK, len(wood))
    outermost = wood[np.argpartition(along, -rank, axis=0)[-rank]]
    counts = poses.frames(outermost + steps[:, None] * directions).sum(axis=0)
    names = [None, *np.degrees(azimuths).tolist()]
    return [
        FrameEdge(name, float(step), int(count), usual)
        for name, step, count in zip(names, steps, counts, strict=True)
        if count < FEWEST * usual
    ]
