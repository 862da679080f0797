"""From the wood, and where the contraction put it, to the rooted skeleton with radii."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from cherrypicker.classes import Label
from cherrypicker.errors import StageError
from cherrypicker.geometry.neighbors import Neighbors
from cherrypicker.graph.spanning_tree import spanning_tree
from cherrypicker.limbs.growth import Limbs
from cherrypicker.limbs.joints import join_limbs
from cherrypicker.pointcloud import PointCloud
from cherrypicker.skeleton.axis_radii import measure_radii
from cherrypicker.skeleton.model import Skeleton

# An edge with no point so near to the surface around it bridges missing data (guess)
GAP_IN_SPACINGS = 3.0
UNTOLD = 1e3  # a node without an error errs by so many times the largest: it has no say


@dataclass(frozen=True)
class GraphOptions:
    """How the wood is connected; the fields are config keys of ``graph`` and ``skeleton``."""

    method: str = "limbs"
    spacing_m: float = 0.01
    n_neighbors: int = 30


def extract_skeleton(
    contracted: PointCloud,
    cloud: PointCloud,
    options: GraphOptions | None = None,
    *,
    base: npt.ArrayLike | None = None,
    limbs: Limbs | None = None,
) -> Skeleton:
    """Connect and root the wood, and measure the radii.

    Contracted points have the fields ``label`` and ``source``, their row in the labelled cloud.
    Limbs are those of the points before they were moved, as the contraction gives them: they are
    joined. Left out, the minimum spanning tree is taken over the contracted points (paper,
    section Graph), from the base of the stem, (3,). A `StageError` where there are too few points
    for a graph, or the limbs are not theirs.
    """
    options = options or GraphOptions()
    labels = np.asarray(contracted["label"])
    entered = cloud.points[contracted["source"]]
    surface = cloud.points[np.isin(cloud["label"], np.unique(labels))]
    spacing = options.spacing_m
    if limbs is None:
        spacing = max(spacing, Neighbors(entered, 1).spacing(1))
        skeleton = spanning_tree(
            contracted.points, labels, spacing_m=spacing, k=options.n_neighbors, base=base
        )
        widest = 1.5 * float(np.quantile(np.linalg.norm(contracted.points - entered, axis=1), 0.99))
    else:
        skeleton = _joined(entered, labels, limbs, spacing)
        widest = 1.5 * float(skeleton.radius.max())
    skeleton.unit, skeleton.frame = contracted.unit, contracted.frame
    told = measure_radii(skeleton, surface, spacing=spacing, max_radius=max(3 * spacing, widest))
    if limbs is None:
        return told
    radius = isotonic_radii(skeleton.parent, skeleton.radius, told.fields["radius_error"])
    return replace(told, radius=radius)


def _joined(points: np.ndarray, labels: np.ndarray, found: Limbs, spacing_m: float) -> Skeleton:
    """The limbs grown from some points, joined and labelled, with the fields ``gap``, ``limb``.

    Points of its limb tell a node's class: trunk from the root on, then the most frequent other.
    """
    if len(found.member) != len(points):
        raise StageError(f"limbs of {len(found.member)} points for a tree of {len(points)}")
    nodes, parent, radius, limb = join_limbs(found.limbs, found.spacing, spacing_m)
    others = labels[labels != Label.TRUNK]
    rest = int(np.bincount(others).argmax()) if len(others) else int(Label.TRUNK)
    label = np.full(len(nodes), rest)
    for number in np.unique(limb):
        own, rows = np.flatnonzero(limb == number), np.flatnonzero(found.member == number)
        bearer = parent[own[0]]
        if bearer < 0 or label[bearer] == Label.TRUNK:
            nearest = cKDTree(nodes[own]).query(points[rows])[1]
            votes = np.where(labels[rows] == Label.TRUNK, 1.0, -1.0)
            # the stretch from the start that holds the most trunk points more than others
            gain = np.append(0.0, np.cumsum(np.bincount(nearest, votes, len(own))))
            label[own[: int(np.argmax(gain))]] = Label.TRUNK
    up = np.maximum(parent, 0)
    middle = (nodes + nodes[up]) / 2
    around = np.maximum(radius, radius[up]) + GAP_IN_SPACINGS * found.spacing
    gap = (cKDTree(points).query(middle)[0] > around).astype(np.int64)
    gap[0] = 0
    return Skeleton(nodes, parent, radius, label, {"gap": gap, "limb": limb})


def isotonic_radii(parent: np.ndarray, radius: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Least-squares radii that are nowhere larger than their parent's, (n_nodes,) float64.

    From the tips to the root every node pools with the child block of the largest mean for as long
    as that mean is above its own (isotonic regression on a tree, Pardalos and Xue 1999). Each
    weighs by the inverse of its variance: where a thick limb leaves a fork whose own nodes have few
    points, the limb says how thick the fork is, and a limb that is seen from one side says little.
    Parents (n_nodes,) have smaller numbers, -1 the root's; an error (n_nodes,) of 0 is not known.
    """
    largest = error.max() or 1.0
    weight = (largest / np.where(error > 0, error, UNTOLD * largest)) ** 2
    mass, total, block = weight.tolist(), (weight * radius).tolist(), list(range(len(radius)))
    beyond: list[list[int]] = [[] for _ in block]  # the child blocks of each

    def mean(one: int) -> float:
        return total[one] / mass[one]

    for node in reversed(range(len(radius))):  # parents come before children
        while beyond[node]:
            best = max(beyond[node], key=mean)
            if mean(best) <= mean(node):
                break
            beyond[node].remove(best)
            beyond[node] += beyond[best]
            total[node] += total[best]
            mass[node] += mass[best]
            block[best] = node
        if node:
            beyond[parent[node]].append(node)
    for node in range(len(radius)):
        block[node] = block[block[node]]
    return np.array([mean(one) for one in block])
