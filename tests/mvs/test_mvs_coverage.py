"""What photos show of the region and what depth maps hold of it; a top that the cloud lacks."""

import json

import cv2
import numpy as np
import pytest
from scan_scene import look_at_poses, ring

from cherrypicker.files import write_json
from cherrypicker.mvs.coverage import look_for_wood, measure_coverage, voxel_centers
from cherrypicker.mvs.workspace import view_of
from cherrypicker.placement.region import find_region
from cherrypicker.traits.flags import scan_flags
from cherrypicker.traits.missing_top import find_missing_top

TARGET = np.array([0.0, 0.0, 1.2])
SIZE, FOCAL = (300, 400), 300.0


class Masks:
    """Sky masks in memory, by photo."""

    def __init__(self, skies, hidden_rows=0):
        self._skies, self._hidden_rows = skies, hidden_rows

    def of(self, view):
        return self._skies[view.name]

    def both(self, view):
        hidden = np.zeros_like(self.of(view))
        hidden[: self._hidden_rows] = True
        return self.of(view) & ~hidden, hidden


class Maps:
    """A workspace's depth maps in memory."""

    def __init__(self, poses, maps):
        self.poses = poses
        self.views = [view_of(poses, i) for i in range(len(poses))]
        self._maps = maps

    def read_depth(self, view, kind):
        return self._maps[view.name]


@pytest.fixture(scope="module")
def scan():
    """A pole of 2.4 m with a bend, before clear sky in all of 24 photos."""
    poses = look_at_poses(ring(n=24), TARGET, size=SIZE, focal=FOCAL)
    z = np.linspace(0.0, 2.4, 1200)
    pole = np.column_stack([0.05 * np.sin(2 * z), np.zeros_like(z), z])
    skies, maps = {}, {}
    for i, name in enumerate(poses.names):
        uv, depth = poses.project(pole, i)
        drawn = np.zeros(SIZE[::-1], np.uint8)
        cv2.polylines(drawn, [np.round(uv).astype(np.int32)], False, 1, 3)
        ground, _ = poses.project(np.array([[0.0, 0.0, 0.0]]), i)
        drawn[int(np.clip(ground[0, 1], 0, SIZE[1])) :] = 1
        skies[name] = drawn == 0
        maps[name] = np.where(drawn, np.float32(depth.mean()), np.float32(0.0))
    return poses, Masks(skies), pole, maps


def test_voxels_of_the_pole_are_wood_and_the_sky_beside_it_is_not(scan):
    poses, masks, pole, _ = scan
    upper = pole[(pole[:, 2] > 0.6) & (pole[:, 2] < 2.3)][::50]
    assert look_for_wood(poses, masks, upper, 0.05).is_wood.all()
    beside = look_for_wood(poses, masks, upper + [0.4, 0.3, 0.0], 0.05)
    assert not beside.is_wood.any()
    assert (beside.clear > 0.8 * beside.framing).all()


def test_what_a_user_hides_is_framed_by_no_photo(scan):
    """Its edge before the sky is nothing thin, and what lies behind it is not wood."""
    poses, masks, pole, _ = scan
    skies = {name: masks.of(view_of(poses, i)) for i, name in enumerate(poses.names)}
    hidden = Masks(skies, hidden_rows=SIZE[1])
    upper = pole[(pole[:, 2] > 0.6) & (pole[:, 2] < 2.3)][::50]
    shown = look_for_wood(poses, hidden, upper, 0.05)
    assert not shown.framing.any() and not shown.thin.any() and not shown.clear.any()


def test_coverage_counts_photos_and_maps_and_goes_through_json(scan, tmp_path):
    poses, masks, pole, maps = scan
    region = find_region(poses)
    half = set(poses.names[:12])
    coverage = measure_coverage(Maps(poses, maps), region, half, masks)
    write_json(tmp_path / "coverage.json", coverage, indent=None)
    content = json.loads((tmp_path / "coverage.json").read_text())
    centers = voxel_centers(region, np.array(content["cells"]), content["n_across"])
    assert np.allclose(content["region"]["center"], region.center)
    assert region.holds(centers).all()
    framing, holding = (np.array(content[f"n_{name}"]) for name in ("framing", "holding"))
    middle = np.linalg.norm(centers - region.center, axis=1) < 0.3
    assert (framing[middle] == 24).all()
    assert holding.max() <= 12  # of the photos that have a map
    held = centers[holding >= 6]
    assert len(held) and (np.hypot(held[:, 0], held[:, 1]) < 0.5).all()


def test_a_cloud_without_its_top_is_told(scan):
    poses, masks, pole, _ = scan
    foot = pole[0]
    assert find_missing_top(poses, masks, pole, foot) is None
    cut = find_missing_top(poses, masks, pole[pole[:, 2] < 2.0], foot)
    assert cut.found == pytest.approx(2.0, abs=0.01)
    assert cut.height == pytest.approx(2.4, abs=0.08)
    assert cut.n_photos > 12
    (flag,) = scan_flags("m", missing_top=cut)
    assert flag.startswith("top_not_in_cloud: ")
    assert f"up to {cut.height:.2f} m" in flag


def test_what_stands_apart_above_a_tree_is_not_its_top(scan):
    poses, masks, pole, _ = scan
    low = pole[pole[:, 2] < 0.95]
    gap = {name: masks.of(view_of(poses, i)).copy() for i, name in enumerate(poses.names)}
    for i, name in enumerate(poses.names):
        uv, _ = poses.project(np.array([[0.0, 0.0, 0.93], [0.0, 0.0, 1.35]]), i)
        gap[name][int(uv[1, 1]) : int(uv[0, 1])] = True
    assert find_missing_top(poses, Masks(gap), low, pole[0]) is None
