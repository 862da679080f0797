"""Finished scans spoilt on purpose: the top cut off, a limb removed, strands through the air.

Each spoils skeleton and cloud alike, as a stage before the graph would have: the wood that is gone
has no points, a strand has some. The photos stay as they are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import Label, wood_mask
from cherrypicker.geometry.tree_walks import sum_from_root, sum_from_tips
from cherrypicker.pointcloud import PointCloud
from cherrypicker.skeleton import axes, axis_of_node
from cherrypicker.skeleton.model import Skeleton, densify

__all__ = ["SIZES", "Spoilt", "spoil"]

#: What is done to a scan, and how much of it: a share of the height that stays, metres, or a share
#: of the skeleton's length, in strands of a quarter of a metre to a metre.
SIZES = {
    "top cut off, to": (0.95, 0.85, 0.70),
    "limb removed, m": (0.25, 0.5, 1.0),
    "strand added, m": (0.25, 0.5, 1.0),
    "strands added, of the length": (0.08,),
}
STEP_M = 0.01
STRAND_RADIUS_M = 0.003
# A strand leaves wood within so much of its way, and keeps so far from all wood afterwards
LEAVES_M, APART_M = 0.05, 0.03
# Ways that are tried for a strand
N_TRIES = 2000


class Spoilt(NamedTuple):
    """A spoilt scan."""

    skeleton: Skeleton
    cloud: PointCloud
    # missing, added: (n, 3) float64: places a centimetre apart along the wood that was taken, and
    # of what was put where nothing is
    missing: np.ndarray
    added: np.ndarray
    length: float  # of what was taken or put


def spoil(skeleton: Skeleton, cloud: PointCloud, kind: str, size: float, seed: int = 0) -> Spoilt:
    """Spoil a finished scan by a kind of `SIZES`; its cloud has the field ``label``, in its frame.

    Raises a ValueError when the tree has no room for it.
    """
    rng = np.random.default_rng(seed)
    if kind.startswith("strands"):
        whole, spoilt = float(skeleton.edge_length.sum()), []
        while sum(each.length for each in spoilt) < size * whole:
            one = float(rng.choice(SIZES["strand added, m"]))
            spoilt.append(_with_strand(skeleton, cloud, one, rng))
            skeleton, cloud = spoilt[-1].skeleton, spoilt[-1].cloud
        added = np.concatenate([each.added for each in spoilt])
        length = sum(each.length for each in spoilt)
        return Spoilt(skeleton, cloud, np.empty((0, 3)), added, length)
    if kind.startswith("strand"):
        return _with_strand(skeleton, cloud, size, rng)
    if kind.startswith("top"):
        low, high = skeleton.points[:, 2].min(), skeleton.points[:, 2].max()
        is_gone = skeleton.points[:, 2] > low + size * (high - low)
    else:
        # an axis that bears about so much wood, one of the three nearest to it
        above = sum_from_tips(skeleton.parent, skeleton.edge_length)
        starts = np.array([axis.nodes[0] for axis in axes(skeleton)[1:]])
        nearest = np.argsort(np.abs(above[starts] - size), kind="stable")
        is_gone = np.arange(len(skeleton)) == starts[rng.choice(nearest[:3])]
    return _without(skeleton, cloud, is_gone)


def _without(skeleton: Skeleton, cloud: PointCloud, is_gone: np.ndarray) -> Spoilt:
    """Take nodes and all beyond them from a scan, and the wood points nearest to them."""
    is_gone = sum_from_root(skeleton.parent, is_gone.astype(float)) > 0
    places = densify(skeleton, STEP_M)
    gone = is_gone[places.node]
    is_kept = ~wood_mask(cloud["label"])
    is_kept |= ~gone[places.nearest(cloud.points)[1]]
    return Spoilt(
        skeleton.select(~is_gone),
        cloud.select(is_kept),
        places.points[gone],
        np.empty((0, 3)),
        float(places.length[gone].sum()),
    )


def _with_strand(
    skeleton: Skeleton, cloud: PointCloud, size: float, rng: np.random.Generator
) -> Spoilt:
    """Put a straight strand on a scan that leaves the wood, with points on it."""
    places = densify(skeleton, STEP_M)[0]
    tree, way = cKDTree(places), np.arange(STEP_M, size + STEP_M / 2, STEP_M)
    low, high = places.min(axis=0), places.max(axis=0)
    axis = axis_of_node(skeleton, axes(skeleton))
    for _ in range(N_TRIES):
        start = int(rng.integers(1, len(skeleton)))
        direction = rng.normal(size=3)
        strand = skeleton.points[start] + way[:, None] * direction / np.linalg.norm(direction)
        free = tree.query(strand[way > LEAVES_M])[0] > APART_M
        inside = ((strand >= low) & (strand <= high)).all()
        if axis[start] > 0 and free.all() and inside:
            break
    else:
        raise ValueError(f"no room for a strand of {size:g} m")
    n = len(strand)
    first = len(skeleton)
    label = np.full(n, Label.BRANCH)
    longer = Skeleton(
        np.vstack([skeleton.points, strand]),
        np.concatenate([skeleton.parent, [start], np.arange(first, first + n - 1)]),
        np.concatenate([skeleton.radius, np.full(n, STRAND_RADIUS_M)]),
        np.concatenate([skeleton.label, label]),
        unit=skeleton.unit,
        frame=skeleton.frame,
    )
    points = np.vstack([cloud.points, strand])
    labels = np.concatenate([cloud["label"], label.astype(np.uint8)])
    more = PointCloud(points, fields={"label": labels})
    return Spoilt(longer, more, np.empty((0, 3)), strand, float(size))
