"""The paper's systematic set of trees: clouds with noise and holes over exact skeletons.

Meyer et al., "CherryPicker" (CVPR workshops 2023), section 4.2; what it leaves open is fixed here:

- Templates fir, larch and pine in turn, tips of 3 to 6 mm radius.
- The surface is sampled evenly with `DENSITY` points a square metre. sigma_d is the mean distance
  of a point to its nearest neighbour on the surface, for a Poisson process of density rho
  ``1 / (2 sqrt(rho))`` = 1.58 mm.
- Gaussian noise of standard deviation 3 sigma_d = 4.74 mm in each coordinate.
- Then one point a voxel of 1.5 cm: the mean of its points, with the label of most of them.
- Occluded variant: six random points of the trunk, and every point within 8 cm of one of them is
  gone. The points are at least 8 cm apart, so that there are six holes.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import Label
from cherrypicker.geometry.sampling import majority_label, voxel_sample
from cherrypicker.pointcloud import PointCloud
from cherrypicker.skeleton.model import Skeleton
from cherrypicker_lab.orchard.grow.templates import CONIFERS, grow_any
from cherrypicker_lab.orchard.grow.tree import Tree
from cherrypicker_lab.orchard.seen.tubes import sample_tubes

DENSITY = 100_000.0
SIGMA_D_M = 0.5 / np.sqrt(DENSITY)
NOISE_M = 3.0 * SIGMA_D_M
VOXEL_M = 0.015
TIP_RADIUS_M = (0.003, 0.006)
N_HOLES, HOLE_RADIUS_M = 6, 0.08


@dataclass
class SetTree:
    """One tree of the set."""

    name: str  # ``fir_00`` and so on
    template: str
    noise: PointCloud  # field `label` uint8 (trunk or branch); frame ``metric``, unit m
    holes: PointCloud  # the same cloud without what lies in the holes
    hole_centres: np.ndarray  # (n, 3): m
    skeleton: Skeleton  # the truth, with ``order``
    tree: Tree  # what it all comes from


def cut_holes(rng, cloud):
    """Cut spherical holes around random points of the trunk of a cloud with a field `label`.

    Returns the cloud that is left and the centres of the holes, (n, 3), m.
    """
    trunk = cloud.points[cloud["label"] == Label.TRUNK]
    centres = []
    for candidate in trunk[rng.permutation(len(trunk))]:
        if len(centres) == N_HOLES:
            break
        if all(np.linalg.norm(candidate - c) >= HOLE_RADIUS_M for c in centres):
            centres.append(candidate)
    centres = np.array(centres).reshape(-1, 3)
    distance = cKDTree(centres).query(cloud.points)[0]
    return cloud.select(distance > HOLE_RADIUS_M), centres


def noisy_surface(rng, tree):
    """Sample a tree's surface with the set's points a square metre and its noise.

    Returns the points (n, 3), m, and their labels (n,) uint8, trunk or branch.
    """
    surface = sample_tubes(rng, tree, DENSITY)
    noisy = surface.points + rng.normal(0.0, NOISE_M, surface.points.shape)
    return noisy, tree.labels[surface.axis]


def make_set_tree(seed, number, *, trunk_radius=None):
    """Make the tree of a number (its template is fir, larch, pine in turn) of a seed's set.

    The stem's radius above the root flare, m, with which the branches are thicker, is drawn by
    default: 4 to 8 cm.
    """
    template = CONIFERS[number % len(CONIFERS)]
    rng = np.random.default_rng([int(seed), int(number), 307])
    tree = grow_any(int(rng.integers(1 << 31)), template, tip_radius=TIP_RADIUS_M,
                    trunk_radius=trunk_radius)  # fmt: skip
    sampled, kinds = noisy_surface(rng, tree)
    points, voxel, n_in = voxel_sample(sampled, VOXEL_M)
    labels = majority_label(kinds, voxel, len(n_in)).astype(np.uint8)
    noise = PointCloud(points, fields={"label": labels}, frame="metric", unit="m")
    holes, centres = cut_holes(rng, noise)
    name = f"{template}_{number:02d}"
    return SetTree(name, template, noise, holes, centres, tree.skeleton(), tree)
