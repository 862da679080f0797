"""What is missing: thin wood before the sky that no tube of the skeleton explains.

The fusion has followed the photos' lines before the sky (`cherrypicker.mvs.silhouettes`), so that
its cloud holds what several photos from different sides agree on, whatever later stages made of it.
A line that a point of that cloud explains and no tube does is wood that the skeleton lacks, as far
as all photos together say that it is wood.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.evidence.existence import Witnesses
from cherrypicker.evidence.witnesses import THIN_PX
from cherrypicker.geometry.neighbors import link_components
from cherrypicker.mvs.lines.lines import explain, gather_lines
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.photo_check.places import Places

# Patches of missing wood this far apart, of the reach of the search, hang together (guess: 0.2 to
# 0.3 m; on a walk through rows the next row's twigs lie 2 m off)
JOINED = 0.1


class Missing(NamedTuple):
    """Thin wood before the sky, and what of it no tube explains."""

    points: np.ndarray  # (n, 3) float64: places of missing wood, about a pixel apart
    # length, probability: (n,) float64: of wood that each stands for; that it is there
    length: np.ndarray
    probability: np.ndarray
    # shown, lacking: (n_photos,) float64: length of lines in each photo that tubes explain, and
    # that missing wood does
    shown: np.ndarray
    lacking: np.ndarray


def find_missing(
    photos: ScanPhotos,
    witnesses: Witnesses,
    places: Places,
    fused: np.ndarray,
    others: np.ndarray,
    reach: float,
    threads: int,
) -> Missing:
    """Find the thin wood that points of a cloud explain and no tube does.

    The witnesses are the photos, once the skeleton's places, at most two pixels apart, have taught
    them. Points of the fused cloud where wood is looked for, within a reach around the tree's
    middle, are (n_fused, 3), in the skeleton's frame. What is there and no wood of this tree is
    ``others`` (n_others, 3): a place nearer to it than to the tree is not missing, nor is one that
    does not join the tree.
    """
    lines = gather_lines(photos, witnesses.clear_word)
    explain(lines, fused, threads)
    by_cloud = lines.explained.copy()
    lines.explained[:] = 0.0
    explain(lines, places.points, threads, places.radius)
    by_tubes = lines.explained.copy()
    # Places of lines that the cloud alone explains, each once, and the size of a pixel there
    held, pixels = [np.empty((0, 3))], [np.empty(0)]
    for i, view in enumerate(photos.views):
        rows = np.arange(lines.first[i], lines.first[i + 1])
        rows = rows[(by_cloud[rows] > 0.0) & (lines.explained[rows] == 0.0)]
        held.append(view.center + by_cloud[rows, None] * view.rays(lines.uv[rows]))
        pixels.append(by_cloud[rows] / lines.focal[i])
        explain(lines, held[-1], threads)
    found, pixel = np.concatenate(held), np.concatenate(pixels)
    if len(found):
        own, row = cKDTree(places.points).query(found)
        kept = hang_together(found, own, JOINED * reach)
        kept &= own > places.radius[row] + THIN_PX * places.pixel
        if len(others):
            kept &= own <= cKDTree(others).query(found)[0]
        found, pixel = found[kept], pixel[kept]
    # a line is the image of what is two pixels wide
    probability = witnesses.judge(found, pixel).probability
    lines.explained[:] = by_tubes
    explain(lines, found, threads)
    size = lines.explained / lines.focal[lines.owner]  # of a pixel at what explains the line
    n_photos, is_tube = len(photos.views), by_tubes > 0.0
    return Missing(
        points=found,
        length=pixel * 4.0 / np.pi,  # a photo shows pi / 4 of a length, in the mean (Cauchy 1832)
        probability=probability,
        shown=np.bincount(lines.owner, np.where(is_tube, size, 0.0), minlength=n_photos),
        lacking=np.bincount(lines.owner, np.where(is_tube, 0.0, size), minlength=n_photos),
    )


def hang_together(points: np.ndarray, own: np.ndarray, gap: float) -> np.ndarray:
    """Which places join a tree, over one another, across no more than a gap: (n,) bool.

    The points (n, 3) lie ``own`` (n,) away from the tree. A tree of the next row may stand before
    the sky as well, and no point of it need be in the cloud.
    """
    group = link_components(points, gap)
    return np.isin(group, group[own <= gap])
