"""Markers: parsing, unbiased corners, outliers, and the scale they give."""

import cv2
import numpy as np
import pytest
from marker_scene import develop, marker_scan, paint_marker, pattern_of, square
from scan_scene import look_at_poses, ring, rotation_about

from cherrypicker.errors import StageError
from cherrypicker.geometry.lines import intersect_rays
from cherrypicker.markers.combine import combine
from cherrypicker.markers.detection import (
    dictionaries_beside,
    find_markers,
    marker_dictionary,
    marker_pattern,
)
from cherrypicker.markers.estimate_scale import estimate_scale
from cherrypicker.markers.fit import fit_marker
from cherrypicker.markers.layouts import Sightings
from cherrypicker.markers.marker_scales import locate_marker, marker_references
from cherrypicker.markers.references import DICTIONARY_SIZES, check_scale, parse_marker_sides
from cherrypicker.markers.scale_scene import scale_scene
from cherrypicker.photos import read_photo
from cherrypicker.placement.footprint import Footprint
from cherrypicker.placement.region import find_region
from cherrypicker.pointcloud import PointCloud

pytestmark = pytest.mark.usefixtures("read_once")
DICTIONARY = "DICT_4X4_50"


def test_marker_sides_are_parsed():
    assert parse_marker_sides("7:0.20") == {7: 0.20}
    assert parse_marker_sides(" 7 : 0.20 , 8:0.15") == {7: 0.20, 8: 0.15}


@pytest.mark.parametrize(
    "text",
    [
        "7",
        "7:",
        ":0.2",
        "a:0.2",
        "7:0",
        "7:-0.1",
        "7:20",
        "7:200",
        "7:nan",
        "7:0.2,7:0.3",
        "7:0.2,",
        "7;0.2",
        "-7:0.2",
        "7:0.0002",
    ],
)
def test_bad_marker_sides_name_the_column(text):
    with pytest.raises(StageError) as caught:
        parse_marker_sides(text)
    assert "marker_sides_m" in caught.value.key


def test_dictionaries_are_opencvs_in_any_case():
    names = {name.upper() for name in dir(cv2.aruco) if name.startswith("DICT_")}
    assert {name.upper() for name in DICTIONARY_SIZES} == names
    for name, size in DICTIONARY_SIZES.items():
        assert len(marker_dictionary(name.lower()).bytesList) == size


def random_view(rng, side, tilt_deg=50):
    """Pixel corners of a tilted square of about this side, and the size of its photo."""
    tilt = rotation_about([*rng.normal(size=2), 0], rng.uniform(0, tilt_deg))
    corners = square([0, 0, 0], 1.0, turn_deg=rng.uniform(0, 360)) * [1, -1, 1] @ tilt.T
    corners = corners[:, :2] / (corners[:, 2:] + 1000 / side) * 1000
    corners += rng.random(2) + 0.5 * side + 6 - corners.min(axis=0)
    return corners, tuple(np.ceil(corners.max(axis=0) + 0.5 * side + 6).astype(int)[::-1])


@pytest.mark.parametrize(
    ("dictionary", "side", "blur", "gamma", "limit"),
    [
        ("DICT_5X5_250", 25, 0.6, 1.0, 0.003),
        ("DICT_5X5_250", 25, 0.6, 2.2, 0.003),
        ("DICT_4X4_50", 55, 0.5, 1.0, 0.001),
        ("DICT_5X5_250", 55, 0.9, 2.2, 0.001),
        ("DICT_APRILTAG_36h11", 55, 0.7, 2.2, 0.001),
        ("DICT_6X6_250", 110, 0.8, 2.2, 0.001),
    ],
)
def test_fitted_sides_have_no_bias(dictionary, side, blur, gamma, limit):
    """cornerSubPix alone shrinks these markers by 0.5 to 4 %."""
    rng = np.random.default_rng(side)
    ratios, errors = [], []
    for marker_id in range(4):
        corners, shape = random_view(rng, side)
        image = np.full(shape, 0.4)
        pattern = pattern_of(dictionary, marker_id)
        paint_marker(image, pattern, corners)
        grey = develop(image, blur=blur, gamma=gamma, seed=marker_id)
        fit = fit_marker(grey, corners + rng.normal(0, 0.5, (4, 2)), pattern)
        assert fit.agreement > 0.95
        true, found = corners - corners.mean(axis=0), fit.corners - fit.corners.mean(axis=0)
        ratios.append((true * found).sum() / (true**2).sum() - 1)
        errors.append(np.abs(fit.corners - corners).max())
    assert abs(np.mean(ratios)) < limit
    assert np.max(errors) < 0.15


