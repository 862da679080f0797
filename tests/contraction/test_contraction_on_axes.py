"""The default contraction: every point to the axis of its limb."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import skeleton_shapes
from scipy.spatial import cKDTree
from skeleton_shapes import labelled_cloud, sample_axes, small_tree, tube
from wood_choice import NO_GROUND

from cherrypicker.contraction.contract_points import METHODS, SkeletonOptions
from cherrypicker.contraction.contract_wood import contract_wood
from cherrypicker.errors import StageError
from cherrypicker.geometry.sampling import voxel_thin
from cherrypicker.limbs.growth import grow_limbs
from cherrypicker.limbs.joints import points_on_axes
from cherrypicker.wood.feet import find_stems
from cherrypicker.wood.thinned import GrowthOptions
from cherrypicker_lab.skeletons.distances import chamfer_cm2


def test_points_of_a_thick_stem_and_of_a_twig_go_to_their_axes():
    rng = np.random.default_rng(3)
    stem = tube((0, 0, 0), (0, 0, 0.6), 0.03, 20_000, rng=rng)  # no class says that it is thick
    twig = tube((0.03, 0, 0.3), (0.33, 0, 0.3), 0.004, 30_000, rng=rng, noise=0.001)
    points = np.vstack([stem, twig])
    _, source, _ = voxel_thin(points, 0.008)
    limbs = grow_limbs(points[source], (0, 0, 0))
    moved = points_on_axes(points[source], limbs.member, limbs.limbs, limbs.spacing)
    assert len(limbs.limbs) == 2
    of_stem, of_twig = moved[source < len(stem)], moved[source >= len(stem)]
    assert of_twig[:, 0].max() > 0.32  # of 0.33
    free = of_twig[of_twig[:, 0] > 0.08]
    assert np.median(np.linalg.norm(free[:, 1:] - [0, 0.3], axis=1)) < 0.002
    assert np.median(np.linalg.norm(of_stem[:, :2], axis=1)) < 0.002


def test_points_of_a_limb_stand_for_its_axis_inside_the_stem_too():
    rng = np.random.default_rng(4)
    stem = tube((0, 0, 0), (0, 0, 0.8), 0.06, 20_000, rng=rng)
    limb = tube((0.06, 0, 0.4), (0.5, 0, 0.4), 0.012, 20_000, rng=rng)
    points = np.vstack([stem, limb])
    _, source, _ = voxel_thin(points, 0.01)
    limbs = grow_limbs(points[source], (0, 0, 0))
    moved = points_on_axes(points[source], limbs.member, limbs.limbs, limbs.spacing)
    inside = np.stack([np.linspace(0, 0.06, 7), np.zeros(7), np.full(7, 0.4)], axis=1)
    assert cKDTree(moved).query(inside)[0].max() < 0.01


def test_coinciding_points_name_the_key():
    with pytest.raises(StageError, match="no limb.*contract.classes"):
        grow_limbs(np.zeros((30, 3)), (0, 0, 0))


def test_wrong_labels_do_not_carry_branches_onto_the_stem():
    points, labels, axes = small_tree(noise=0.002)
    rng = np.random.default_rng(8)
    flipped = rng.random(len(labels)) < 0.1
    scattered = np.where(flipped, 3 - labels, labels)
    whole_branch = np.where((points[:, 0] > 0.02) & (points[:, 2] < 0.76), 1, labels)
    truth = sample_axes(axes)
    for wrong in (scattered, whole_branch):
        contracted, report = contract_wood(
            labelled_cloud(points, wrong), GrowthOptions(voxel_size_m=0.01)
        )
        away = cKDTree(truth).query(contracted.points)[0]
        assert np.quantile(away, 0.99) < 0.02
        assert contracted.points[:, 0].max() > 0.43  # the branch keeps its tip
        assert report["claimed"] > 0.9


def test_equal_bytes_for_any_number_of_threads():
    script = (
        "import hashlib, numpy as np\n"
        "from skeleton_shapes import labelled_cloud, small_tree\n"
        "from cherrypicker.contraction.contract_wood import contract_wood\n"
        "from cherrypicker.wood.thinned import GrowthOptions\n"
        "cloud = labelled_cloud(*small_tree(noise=0.002)[:2])\n"
        "points = contract_wood(cloud, GrowthOptions(voxel_size_m=0.012))[0].points\n"
        "print(hashlib.sha256(points.tobytes()).hexdigest())\n"
    )
    folders = f"{Path(skeleton_shapes.__file__).parent}:{Path(__file__).parents[2] / 'scripts'}"
    found = set()
    for threads in ("1", "4"):
        names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
        environment = os.environ | dict.fromkeys(names, threads) | {"PYTHONPATH": folders}
        done = subprocess.run(
            [sys.executable, "-c", script], env=environment, capture_output=True, check=True
        )
        found.add(done.stdout)
    assert len(found) == 1


def test_a_branch_that_hangs_to_the_ground_is_no_stem():
    rng = np.random.default_rng(7)
    stem = tube((0, 0, 0), (0, 0, 1.5), 0.04, 20_000, rng=rng)
    branch = np.vstack([tube((0, 0, 0.7), (0.6, 0, 0.5), 0.01, 40_000, rng=rng),
                        tube((0.6, 0, 0.5), (0.65, 0, 0.0), 0.008, 40_000, rng=rng)])  # fmt: skip
    points = np.vstack([stem, branch])
    labels = np.repeat([1, 2], [len(stem), len(branch)])
    assert len(find_stems(points, NO_GROUND, labels)) == 1
    assert len(find_stems(points, NO_GROUND, np.full(len(points), 2))) == 2
    contracted, report = contract_wood(labelled_cloud(points, labels))
    assert report["wood"]["n_neighbors_cut"] == 0
    assert contracted.points[:, 0].max() > 0.6


def test_default_beats_the_published_contraction_on_a_small_tree():
    points, labels, axes = small_tree(noise=0.002)
    cloud, truth = labelled_cloud(points, labels), sample_axes(axes)
    found = {}
    for method in METHODS:
        contracted, _ = contract_wood(
            cloud, GrowthOptions(voxel_size_m=0.01), options=SkeletonOptions(method)
        )
        found[method] = chamfer_cm2(contracted.points, truth)
    assert found["limbs"] < 0.5 * min(found["slbc"], found["lbc"])
    assert found["limbs"] < 0.3
