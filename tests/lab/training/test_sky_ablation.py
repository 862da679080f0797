"""The ablation of the sky filter: what counts as fringe and branch, and what each variant takes."""

import numpy as np
import pytest

from cherrypicker.denoising.denoise import DenoiseOptions
from cherrypicker.pointcloud import PointCloud
from cherrypicker.sky.colors import SkyColors
from cherrypicker_lab.dense.truth import TrueSurface
from cherrypicker_lab.training.sky.ablation import VARIANTS, ablate, judged_kinds, markdown

BLUE, BROWN = (0.3, 0.5, 0.8), (0.3, 0.24, 0.19)
SKY = SkyColors(np.array([BLUE], np.float32), np.zeros(1, np.int32), np.ones(1), n_sampled=1000)
ALONE = DenoiseOptions(use_statistical=False, min_view_ratio=0.0)


@pytest.fixture
def surface():
    """A stem of 2 cm radius and 1 m height, and a wall half a metre beside it."""
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    z = np.linspace(0, 1, 500)
    angle, z = (a.ravel() for a in np.meshgrid(angle, z))
    normals = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
    points = 0.02 * normals + np.column_stack([np.zeros((len(z), 2)), z])
    n = len(points)
    y, height = (a.ravel() for a in np.meshgrid(np.arange(-0.1, 0.1, 0.005), z[::60]))
    wall = np.column_stack([np.full(len(y), 0.06), y, height])
    return TrueSurface(
        points, normals, np.ones(n), np.full(n, 0.02), np.ones(n, bool), np.full(n, 9), wall
    )


def at(distance, n, color):
    """Points this far from the stem's axis, away from the wall."""
    points = np.column_stack([np.full(n, -distance), np.zeros(n), np.linspace(0.3, 0.9, n)])
    return points, np.tile(color, (n, 1))


@pytest.fixture
def cloud():
    """40 points on the bark, 10 of them of the sky's colour; 20 fringe, 10 off but brown."""
    parts = [at(0.02, 30, BROWN), at(0.02, 10, BLUE), at(0.035, 20, BLUE), at(0.035, 10, BROWN)]
    points, colors = (np.concatenate(a) for a in zip(*parts))
    return PointCloud(points, colors.astype(np.float32))


def photos(asked, _):
    """Photos that see through all that is 3 cm from the axis."""
    off = np.hypot(asked[:, 0], asked[:, 1]) > 0.03
    return np.where(off, -4.0, 4.0)


def test_fringe_has_the_skys_colour_and_lies_off_all_surfaces(surface):
    points = np.array(
        [[0.02, 0, 0.5], [0.035, 0, 0.5], [0.035, 0, 0.5], [0.027, 0, 0.5], [0.055, 0, 0.5]]
    )
    fringe, branch = judged_kinds(points, np.array([0, 0, 0.3, 0, 0]), 0.1, surface)
    assert fringe.tolist() == [False, True, False, False, False]  # the last lies on the wall
    assert branch.tolist() == [True, False, False, False, False]


def test_each_variant_takes_what_it_is_made_for(surface, cloud):
    table = {
        row["variant"]: row
        for row in ablate(cloud, cloud.points, surface, SKY, photos, ALONE, -np.inf)
    }
    assert list(table) == list(VARIANTS)
    assert {(row["n_fringe"], row["n_branch"]) for row in table.values()} == {(20, 40)}
    taken = {k: (r["n_removed"], r["fringe_removed"], r["branch_lost"]) for k, r in table.items()}
    assert taken["off"] == (0, 0, 0)
    assert taken["colour only"] == (30, 1, 0.25)  # and the bark of the sky's colour
    assert taken["mask voting only"] == (30, 1, 0)  # and what is brown but not there
    assert taken["both"] == (20, 1, 0)


def test_a_scene_without_fringe_says_so(surface, cloud):
    bark = cloud.select(np.arange(30))
    table = ablate(bark, bark.points, surface, SKY, photos, ALONE, -np.inf)
    assert table[-1]["fringe_removed"] is None and table[-1]["branch_lost"] == 0
    lines = markdown({"stem": table}).splitlines()
    assert len(lines) == 6
    assert lines[-1] == "| stem | both | 0 | none of 0 | 0.00 % of 30 |"
