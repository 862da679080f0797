"""What the photos show of the region of interest, and what the depth maps hold of it, in voxels.

A voxel is wood as far as the photos' words on it say so, which they learn from the voxels that hold
something and from those that hold nothing (`cherrypicker.evidence.witnesses`). Where it is and no
depth map holds anything, the cloud lacks what the photos show; nothing else in the pipeline can
tell, since a cloud that ends is no error.
"""

import logging
from typing import Any

import numpy as np

from cherrypicker.evidence.existence import summed, weigh
from cherrypicker.evidence.witnesses import UNASKED, count, look, shares, words
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.placement.region import Region

logger = logging.getLogger(__name__)

# Voxels across the region: 16 cm where the cameras stand 3.2 m away (guess)
N_ACROSS = 40
# Photos are looked at by every so many pixels: a voxel is some forty wide
STEP_PX = 4


def measure_coverage(photos: ScanPhotos, region: Region) -> dict[str, Any]:
    """Count, for every voxel of the region, what photos and depth maps have there.

    The content of ``dense/coverage.json``: the region, the side of its voxels and how many go
    across it, their places ``cells`` in the cube around it (z the fastest), and of each how many
    photos frame it, how many depth maps hold something there, and how probable wood is by the
    photos; lengths in units of COLMAP's frame.
    """
    size, low = 2.0 * region.radius / N_ACROSS, region.center - region.radius
    held_in = np.zeros(N_ACROSS**3, dtype=int)
    for i, view in enumerate(photos.views):
        depth = photos.depth(i)
        if depth is not None:
            y, x = np.nonzero(depth[::STEP_PX, ::STEP_PX] > 0.0)
            z = depth[STEP_PX * y, STEP_PX * x].astype(np.float64)
            u = (STEP_PX * x + 0.5 - view.K[0, 2]) / view.K[0, 0]
            v = (STEP_PX * y + 0.5 - view.K[1, 2]) / view.K[1, 1]
            points = (np.stack([u * z, v * z, z], axis=1) - view.t) @ view.R
            places = np.floor((points - low) / size).astype(int)
            places = places[((places >= 0) & (places < N_ACROSS)).all(axis=1)]
            held_in[np.unique(places @ [N_ACROSS**2, N_ACROSS, 1])] += 1
    centers = voxel_centers(region.center, region.radius, np.arange(N_ACROSS**3))
    cells = np.flatnonzero(region.holds(centers))
    n_holding = held_in[cells]
    held = n_holding > 0
    prior = float(held.mean())
    n_framing, p_wood = ask_voxels(photos, centers[cells], size, held, ~held, prior=prior)
    logger.info(
        f"half of the region's {len(cells):,} voxels of {size:.3g} are framed by "
        f"{int(np.median(n_framing))} photos or more, {100 * prior:.1f} % are held by a depth map"
    )
    return {
        "region": {"center": region.center, "radius": region.radius},
        "camera_distance": region.distance,
        "voxel_size": size,
        "n_across": N_ACROSS,
        "cells": cells,
        "n_framing": n_framing,
        "n_holding": n_holding,
        "p_wood": p_wood.round(3),
    }


def ask_voxels(
    photos: ScanPhotos,
    centers: np.ndarray,
    size: float,
    held: np.ndarray,
    empty: np.ndarray,
    *,
    prior: float = 0.5,
) -> tuple[np.ndarray, np.ndarray]:
    """Ask all photos whether there is wood in voxels.

    Their centres (n_voxels, 3) are in the photos' frame, ``size`` is their side. The photos learn
    from voxels known to hold something (``held``) and to hold nothing (``empty``), (n_voxels,)
    bool; the prior is the probability of wood before a photo is asked.

    Returns the number of photos that frame the middle of each and in which no user hides any of it,
    (n_voxels,) int64, and the probability that wood is in it, (n_voxels,) float64.
    """
    seen = look(photos, centers, np.zeros(len(centers)), 0.5 * np.sqrt(3.0) * size)
    learnt = shares(*(count(seen, each.astype(float)) for each in (held, empty)))
    told = words(seen, learnt)
    odds = np.exp(summed(told, weigh(told, held, empty))) * prior / max(1.0 - prior, 1e-9)
    return (seen.shown != UNASKED).sum(axis=0), odds / (1.0 + odds)


def voxel_centers(
    center: np.ndarray, radius: float, cells: np.ndarray, n_across: int = N_ACROSS
) -> np.ndarray:
    """Middles (n, 3) of the voxels at some places of the cube around a ball."""
    place = np.stack(np.unravel_index(cells, (n_across,) * 3), axis=1)
    return center + radius * ((2.0 * place + 1.0) / n_across - 1.0)
