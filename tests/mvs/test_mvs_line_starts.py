"""Thin lines of photos, and the depths at which those of several photos meet."""

import cv2
import numpy as np
import pytest
from stereo_scene import Surface, write_scene

from cherrypicker.mvs.estimate import Stereo, StereoOptions
from cherrypicker.mvs.kernels import initial
from cherrypicker.mvs.kernels.level import State
from cherrypicker.mvs.lines.line_starts import PhotoLines, find_lines, start_from_lines
from cherrypicker.mvs.lines.ridges import BRIGHT, DARK
from cherrypicker.mvs.views import plan_views
from cherrypicker.mvs.workspace import Workspace

WALL_Z, TWIG_Z = 5.0, 3.5


def wall_and_twig(radius):
    twig = Surface(center=(0.1, 0.0, TWIG_Z), radius=radius, seed=3)
    return [Surface(offset=WALL_Z, seed=4), twig]


def photo_with_line(grey_of_line, width=2):
    """A grey slope of 100 to 160 with a line across it, and noise."""
    slope = np.tile(np.linspace(100, 160, 120, dtype=np.float32), (80, 1))
    photo = cv2.merge([slope] * 3)
    cv2.line(photo, (10, 15), (110, 65), (grey_of_line,) * 3, width)
    noise = np.random.default_rng(0).normal(0, 1.5, photo.shape)
    return np.clip(photo + noise, 0, 255).astype(np.uint8)


def distance_to_line(rows, columns):
    along = np.array([100.0, 50.0]) / np.hypot(100.0, 50.0)
    return np.abs((columns - 10) * along[1] - (rows - 15) * along[0])


@pytest.mark.parametrize(("grey", "sign"), [(40, DARK), (235, BRIGHT)])
def test_the_centre_line_of_a_thin_line_is_found(grey, sign):
    line = find_lines(photo_with_line(grey)).sign
    rows, columns = np.nonzero(line == sign)
    on_line = distance_to_line(rows, columns) < 1.6
    assert on_line.mean() > 0.97
    assert len(set(columns[on_line]) & set(range(15, 105))) > 80


def test_its_flanks_are_no_lines():
    assert (find_lines(photo_with_line(40)).sign != BRIGHT).all()


def middle_photo(folder, radius):
    """Problem, stereo and true depth of a photo with a twig; the focal length is 150 px."""
    _, _, depths = write_scene(folder, wall_and_twig(radius))
    workspace = Workspace(folder)
    problem = next(p for p in plan_views(workspace, 6) if p.view == 2)
    return problem, Stereo(workspace, StereoOptions(min_level_px=60)), depths[2]


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A twig two pixels wide."""
    return middle_photo(tmp_path_factory.mktemp("twig"), 0.022)


def started_on_the_wall(scene, radius):
    """Let lines start in a ball around the twig where every pixel believes in the wall."""
    problem, stereo, _ = scene
    level = stereo.level(problem, 0)
    shape = (level.height, level.width)
    field = np.zeros((*shape, 4), np.float32)
    field[..., 0] = 1.0 / WALL_Z
    active = np.ones(shape, np.uint8)
    chosen = np.zeros(shape, np.uint16)
    state = State(field, chosen, active)
    initial.evaluate_field(level, 1, state)
    own, *others = (stereo.lines(i) for i in problem.photos)
    view = stereo.views[problem.view]
    center = view.R @ np.array([0.1, 0.0, TWIG_Z]) + view.t
    ball = np.array([*center, radius], np.float32)
    started = start_from_lines(level, state, active, own, others, ball)
    return field, started


def test_a_twig_that_was_taken_for_the_wall_is_found_where_its_lines_meet(scene):
    depth = scene[-1]
    field, started = started_on_the_wall(scene, 1.0)
    on_twig = started & (depth < 4.0)
    rows = np.unique(np.nonzero(on_twig)[0])
    assert len(rows) > 0.5 * len(depth)
    error = np.abs(1.0 / field[on_twig][:, 0] - depth[on_twig]) / depth[on_twig]
    assert (error < 0.03).mean() > 0.75


def test_no_depth_outside_the_ball_is_asked(scene):
    field, started = started_on_the_wall(scene, 0.2)
    assert started.any()
    found = 1.0 / field[started][:, 0]
    assert found.min() > TWIG_Z - 0.5
    assert found.max() < TWIG_Z + 0.5
    assert (field[~started][:, 0] == np.float32(1.0 / WALL_Z)).all()


def test_lines_bring_a_twig_below_a_pixel_into_the_photometric_map(tmp_path):
    """With and without, all else equal."""
    problem, stereo, depth = middle_photo(tmp_path, 0.009)
    nothing = np.zeros(depth.shape, np.uint8)
    twig = depth < 4.0
    shares = []
    for lines in (stereo.lines, lambda i: PhotoLines(nothing, nothing, nothing)):
        stereo.lines = lines
        field = stereo.photometric(problem)
        near = np.abs(1.0 / np.maximum(field[..., 0], 1e-6) - depth) < 0.03 * depth
        shares.append(near[twig].mean())
        assert near[~twig].mean() > 0.9
    assert shares[0] > 1.2 * shares[1]
