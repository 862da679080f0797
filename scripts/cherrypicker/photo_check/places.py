"""A skeleton as places along its tubes, and its photos in the skeleton's frame."""

from __future__ import annotations

import os
from typing import NamedTuple

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.mvs.workspace import Workspace, view_of
from cherrypicker.poses import Poses
from cherrypicker.skeleton import axes, node_order
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.traits.support import densify

# Places on the skeleton, pixels of the photos apart: a line's point is one pixel
STEP_PX = 2.0


class MetricWorkspace(Workspace):
    """A dense workspace whose cameras stand in another frame and unit.

    Parameters
    ----------
    folder : path-like
    poses : Poses
        Of the same photos, in the frame of the skeleton; photos without one are left out.

    Raises
    ------
    StageError
        As `Workspace`, and when no photo has a pose.
    """

    def __init__(self, folder: str | os.PathLike, poses: Poses):
        super().__init__(folder)
        moved = dict(zip(poses.names.tolist(), poses.cam_from_world, strict=True))
        here = self.poses
        kept = np.flatnonzero([name in moved for name in here.names.tolist()])
        if not len(kept):
            raise StageError("no undistorted photo has a pose", file=folder)
        self.poses = Poses(
            here.names[kept],
            np.array([moved[name] for name in here.names[kept].tolist()]),
            here.K[kept],
            here.width[kept],
            here.height[kept],
        )
        self.views = [view_of(self.poses, i) for i in range(len(kept))]


class Places(NamedTuple):
    """Places evenly along a skeleton's tubes.

    Attributes
    ----------
    points, along : ndarray of shape (n, 3), float64
        On the axes; unit vectors towards the tips.
    radius, length : ndarray of shape (n,), float64
        Of the tube; of the skeleton that the place stands for.
    node, order : ndarray of shape (n,), int64
        Upper node of the edge that holds it; order of its axis.
    """

    points: np.ndarray
    along: np.ndarray
    radius: np.ndarray
    length: np.ndarray
    node: np.ndarray
    order: np.ndarray


def step_of(skeleton: Skeleton, poses: Poses) -> float:
    """Return how far places lie apart, `STEP_PX` of half of the photos at the skeleton's middle."""
    middle = (skeleton.points.min(axis=0) + skeleton.points.max(axis=0)) / 2
    distance = float(np.median(np.linalg.norm(poses.centers - middle, axis=1)))
    return STEP_PX * distance / float(np.median(poses.K[:, 0, 0]))


def places_along(skeleton: Skeleton, step: float) -> Places:
    """Return places at most `step` apart along a skeleton that has an edge."""
    points, node, radius, length = densify(skeleton, step)
    along = skeleton.points - skeleton.points[skeleton.parent]
    along /= np.maximum(skeleton.edge_length, 1e-12)[:, None]
    order = node_order(skeleton, axes(skeleton))
    # the first is the root itself, which has no edge
    rows = slice(1, None)
    return Places(
        points[rows], along[node[rows]], radius[rows], length[rows], node[rows], order[node[rows]]
    )