def test_what_the_blur_along_rows_shares_with_that_along_columns_counts():
    """Tilted small markers: taken for independent they leave corners 0.031 px off."""
    rng = np.random.default_rng(1018)
    errors = []
    for marker_id in range(24):
        corners, shape = random_view(rng, 18)
        image = np.full(shape, 0.4)
        pattern = pattern_of(DICTIONARY, marker_id)
        paint_marker(image, pattern, corners)
        grey = develop(image, blur=0.8, seed=marker_id)
        errors.append(fit_marker(grey, corners + rng.normal(0, 0.5, (4, 2)), pattern).corners)
        errors[-1] -= corners
    assert np.sqrt(np.mean(np.square(errors))) < 0.025


def test_a_shadow_and_a_blade_of_grass_do_not_move_the_corners():
    rng = np.random.default_rng(1)
    corners, shape = random_view(rng, 70, tilt_deg=30)
    image = np.full(shape, 0.4)
    pattern = pattern_of(DICTIONARY, 3)
    paint_marker(image, pattern, corners)
    middle = corners.mean(axis=0).astype(int)
    image[:, middle[0] + 12 : middle[0] + 16] = 0.25
    grey = develop(image)
    fit = fit_marker(grey, corners + rng.normal(0, 0.5, (4, 2)), pattern)
    assert np.abs(fit.corners - corners).max() < 0.2


def test_detection_has_the_right_pixel_convention():
    corners, shape = random_view(np.random.default_rng(2), 60, tilt_deg=20)
    image = np.full(shape, 0.4)
    paint_marker(image, pattern_of(DICTIONARY, 5), corners)
    found = find_markers(develop(image), {DICTIONARY: marker_dictionary(DICTIONARY)})
    assert [marker_id for _, marker_id, _ in found] == [5]
    assert np.abs(found[0][2] - corners).max() < 1.5
    fit = fit_marker(develop(image), found[0][2], marker_pattern(marker_dictionary(DICTIONARY), 5))
    assert np.abs(fit.corners - corners).max() < 0.1


def test_intersect_rays_known_point_and_parallel_lines():
    rng = np.random.default_rng(3)
    point, origins = np.array([1.0, 2.0, 3.0]), rng.normal(size=(6, 3))
    directions = (point - origins) / np.linalg.norm(point - origins, axis=1)[:, None]
    np.testing.assert_allclose(intersect_rays(origins, directions), point, atol=1e-9)
    assert np.isnan(intersect_rays(origins, np.repeat([[0, 0, 1.0]], 6, axis=0))).all()


def sightings(rng, corners, poses, noise_px=0.1, focal=1000.0):
    seen = np.einsum("nij,kj->nki", poses.rotations, corners) + poses.cam_from_world[:, None, :, 3]
    seen = seen[..., :2] / seen[..., 2:]
    n = len(poses)
    return Sightings(
        photos=np.arange(n),
        cam_from_world=poses.cam_from_world,
        places=seen + rng.normal(0, noise_px / focal, seen.shape),
        focal=np.full(n, focal),
        std=np.full(n, noise_px),
        side_px=np.full(n, 60.0),
    )


def test_outlier_sightings_are_rejected():
    rng = np.random.default_rng(4)
    poses = look_at_poses(ring(12, radius=2.5), np.array([0.0, 0.3, 0.3]))
    corners = square([0.5, 0.2, 0.1], 0.2, normal=(0, -0.4, 1))
    observations = sightings(rng, corners, poses)
    observations.places[2] = np.roll(observations.places[2], 1, axis=0)
    observations.places[5] += 0.03
    observations.places[7] = rng.normal(0, 0.2, (4, 2))
    geometry = locate_marker(observations)
    np.testing.assert_array_equal(geometry["sightings"].photos, [0, 1, 3, 4, 6, 8, 9, 10, 11])
    assert geometry["square_side"] == pytest.approx(0.2, rel=1e-3)
    assert geometry["is_square"]
    np.testing.assert_allclose(geometry["corners"], corners, atol=5e-4)


