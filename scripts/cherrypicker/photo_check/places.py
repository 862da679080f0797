"""Places along a skeleton's tubes, what the photos say of each, and pieces of such places."""

from typing import NamedTuple

import numpy as np

from cherrypicker.evidence.existence import RUN_STEPS, Witnesses
from cherrypicker.files import rounded
from cherrypicker.geometry.neighbors import link_components
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.skeleton import node_order
from cherrypicker.skeleton.model import Skeleton, densify

# Places on the skeleton, pixels of the photos apart: a line's point is one pixel
STEP_PX = 2.0


class Places(NamedTuple):
    """Places evenly along a skeleton's tubes."""

    # points, along: (n, 3) float64: on the axes; unit vectors towards the tips
    points: np.ndarray
    along: np.ndarray
    # radius, length: (n,) float64: of the tube; of the skeleton that the place stands for
    radius: np.ndarray
    length: np.ndarray
    # node, order: (n,) int64: upper node of the edge that holds it; order of its axis
    node: np.ndarray
    order: np.ndarray
    parent: np.ndarray  # (n,) int64: the place below it, always before it; -1 where the root is
    step: float  # how far they lie apart at most

    @property
    def pixel(self) -> float:
        """The size of the photos' pixel there."""
        return self.step / STEP_PX

    def select(self, rows: np.ndarray) -> "Places":
        """Return some of the places, by rows or a mask; a parent stays a row of all."""
        return self._replace(**{name: getattr(self, name)[rows] for name in self._fields[:-1]})


def ask_places(
    skeleton: Skeleton, photos: ScanPhotos, wood: np.ndarray, seed: int
) -> tuple[Places, Witnesses]:
    """Ask the photos about places on a skeleton.

    They lie `STEP_PX` apart by the photos' median distance and focal length. The photos
    learn from those that hold ``wood``, (n_wood, 3), points of the cloud.
    """
    middle = (skeleton.points.min(axis=0) + skeleton.points.max(axis=0)) / 2
    distance = float(np.median(np.linalg.norm(photos.poses.centers - middle, axis=1)))
    step = STEP_PX * distance / float(np.median(photos.poses.K[:, 0, 0]))
    places = places_along(skeleton, step)
    hung = places.points, places.radius, places.parent
    return places, Witnesses(photos, *hung, places.pixel, wood, seed=seed)


def places_along(skeleton: Skeleton, step: float) -> Places:
    """Return places at most `step` apart along a skeleton that has an edge."""
    points, node, radius, length = densify(skeleton, step)
    along = skeleton.points - skeleton.points[skeleton.parent]
    along /= np.maximum(skeleton.edge_length, 1e-12)[:, None]
    order = node_order(skeleton)
    # the first is the root itself, which has no edge
    rows = slice(1, None)
    node = node[rows]
    last = np.full(len(skeleton), -1)
    last[node] = np.arange(len(node))  # of an edge's places, which stand in a row
    is_first = np.diff(node, prepend=-1) != 0
    below = np.where(is_first, last[skeleton.parent[node]], np.arange(len(node)) - 1)
    wood = radius[rows], length[rows]
    return Places(points[rows], along[node], *wood, node, order[node], below, step)


def pieces_of(
    points: np.ndarray, length: np.ndarray, probability: np.ndarray, step: float
) -> list[dict]:
    """Join places, points (n, 3) a step apart along wood, to pieces as long as a run or longer.

    Those within a run of one another are one piece. Each stands for a length (n,), and is wood with
    a probability (n,). A piece has a ``length``, ``p_exists``, the mean over it, ``at``, the middle
    of its points, and ``low`` and ``high``, the corners of their box.
    """
    if len(points) < 2:
        return []
    run = RUN_STEPS * step
    member = link_components(points, run)
    total = np.bincount(member, length)
    order = [one for one in np.argsort(-total, kind="stable") if total[one] >= run]
    found = []
    for one in order:
        own = points[member == one]
        ways = {"at": np.median(own, axis=0), "low": own.min(axis=0), "high": own.max(axis=0)}
        there = np.average(probability[member == one], weights=length[member == one])
        told = {"length": rounded(total[one]), "p_exists": rounded(there)}
        found.append(told | {k: v.round(6).tolist() for k, v in ways.items()})
    return found
