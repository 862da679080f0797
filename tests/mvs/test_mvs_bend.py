"""Round wood bends away from the plane of a patch, by what its width tells."""

from dataclasses import replace

import numpy as np
import pytest
from stereo_scene import Surface, write_scene

from cherrypicker.mvs import estimate
from cherrypicker.mvs.estimate import Stereo, StereoOptions
from cherrypicker.mvs.kernels import initial
from cherrypicker.mvs.kernels.level import State
from cherrypicker.mvs.views import plan_views
from cherrypicker.mvs.workspace import Workspace

WALL_Z, LIMB_Z, RADIUS = 5.0, 3.5, 0.07
FOCAL_PX = 150.0
BENT = estimate._bent


@pytest.fixture(scope="module")
def limb(tmp_path_factory):
    """Problem and stereo of a photo with a limb before a wall, and true depth of its pixels."""
    folder = tmp_path_factory.mktemp("limb")
    round_wood = Surface(center=(0.1, 0.0, LIMB_Z), radius=RADIUS, seed=3)
    _, _, depths = write_scene(folder, [Surface(offset=WALL_Z, seed=4), round_wood])
    workspace = Workspace(folder)
    problem = next(p for p in plan_views(workspace, 6) if p.view == 2)
    return problem, Stereo(workspace, StereoOptions(min_level_px=60)), depths[2]


def state_of(depth):
    """Pixels that hold their true depth and face the camera."""
    field = np.zeros((*depth.shape, 4), np.float32)
    field[..., 0] = np.where(depth > 0.0, 1.0 / np.maximum(depth, 1e-6), 0.0)
    return State(field, np.zeros(depth.shape, np.uint16), np.ones(depth.shape, np.uint8))


def front(depth):
    """Pixels of the middle of the limb, away from the photo's edge."""
    middle = depth < LIMB_Z - 0.95 * RADIUS
    middle[:8] = middle[-8:] = False
    return middle


def test_a_limb_bends_by_its_radius_and_a_wall_not_at_all(limb):
    problem, stereo, depth = limb
    bend = estimate._bent(stereo.level(problem, 0), 1, state_of(depth)).bend
    radius_px = FOCAL_PX * RADIUS / LIMB_Z
    on_limb = bend[front(depth)]
    assert np.median(on_limb[:, 2]) == pytest.approx(
        radius_px / (2 * FOCAL_PX * (LIMB_Z - RADIUS)), rel=0.2
    )
    square = np.median(on_limb[:, 0] ** 2 + on_limb[:, 1] ** 2)
    assert square == pytest.approx(np.median(on_limb[:, 2]) / radius_px**2, rel=0.4)
    assert np.abs(on_limb[:, 1]).max() < 1e-6  # it stands upright, and bends across
    assert (bend[depth > 0.99 * WALL_Z] == 0.0).mean() > 0.9


@pytest.mark.parametrize(("width", "bends"), [(1, False), (2, True), (5, True)])
def test_a_lying_limb_bends_upwards_and_a_line_of_lonely_pixels_not_at_all(limb, width, bends):
    problem, stereo, depth = limb
    wood = np.full(depth.shape, WALL_Z)
    wood[50 : 50 + width] = LIMB_Z
    bend = estimate._bent(stereo.level(problem, 0), 1, state_of(wood)).bend[50 : 50 + width, 20:-20]
    assert np.abs(bend[..., 0]).max() < 1e-6
    assert (bend[..., 1] > 0.0).all() == bends
    assert (bend[..., 2] > 0.0).any() == bends


def test_what_is_known_of_the_bend_makes_true_depths_match_better(limb):
    problem, stereo, depth = limb
    flat = stereo.level(problem, 0)
    costs = []
    for level in (flat, estimate._bent(flat, 1, state_of(depth))):
        state = state_of(depth)
        initial.evaluate_field(level, 1, state)
        costs.append(state.field[front(depth)][:, 3].mean())
    assert costs[1] < 0.95 * costs[0]


def test_the_front_of_a_limb_is_found_nearer_to_where_it_is(limb, monkeypatch):
    problem, stereo, depth = limb
    behind = np.zeros(2)
    for seed in range(4):  # of one alone it is a matter of what is drawn
        drawn = Stereo(stereo.workspace, replace(stereo.options, seed=seed))
        for i, bent in enumerate((lambda level, threads, state: level, BENT)):
            monkeypatch.setattr(estimate, "_bent", bent)
            field = drawn.photometric(problem)[front(depth)]
            known = field[:, 0] > 0.0
            behind[i] += np.median(np.abs(1.0 / field[known, 0] - depth[front(depth)][known]))
    assert behind[1] < 0.8 * behind[0]
