"""What photos show of the region and what depth maps hold of it; a top that the cloud lacks."""

import json

import cv2
import numpy as np
import pytest
from scan_scene import look_at_poses, ring
from sound_tree import flags_of

from cherrypicker.evidence.coverage import ask_voxels, measure_coverage, voxel_centers
from cherrypicker.evidence.missing_top import find_missing_top
from cherrypicker.files import write_json
from cherrypicker.mvs.raster import make_raster
from cherrypicker.placement.region import find_region
from cherrypicker.traits.reports import Reports

TARGET = np.array([0.0, 0.0, 1.2])
SIZE, FOCAL = (300, 400), 300.0


class Photos:
    """Photos of a scan in memory: their skies, what a user hides, and their depth maps."""

    def __init__(self, poses, skies, maps, hidden_rows=0):
        self.poses, self._skies, self._maps = poses, skies, maps
        self.views = list(poses)
        self.slack_px = np.ones(len(poses))
        self._hidden_rows = hidden_rows

    def raster(self, i):
        sky = self._skies[self.views[i].name]
        hidden = np.zeros_like(sky)
        hidden[: self._hidden_rows] = True
        return make_raster(np.full((*sky.shape, 3), 200, np.uint8), sky & ~hidden, hidden)

    def depth(self, i):
        return self._maps.get(self.views[i].name)


@pytest.fixture(scope="module")
def scan():
    """A pole of 2.4 m with a bend, before clear sky in all of 24 photos."""
    poses = look_at_poses(ring(n=24), TARGET, size=SIZE, focal=FOCAL)
    z = np.linspace(0.0, 2.4, 1200)
    pole = np.column_stack([0.05 * np.sin(2 * z), np.zeros_like(z), z])
    skies, maps = {}, {}
    for i, name in enumerate(poses.names):
        uv, depth = poses[i].project(pole)
        drawn = np.zeros(SIZE[::-1], np.uint8)
        cv2.polylines(drawn, [np.round(uv).astype(np.int32)], False, 1, 3)
        ground, _ = poses[i].project(np.array([[0.0, 0.0, 0.0]]))
        drawn[int(np.clip(ground[0, 1], 0, SIZE[1])) :] = 1
        skies[name] = drawn == 0
        maps[name] = np.where(drawn, np.float32(depth.mean()), np.float32(0.0))
    return poses, skies, pole, maps


def ask(photos, pole, centers):
    """What photos say of voxels that learn from the pole's and from those beside it."""
    rng = np.random.default_rng(0)
    known = pole[(pole[:, 2] > 0.6) & (pole[:, 2] < 2.3)][::10]
    beside = known + rng.normal(0, 0.4, known.shape) + np.sign(rng.normal(size=(len(known), 1)))
    row = np.arange(len(centers) + 2 * len(known)) - len(centers)
    held, empty = (row >= 0) & (row < len(known)), row >= len(known)
    shown = ask_voxels(photos, np.vstack([centers, known, beside]), 0.05, held, empty)
    return tuple(each[: len(centers)] for each in shown)


def test_voxels_of_the_pole_are_wood_and_the_sky_beside_it_is_not(scan):
    poses, skies, pole, maps = scan
    photos = Photos(poses, skies, maps)
    upper = pole[(pole[:, 2] > 0.6) & (pole[:, 2] < 2.3)][5::50]
    n_framing, p_wood = ask(photos, pole, upper)
    assert (n_framing == 24).all() and p_wood.min() > 0.9
    assert ask(photos, pole, upper + [0.4, 0.3, 0.0])[1].max() < 0.1


def test_two_photos_that_lost_the_pole_do_not_outvote_the_others(scan):
    poses, skies, pole, maps = scan
    upper = pole[(pole[:, 2] > 1.0) & (pole[:, 2] < 2.3)][5::50]
    lost = skies | {name: np.ones_like(skies[name]) for name in poses.names[[2, 9]]}
    assert ask(Photos(poses, lost, maps), pole, upper)[1].min() > 0.9


def test_what_a_user_hides_is_framed_by_no_photo(scan):
    """Nobody knows of it more than before a photo was asked."""
    poses, skies, pole, maps = scan
    upper = pole[(pole[:, 2] > 0.6) & (pole[:, 2] < 2.3)][5::50]
    n_framing, p_wood = ask(Photos(poses, skies, maps, hidden_rows=SIZE[1]), pole, upper)
    assert not n_framing.any()
    assert p_wood == pytest.approx(0.5, abs=0.01)


def test_coverage_counts_photos_and_maps_and_goes_through_json(scan, tmp_path):
    poses, skies, pole, maps = scan
    region = find_region(poses)
    half = {name: maps[name] for name in poses.names[:12]}
    coverage = measure_coverage(Photos(poses, skies, half), region)
    write_json(tmp_path / "coverage.json", coverage, indent=None)
    content = json.loads((tmp_path / "coverage.json").read_text())
    centers = voxel_centers(
        region.center, region.radius, np.array(content["cells"]), content["n_across"]
    )
    assert np.allclose(content["region"]["center"], region.center)
    assert region.holds(centers).all()
    framing, holding = (np.array(content[f"n_{name}"]) for name in ("framing", "holding"))
    middle = np.linalg.norm(centers - region.center, axis=1) < 0.3
    assert (framing[middle] == 24).all()
    assert holding.max() <= 12  # of the photos that have a map
    held = centers[holding >= 6]
    assert len(held) and (np.hypot(held[:, 0], held[:, 1]) < 0.5).all()


def test_a_cloud_without_its_top_is_told(scan):
    poses, skies, pole, maps = scan
    foot = pole[0]
    photos = Photos(poses, skies, maps)
    assert find_missing_top(photos, pole, foot) is None
    cut = find_missing_top(photos, pole[pole[:, 2] < 2.0], foot)
    assert cut.found == pytest.approx(2.0, abs=0.01)
    assert cut.height == pytest.approx(2.4, abs=0.08)
    assert cut.n_photos > 12
    (flag,) = flags_of(Reports(), missing_top=cut)
    assert flag.startswith("top_not_in_cloud: ")
    assert f"up to {cut.height:.2f} m" in flag


def test_what_stands_apart_above_a_tree_is_not_its_top(scan):
    poses, skies, pole, maps = scan
    low = pole[pole[:, 2] < 0.95]
    gap = {name: sky.copy() for name, sky in skies.items()}
    for i, name in enumerate(poses.names):
        uv, _ = poses[i].project(np.array([[0.0, 0.0, 0.93], [0.0, 0.0, 1.35]]))
        gap[name][int(uv[1, 1]) : int(uv[0, 1])] = True
    assert find_missing_top(Photos(poses, gap, maps), low, pole[0]) is None


def test_a_missing_top_is_as_high_over_the_foot_as_it_is(scan):
    poses, skies, pole, maps = scan
    cut = pole[pole[:, 2] < 2.0]
    foot = pole[0] - [0.0, 0.0, 0.3]
    found = find_missing_top(Photos(poses, skies, maps), cut, foot)
    assert found.found == pytest.approx(2.3, abs=0.01)
    assert found.height == pytest.approx(2.7, abs=0.08)