def test_the_mean_of_the_sides_takes_every_sighting_at_its_word():
    """The paper's: the points nearest to all rays, and the mean distance between neighbours."""
    rng = np.random.default_rng(4)
    poses = look_at_poses(ring(12, radius=2.5), np.array([0.0, 0.3, 0.3]))
    corners = square([0.5, 0.2, 0.1], 0.2, normal=(0, -0.4, 1))
    observations = sightings(rng, corners, poses)
    good = locate_marker(observations, by="mean")
    assert good["square_side"] == good["side_lengths"].mean() == pytest.approx(0.2, rel=2e-3)
    observations.places[5] *= 1.2  # one that does not agree
    mean = locate_marker(observations, by="mean")
    origins = np.repeat(observations.centers[:, None], 4, axis=1).reshape(12, 4, 3)
    expected = [intersect_rays(origins[:, k], observations.rays[:, k]) for k in range(4)]
    np.testing.assert_allclose(mean["corners"], expected, atol=1e-12)
    assert len(mean["sightings"]) == 12 and abs(mean["square_side"] / 0.2 - 1) > 0.01
    assert locate_marker(observations)["square_side"] == pytest.approx(0.2, rel=1e-3)


def test_standard_error_matches_the_scatter():
    rng = np.random.default_rng(5)
    poses = look_at_poses(ring(8, radius=2.5), np.array([0.0, 0.0, 0.3]))
    corners = square([0.3, 0.2, 0.0], 0.2)
    results = [locate_marker(sightings(rng, corners, poses, 0.3)) for _ in range(40)]
    sides = [result["square_side"] for result in results]
    scatter = np.std(sides)
    claimed = 0.2 * np.median([result["side_std"] for result in results])
    assert 0.5 < claimed / scatter < 2.0
    assert np.mean(sides) == pytest.approx(0.2, abs=3 * scatter / 6)


def test_a_bent_marker_is_flagged():
    rng = np.random.default_rng(6)
    poses = look_at_poses(ring(10, radius=2.5), np.array([0.0, 0.0, 0.3]))
    corners = square([0.3, 0.2, 0.0], 0.2)
    corners[0, 2] += 0.03
    assert not locate_marker(sightings(rng, corners, poses))["is_square"]


def test_no_agreement_gives_none():
    rng = np.random.default_rng(7)
    poses = look_at_poses(ring(6), np.array([0.0, 0.0, 0.3]))
    observations = sightings(rng, square([0.3, 0.2, 0.0], 0.2), poses)
    observations.places[:] = rng.normal(0, 0.3, observations.places.shape)
    assert locate_marker(observations) is None


def marker_entry(marker_id, scale, std=1e-4, is_square=True):
    return {
        "id": marker_id,
        "side_m": 0.2,
        "scale": scale,
        "scale_std": std,
        "is_square": is_square,
        "used": True,
        "n_places": 1,
        "flags": [],
    }


def combine_markers(markers, warnings):
    return combine(marker_references(markers, warnings), warnings)


def test_markers_are_joined_and_a_wrong_one_is_left_out():
    warnings = []
    markers = [marker_entry(1, 2.0), marker_entry(2, 2.002), marker_entry(3, 2.2)]
    scale, std = combine_markers(markers, warnings)
    assert scale == pytest.approx(2.001, abs=1e-3)
    assert 0 < std < 0.01
    assert not markers[2]["used"] and warnings


def test_a_bent_marker_gives_way_to_a_square_one():
    warnings = []
    markers = [marker_entry(1, 2.0), marker_entry(2, 2.01, is_square=False)]
    assert combine_markers(markers, warnings)[0] == 2.0
    assert not markers[1]["used"] and "marker 2" in warnings[0]


def test_two_contradicting_markers_are_an_error():
    with pytest.raises(StageError, match="contradict"):
        combine_markers([marker_entry(1, 2.0), marker_entry(2, 2.2)], [])


