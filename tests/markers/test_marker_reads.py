"""Markers that a table does not name, and reads of markers where none are."""

import numpy as np
import pycolmap
import pytest
from marker_scene import square
from scan_scene import look_at_poses, ring

from cherrypicker.markers.detection import Reads
from cherrypicker.markers.estimate_scale import estimate_scale
from cherrypicker.markers.marker_scales import measure_marker
from cherrypicker.markers.reads import sort_reads
from cherrypicker.markers.scan import Scan

FOCAL = 1000.0
OURS = "DICT_4X4_50"
KNOWN, BESIDE = square([0.5, 0.2, 0.1], 0.2, normal=(0, -0.4, 1)), [-0.4, 0.3, 0.2]


@pytest.fixture(scope="module")
def scan():
    poses = look_at_poses(ring(12, radius=2.5), np.array([0.0, 0.3, 0.3]))
    return Scan(list(poses.names), [], poses.cam_from_world)


def read(scan, photo, marker_id, corners, rng, *, noise_px=0.1, matched=True, dictionary=OURS):
    """A read of corners (4, 3) in a photo, or of corners (4, 2) wherever they are."""
    pose = scan.cam_from_world[photo]
    if corners.shape[1] == 3:
        corners = corners @ pose[:, :3].T + pose[:, 3]
        corners = corners[:, :2] / corners[:, 2:]
    coarse = corners + rng.normal(0, 0.5 / FOCAL, (4, 2))
    exact = corners + rng.normal(0, noise_px / FOCAL, (4, 2))
    side = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).mean() * FOCAL
    return {
        "photos": photo,
        "cam_from_world": pose,
        "dictionaries": dictionary,
        "ids": marker_id,
        "places": exact if matched else coarse,
        "focal": FOCAL,
        "std": noise_px if matched else 1.0,
        "side_px": side,
        "is_precise": matched,
        "is_matched": matched,
    }


def joined(reads):
    return Reads(**{name: np.array([each[name] for each in reads]) for name in reads[0]})


def sorted_reads(scan, others, rng, *, known=KNOWN):
    """What comes of reads beside a marker 7 that all photos show and the table names."""
    own = [read(scan, photo, 7, known, rng) for photo in range(12)]
    reads = joined([*own, *others])
    marker = measure_marker(OURS, 7, 0.2, reads.of(OURS, 7), scan)
    return sort_reads(reads, {(OURS, 7): marker}, scan)


def false_quad(rng):
    """Corners of a small quadrangle anywhere in a photo."""
    return square([*rng.uniform(-0.4, 0.4, 2), 0], 0.014, turn_deg=rng.uniform(0, 360))[:, :2]


def test_nothing_but_the_known_marker_leaves_nothing(scan):
    result = sorted_reads(scan, [], np.random.default_rng(0))
    assert (result.squares, result.unsolved, result.false) == ([], [], [])


def test_another_marker_that_is_there_is_solved(scan):
    rng = np.random.default_rng(1)
    corners = square(BESIDE, 0.15, turn_deg=20)
    for photos in (range(12), [2, 5]):
        others = [read(scan, photo, 9, corners, rng) for photo in photos]
        result = sorted_reads(scan, others, rng)
        (found,) = result.squares
        assert found["id"] == 9 and found["n_images"] == len(photos)
        np.testing.assert_allclose(found["corners"], corners, atol=2e-3)
        assert not result.unsolved and not result.false


def test_reads_whose_rays_do_not_meet_are_false(scan):
    for seed in range(5):
        rng = np.random.default_rng(seed)
        others = [
            read(scan, photo, 17, false_quad(rng), rng, matched=photo % 2 == 0)
            for photo in (1, 4, 4, 6, 9)
        ]
        result = sorted_reads(scan, others, rng)
        assert not result.squares
        assert sum(place["n_images"] for place in result.unsolved) <= 2  # two may meet by chance
        (false,) = result.false
        assert false["id"] == 17
        assert set(false["photos"]) <= {scan.photos[photo] for photo in (1, 4, 6, 9)}


def test_a_single_read_shows_nothing(scan):
    rng = np.random.default_rng(3)
    result = sorted_reads(scan, [read(scan, 3, 9, square(BESIDE, 0.15), rng)], rng)
    (false,) = result.false
    assert (false["id"], false["photos"]) == (9, [scan.photos[3]])
    assert not result.squares and not result.unsolved


def test_a_blurred_marker_leaves_its_place_open(scan):
    rng = np.random.default_rng(4)
    corners = square(BESIDE, 0.06)
    others = [read(scan, photo, 9, corners, rng, matched=False) for photo in (2, 5)]
    result = sorted_reads(scan, others, rng)
    (place,) = result.unsolved
    assert (place["id"], place["n_images"]) == (9, 2)
    away = np.linalg.norm(corners - place["center"], axis=1)
    assert 0.9 * away.max() < place["radius"] < 3 * away.max()
    assert not result.squares and not result.false


