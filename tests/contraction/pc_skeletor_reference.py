"""What pc-skeletor, the paper authors' program, makes of a small cloud, step by step.

Writes pc_skeletor_reference.npz beside it, with the Python of an environment that has pc-skeletor
(docs/lab/skeleton.md says how to make one). In the folder of the tests:

    PYTHONPATH=../scripts:scenes python contraction/pc_skeletor_reference.py PEER/bin/python
"""

import sys
from pathlib import Path

import numpy as np
from skeleton_shapes import labelled_cloud, tube

from cherrypicker.pointcloud import PointCloud
from cherrypicker_lab.skeletons.peer import run_peer

REFERENCE = Path(__file__).with_suffix(".npz")
METHODS, STEPS = ("lbc", "slbc"), (1, 2, 20)


def reference_cloud() -> PointCloud:
    """A stem of 4 cm radius with a branch, some noise and a hole, 1205 points.

    The stem comes first, as pc-skeletor wants it, and the branch's tip before its base:
    pc-skeletor takes the first point that is no trunk for trunk, which changes nothing out there.
    The mean lies at the origin, where our contraction moves it: robust-laplacian's normals depend
    on the frame.
    """
    rng = np.random.default_rng(11)
    stem = tube((0, 0, 0), (0, 0, 0.4), 0.04, 10_000, rng=rng)
    stem = stem[np.linalg.norm(stem - (-0.04, 0, 0.15), axis=1) > 0.03]
    branch = tube((0.3, 0, 0.4), (0.035, 0, 0.25), 0.012, 10_000, rng=rng)
    branch = branch[np.argsort(-branch[:, 0])]
    points = np.vstack([stem, branch])
    points += rng.normal(0, 0.002, points.shape)
    points -= points.mean(axis=0)
    return labelled_cloud(points, np.repeat([1, 2], [len(stem), len(branch)]))


def peer_steps(python: str) -> dict[str, np.ndarray]:
    """Run pc-skeletor for each number of iterations of each method, points (n, 3) by name."""
    cloud = reference_cloud()
    return {
        f"{method}_{n}": run_peer(python, cloud, method, max_iterations=n, own_solve=True)[0][
            "contracted"
        ]
        for method in METHODS
        for n in STEPS
    }


if __name__ == "__main__":
    found = peer_steps(sys.argv[1])
    np.savez_compressed(REFERENCE, **{name: each.astype("f4") for name, each in found.items()})