def test_mode_cell_wins_over_config():
    for cell, mode in (("", "marker"), ("marker", "none")):
        assert check_scale(cell, mode, DICTIONARY, "7:0.2") == ({7: 0.2}, [])
    for cell, mode in (("", "none"), ("none", "marker"), ("0.25", "marker")):
        assert check_scale(cell, mode, DICTIONARY, "7:0.2") == ({}, [])


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    """Two markers of different size, seen by 8 distorted cameras; the model's unit is 0.4 m."""
    folder = tmp_path_factory.mktemp("scan")
    poses = look_at_poses(ring(8, radius=2.2, heights=(1.2, 1.8)), np.array([0.0, 0.0, 0.1]))
    markers = [
        (DICTIONARY, 7, square([0.25, -0.1, 0.05], 0.25, normal=(0.1, 0.0, 1))),
        (DICTIONARY, 8, square([-0.35, 0.15, 0.02], 0.2, turn_deg=30)),
    ]
    photos, model = marker_scan(folder, markers, poses)
    scaled = [marker_scan_pose(model, image_id, 2.5) for image_id in sorted(model.images)]
    assert len(scaled) == 8
    return photos, model


def marker_scan_pose(model, image_id, factor):
    """Scale the model's world by moving one camera."""
    frame = model.images[image_id].frame
    pose = frame.rig_from_world
    pose.translation = pose.translation * factor
    frame.rig_from_world = pose
    return frame


def options(**changes):
    return {
        "cell": "",
        "mode": "marker",
        "dictionary": DICTIONARY,
        "sides_m": "7:0.25,8:0.20",
        "min_images": 2,
    } | changes


@pytest.fixture(scope="module")
def report(scan):
    return estimate_scale(*scan, **options())


def test_scale_of_a_rendered_scan(report):
    assert report["scale"] == pytest.approx(0.4, rel=1e-3)
    assert 0 < report["scale_std"] < 0.004
    assert report["n_images"] == 8
    assert report["n_rays"] == sum(4 * m["n_inliers"] for m in report["markers"])
    for marker in report["markers"]:
        assert np.shape(marker["corners"]) == (4, 3)
        np.testing.assert_allclose(marker["side_lengths"], marker["side_m"] * 2.5, rtol=5e-3)
        assert marker["rms_reprojection_px"] < 0.3


def test_scale_by_the_mean_of_the_sides(scan, report):
    mean = estimate_scale(*scan, **options(side="mean"))
    assert mean["scale"] == pytest.approx(0.4, rel=5e-3) and mean["scale"] != report["scale"]
    for marker in mean["markers"]:
        assert marker["scale"] == pytest.approx(marker["side_m"] / np.mean(marker["side_lengths"]))
        assert marker["n_inliers"] == marker["n_detections"]


def test_equal_input_gives_equal_scale(scan, read_once):
    photos, model = scan
    first = estimate_scale(photos[:3], model, **options(), threads=1)
    known = dict(read_once)
    read_once.clear()
    second = estimate_scale(photos[:3], model, **options(), threads=2)
    read_once.update(known)
    assert first["scale"] == second["scale"]
    assert first["scale_std"] == second["scale_std"]


def test_two_photos_suffice_and_one_does_not(scan):
    photos, model = scan
    report = estimate_scale([photos[0], photos[3]], model, **options())
    assert report["scale"] == pytest.approx(0.4, rel=5e-3)
    with pytest.raises(StageError):
        estimate_scale(photos[:1], model, **options())


def test_missing_columns_wrong_ids_and_absurd_sides(scan):
    scan = scan[0][:3], scan[1]
    with pytest.raises(StageError, match="marker_dictionary and marker_sides_m are empty"):
        estimate_scale(*scan, **options(dictionary="", sides_m=""))
    with pytest.raises(StageError, match=r"DICT_4X4_50 7 \(3\), DICT_4X4_50 8 \(3\)"):
        estimate_scale(*scan, **options(sides_m="9:0.25"))
    with pytest.raises(StageError, match=r"DICT_4X4_50 7 \(3\), DICT_4X4_50 8 \(3\)"):
        estimate_scale(*scan, **options(dictionary="DICT_6X6_250"))
    with pytest.raises(StageError, match="contradict"):
        estimate_scale(*scan, **options(sides_m="7:0.25,8:0.30"))


