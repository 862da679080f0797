"""Twigs before the sky become points; places that the photos know to be sky do not."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest
from scan_scene import look_at_poses

from cherrypicker.mvs.lines.sky_lines import find_sky_lines
from cherrypicker.mvs.raster import make_raster
from cherrypicker.mvs.silhouettes import add_silhouettes
from cherrypicker.photos import read_photo
from cherrypicker.placement.region import find_region
from cherrypicker.pointcloud import PointCloud
from cherrypicker.poses import Poses

SIDE, FOCAL, DISTANCE, FINE = 320, 800.0, 3.0, 8
SKY = (150, 190, 230)
# A twig of 2 mm radius, 0.6 m long, leaning
TWIG = np.array([[-0.10, -0.05, -0.25], [0.15, 0.10, 0.25]])
RADIUS = 0.002
NOTHING = np.zeros((SIDE, SIDE), bool)


def ring(n_photos: int) -> Poses:
    """Cameras all around the origin, a fifth of them looking up a little."""
    k = np.arange(n_photos)
    angle = 2.0 * np.pi * k / n_photos
    centers = DISTANCE * np.column_stack([np.cos(angle), np.sin(angle), -0.2 * (k % 3)])
    poses = look_at_poses(centers, np.zeros(3), size=(SIDE, SIDE), focal=FOCAL)
    poses.names = [f"{k:02d}.png" for k in range(n_photos)]
    return poses


def draw(poses: Poses, i: int, twigs) -> np.ndarray:
    """Photo of dark twigs, each (2, 3), before a plain sky with a little noise."""
    return _drawn(len(poses), i, tuple(np.asarray(twig).tobytes() for twig in twigs))


@cache
def _drawn(n_photos: int, i: int, twigs: tuple[bytes, ...]) -> np.ndarray:
    poses = ring(n_photos)
    photo = np.full((FINE * SIDE, FINE * SIDE, 3), SKY, np.uint8)
    for twig in (np.frombuffer(each).reshape(2, 3) for each in twigs):
        uv, depth = poses[i].project(twig)
        ends = np.rint((FINE * uv - 0.5) * 16).astype(int)
        width = round(2.0 * RADIUS * FOCAL / depth.mean() * FINE)
        cv2.line(photo, ends[0].tolist(), ends[1].tolist(), (60, 50, 40), width, shift=4)
    small = cv2.resize(photo, (SIDE, SIDE), interpolation=cv2.INTER_AREA).astype(float)
    noise = np.random.default_rng(i).normal(0.0, 1.5, small.shape)
    return np.clip(np.rint(small + noise), 0, 255).astype(np.uint8)


class Photos:
    """What `add_silhouettes` needs of a workspace and of its masks, photos on disk.

    ``before_sky`` are the photos whose masks have sky, all of it.
    """

    def __init__(self, folder, poses: Poses, twigs_of, before_sky):
        self.folder, self.poses, self.before_sky = folder, poses, before_sky
        self.views = list(poses)
        for i, view in enumerate(self.views):
            photo = draw(poses, i, twigs_of(i))
            cv2.imwrite(str(self.photo_path(view)), cv2.cvtColor(photo, cv2.COLOR_RGB2BGR))

    def photo_path(self, view):
        return self.folder / view.name

    def photo(self, i):
        return read_photo(self.photo_path(self.views[i]))

    def raster(self, i):
        photo = self.photo(i)
        return make_raster(photo, np.full(photo.shape[:2], i in self.before_sky), NOTHING)


def added(
    folder, n_photos, twigs_of, *, before_sky=range(99), points=((9.0, 9.0, 9.0),), clear=-6.0
):
    """Points that are added to a cloud, a PointCloud."""
    photos = Photos(folder, ring(n_photos), twigs_of, before_sky)
    points = np.array(points, float)
    cloud = PointCloud(
        points,
        colors=np.zeros((len(points), 3)),
        normals=np.tile([0.0, 0.0, 1.0], (len(points), 1)),
        fields={"n_views": np.full(len(points), 3, np.uint8)},
    )
    words = np.full(n_photos, clear)
    out = add_silhouettes(photos, cloud, find_region(photos.poses), words)
    assert len(out.select(out["from_silhouette"] == 0)) == len(points)
    return out.select(out["from_silhouette"] == 1)


def lines_of(photo, hidden=NOTHING):
    """The lines of a photo whose mask is all sky, but for what a user hides."""
    return find_sky_lines(photo, make_raster(photo, ~hidden, hidden), 1.0)


def distance_to(twig, points):
    along = (twig[1] - twig[0]) / np.linalg.norm(twig[1] - twig[0])
    share = np.clip((points - twig[0]) @ along, 0.0, np.linalg.norm(twig[1] - twig[0]))
    return np.linalg.norm(points - twig[0] - share[:, None] * along, axis=1)


def test_lines_on_or_beside_what_a_user_hides_are_none():
    photo = draw(ring(8), 0, [TWIG])
    found = lines_of(photo)
    row = int(np.median(found.uv[:, 1]))
    hidden = np.zeros((SIDE, SIDE), bool)
    hidden[row:] = True
    left = lines_of(photo, hidden)
    assert 0.2 * len(found.uv) < len(left.uv) < 0.6 * len(found.uv)
    assert left.uv[:, 1].max() < row and not left.clear[row:].any()
    assert len(left.across) == len(left.share) == len(left.uv)


def test_ridges_lie_on_the_line():
    poses = ring(8)
    photo = draw(poses, 0, [TWIG])
    found = lines_of(photo)
    ends, _ = poses[0].project(TWIG)
    across = np.array([-1.0, 1.0]) * (ends[1] - ends[0])[::-1] / np.linalg.norm(ends[1] - ends[0])
    assert len(found.uv) > 0.9 * np.abs(ends[1] - ends[0]).max()
    assert np.percentile(np.abs((found.uv - ends[0]) @ across), 95) < 0.3
    assert np.percentile(np.abs(found.across @ across), 5) > 0.95
    assert found.clear.mean() > 0.8


def test_a_twig_before_the_sky_is_found(tmp_path):
    cloud = added(tmp_path, 12, lambda i: [TWIG])
    assert distance_to(TWIG, cloud.points).max() < 0.005
    along = np.linspace(TWIG[0], TWIG[1], 60)[3:-3]
    gaps = np.linalg.norm(along[:, None] - cloud.points, axis=2).min(axis=1)
    assert (gaps < 0.01).mean() > 0.95
    assert (cloud["n_views"] >= 4).all()
    np.testing.assert_allclose(np.linalg.norm(cloud.normals, axis=1), 1.0, atol=1e-5)


def test_plain_sky_adds_nothing(tmp_path):
    assert len(added(tmp_path, 4, lambda i: [])) == 0


@pytest.mark.parametrize("word, is_there", [(-6.0, True), (0.0, True), (-30.0, False)])
def test_a_photo_that_shows_clear_sky_is_outvoted_by_what_the_others_know(tmp_path, word, is_there):
    clear = np.full(12, -6.0)
    clear[7] = word
    new = added(tmp_path, 12, lambda i: [] if i == 7 else [TWIG], clear=clear)
    assert (len(new) > 100) == is_there


def test_a_twig_that_three_of_twelve_photos_show_is_not_there(tmp_path):
    assert len(added(tmp_path, 12, lambda i: [TWIG] if i % 4 == 0 else [])) == 0


def test_photos_without_sky_say_nothing(tmp_path):
    some = added(tmp_path, 12, lambda i: [TWIG] if i < 6 else [], before_sky=range(6))
    assert len(some) > 50
    assert some["n_views"].max() <= 6
    assert distance_to(TWIG, some.points).max() < 0.005


@pytest.mark.parametrize("n_photos", [2, 3])
def test_too_few_photos_make_no_point(tmp_path, n_photos):
    assert len(added(tmp_path, 12, lambda i: [TWIG], before_sky=range(n_photos))) == 0


def test_lines_of_different_things_do_not_meet(tmp_path):
    def others(i):
        ends = np.random.default_rng(100 + i).uniform(-0.5, 0.5, (12, 2, 3))
        return list(ends)

    n_lines = 0
    photos = Photos(tmp_path, ring(12), others, range(99))
    for i in range(12):
        n_lines += len(lines_of(draw(photos.poses, i, others(i))).uv)
    assert n_lines > 10_000
    assert len(added(tmp_path, 12, others)) < 0.002 * n_lines


def test_what_the_cloud_holds_is_not_added(tmp_path):
    held = np.linspace(TWIG[0], TWIG[1], 1500)[750:]
    new = added(tmp_path, 12, lambda i: [TWIG], points=held)
    share = (new.points - TWIG[0]) @ (TWIG[1] - TWIG[0]) / np.sum((TWIG[1] - TWIG[0]) ** 2)
    assert len(new) > 30
    assert (share < 0.53).mean() > 0.97