def test_corners_that_meet_but_in_no_square_leave_their_place_open_where_they_match(scan):
    rng = np.random.default_rng(5)
    bent = square(BESIDE, 0.15)
    bent[0, 2] += 0.02
    result = sorted_reads(scan, [read(scan, photo, 9, bent, rng) for photo in range(6)], rng)
    (place,) = result.unsolved
    assert np.linalg.norm(place["center"] - bent.mean(axis=0)) < 0.01
    assert not result.squares and not result.false


def test_a_brick_that_several_photos_read_is_no_marker(scan):
    """Their rays do meet, in a rectangle of two to one: no such corners are of a square."""
    rng = np.random.default_rng(6)
    brick = square(BESIDE, 0.1)
    brick[:, 1] = BESIDE[1] + 0.5 * (brick[:, 1] - BESIDE[1])
    others = [read(scan, photo, 17, brick, rng, matched=False) for photo in (1, 3, 6)]
    result = sorted_reads(scan, others, rng)
    assert [false["n_images"] for false in result.false] == [3]
    assert not result.squares and not result.unsolved


def test_a_false_read_of_a_known_marker_is_listed_and_moves_nothing(scan):
    rng = np.random.default_rng(7)
    plain = sorted_reads(scan, [], rng)
    others = [read(scan, photo, 7, false_quad(rng), rng, matched=False) for photo in (2, 8)]
    result = sorted_reads(scan, others, rng)
    assert not plain.false and not result.squares
    photos = [scan.photos[photo] for photo in (2, 8)]
    assert result.false == [{"dictionary": OURS, "id": 7, "n_images": 2, "photos": photos}]


def test_a_known_markers_own_coarse_reads_are_not_false(scan):
    rng = np.random.default_rng(8)
    others = [read(scan, photo, 7, KNOWN, rng, matched=False) for photo in range(12)]
    result = sorted_reads(scan, others, rng)
    assert (result.squares, result.unsolved, result.false) == ([], [], [])


def test_a_marker_of_another_dictionary_is_solved_and_one_of_the_same_id_stays_apart(scan):
    rng = np.random.default_rng(10)
    corners, other = square(BESIDE, 0.15), "DICT_5X5_250"
    others = [read(scan, photo, 7, corners, rng, dictionary=other) for photo in range(6)]
    result = sorted_reads(scan, others, rng)
    (found,) = result.squares
    assert (found["dictionary"], found["id"]) == (other, 7)
    np.testing.assert_allclose(found["corners"], corners, atol=2e-3)
    assert not result.again and not result.unsolved and not result.false


def test_a_marker_is_sure_without_a_known_one(scan):
    rng = np.random.default_rng(9)
    corners = square(BESIDE, 0.15)
    reads = [read(scan, photo, 9, corners, rng) for photo in range(6)]
    result = sort_reads(joined(reads), {}, scan)
    assert [marker["id"] for marker in result.squares] == [9] and not result.unsolved


def test_bricks_of_a_rendered_wall_are_false_reads(real_data):
    """Reads of id 17 in dark bricks of four photos; six photos show the marker."""
    scene = real_data / "scenes/foreign_b"
    if not scene.is_dir():
        pytest.skip(f"REAL DATA MISSING: {scene}")
    walls, shown = (1, 59, 64, 68), (18, 24, 33, 36, 80, 82)
    with np.load(scene / "gt/cameras.npz") as cameras:
        k, matrices = cameras["K"][0], np.dstack([cameras["R"], cameras["t"]])
    model = pycolmap.Reconstruction()
    size, params = (1200, 800), [k[0, 0], k[1, 1], k[0, 2], k[1, 2]]
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(camera_id=1, model="PINHOLE", width=size[0], height=size[1], params=params)
    )
    photos = []
    for photo in sorted(walls + shown):
        photos.append(scene / f"images/{photo:04d}.jpg")
        image = pycolmap.Image(name=photos[-1].name, camera_id=1, image_id=photo)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(matrices[photo]))
    report = estimate_scale(
        photos,
        model,
        cell="",
        mode="marker",
        dictionary="DICT_4X4_50",
        sides_m="23:0.15",
        min_images=2,
    )
    assert report["scale"] == pytest.approx(1.0, rel=2e-3)
    assert report["n_images"] == len(shown)
    names = [f"{photo:04d}.jpg" for photo in walls]
    (false,) = report["false_reads"]
    assert false["id"] == 17 and set(false["photos"]) <= set(names) and false["n_images"] >= 2
    assert not report["other_markers"] and not report["unsolved_markers"] and not report["doubts"]