def test_markers_are_not_asked_for_without_scale_but_known(scan):
    report = estimate_scale(*scan, **options(cell="none", dictionary="", sides_m=""))
    assert (report["unit"], report["scale"], report["markers"]) == ("arbitrary", None, [])
    assert [marker["id"] for marker in report["other_markers"]] == [7, 8]
    report = estimate_scale(*scan, **options(cell="0.5", sides_m=""))
    assert report["scale"] == 0.5 and report["unit"] == "m" and len(report["other_markers"]) == 2


def test_real_photos_of_markers(real_data):
    dictionary = marker_dictionary("DICT_5X5_250")
    beside = dictionaries_beside(["DICT_4X4_50"])
    for path in sorted((real_data / "photos" / "aruco_patio_2view").iterdir()):
        grey = cv2.cvtColor(read_photo(path), cv2.COLOR_RGB2GRAY)
        found = find_markers(grey, {"DICT_5X5_250": dictionary})
        assert [marker_id for _, marker_id, _ in found] == [24, 42, 66, 70]
        asked_beside = [name for *name, _ in find_markers(grey, beside)]
        assert asked_beside == [["DICT_5X5_250", marker_id] for marker_id in (24, 42, 66, 70)]
        # Sheets that are not flat, in photos that are not undistorted: the best part is found
        fits = [fit_marker(grey, at, marker_pattern(dictionary, name)) for _, name, at in found]
        assert min(fit.agreement for fit in fits) > 0.99
        assert sum(not fit.is_flat for fit in fits) == 3


def aligned_scene():
    rng = np.random.default_rng(8)
    cloud = PointCloud(
        rng.uniform([-1, -1, 0], [1, 1, 3], (5000, 3)), frame="aligned", unit="arbitrary"
    )
    crop = {
        "source": "region",
        "center_xy": [0.1, 0.0],
        "radius": 2.0,
        "camera_distance": 2.0,
        "box": {"x": [-1.9, 2.1], "y": [-2.0, 2.0], "z_min": -0.1},
    }
    return cloud, look_at_poses(ring(radius=2.0), np.array([0, 0, 1.5])), crop


def test_scale_scene_by_a_factor():
    cloud, poses, crop = aligned_scene()
    scaled, moved, report = scale_scene(
        cloud, poses, {"mode": "marker", "scale": 1.5, "unit": "m"}, crop
    )
    np.testing.assert_allclose(scaled.points, 1.5 * cloud.points)
    np.testing.assert_allclose(moved.centers, 1.5 * poses.centers)
    assert (scaled.frame, scaled.unit) == ("metric", "m")
    assert (report["factor"], report["camera_distance"]) == (1.5, 3.0)
    assert report["pixel"] == pytest.approx(0.003)  # a focal length of 1000 px
    region = Footprint.from_dict(report["region"])
    np.testing.assert_allclose(region.center_xy, [0.15, 0])
    assert (region.radius, region.box) == (3.0, None)


def test_scale_scene_without_scale_is_normalised():
    cloud, poses, crop = aligned_scene()
    region = find_region(poses)
    crop["camera_distance"] = region.distance
    scaled, moved, report = scale_scene(cloud, poses, {"mode": "none", "scale": None}, crop)
    center = report["factor"] * region.center
    assert np.median(np.linalg.norm(moved.centers - center, axis=1)) == pytest.approx(3.0)
    assert scaled.unit == report["unit"] == "arbitrary"


def test_the_region_of_a_walk_stays_a_box():
    cloud, poses, crop = aligned_scene()
    crop |= {"source": "camera_box", "center_xy": [0.1, 0.0]}
    report = scale_scene(cloud, poses, {"mode": "number", "scale": 2.0, "unit": "m"}, crop)[2]
    region = Footprint.from_dict(report["region"])
    np.testing.assert_allclose(region.box, [[-3.8, -4.0], [4.2, 4.0]])
    np.testing.assert_allclose(
        region.inward(np.array([[0.2, 0], [4.0, 0], [5.0, 0]])), [4, 0.2, -0.8]
    )
