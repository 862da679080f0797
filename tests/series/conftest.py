"""One generated tree at a few dates, its exact skeletons in frames of their own."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cherrypicker.series.compare import Scan
from cherrypicker.series.wood import sample_wood
from cherrypicker.skeleton import axes
from cherrypicker.traits.branches import branch_rows
from cherrypicker_lab.orchard.grow.growth import grow_tree
from cherrypicker_lab.orchard.grow.seasons import first_date, grow_a_year, prune

NOISE_M = 0.001


def frame_of(turn, shift):
    frame = np.eye(4)
    frame[:3, :3] = Rotation.from_euler("zx", [turn, 0.008]).as_matrix()
    frame[:3, 3] = shift
    return frame


def scan_of(name, date, dated, frame, seed):
    """A date as a finished scan has it: noisy nodes, their wood seen everywhere."""
    rng = np.random.default_rng(seed)
    skeleton = dated.tree.skeleton()
    skeleton.points += rng.normal(0.0, NOISE_M, skeleton.points.shape)
    skeleton.points = skeleton.points @ frame[:3, :3].T + frame[:3, 3]
    across = rng.normal(size=(4, *skeleton.points.shape))
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    cloud = (skeleton.points + across * skeleton.radius[:, None]).reshape(-1, 3)
    branches = branch_rows(skeleton, axes(skeleton), float(skeleton.points[0, 2]))
    scan = Scan(name, date, sample_wood(skeleton), branches, cloud)
    return SimpleNamespace(scan=scan, skeleton=skeleton, dated=dated, frame=frame)


@pytest.fixture(scope="session")
def dates():
    """The tree in four winters: as it was, pruned, a year later, and unchanged but rescanned."""
    first = first_date(grow_tree(5, "spindle", height=1.6, density=0.7))
    pruned = prune(first, np.random.default_rng(1))
    grown = grow_a_year(pruned, np.random.default_rng(2))
    return SimpleNamespace(
        first=scan_of("first", "2024-02-01", first, np.eye(4), 0),
        pruned=scan_of("pruned", "2025-02-01", pruned, frame_of(2.3, [0.4, -0.2, 0.03]), 1),
        grown=scan_of("grown", "2026-02-01", grown, frame_of(-1.1, [-0.3, 0.1, 0.0]), 2),
        again=scan_of("again", "2024-03-01", first, frame_of(0.7, [0.0, 1.0, 0.0]), 3),
    )
