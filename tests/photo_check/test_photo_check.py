"""The photos refute what is not there, find what is missing, and measure what is thin."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from checked_scene import STEM, TWIGS, open_scan, skeleton_of, write_scan
from sky_scene import BARK, Rod

from cherrypicker.classes import Label
from cherrypicker.mvs.raster import make_raster
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.photo_check.again import where_to_stand
from cherrypicker.photo_check.check import check_photos
from cherrypicker.photo_check.missing import hang_together
from cherrypicker.photo_check.pictures import quarter_turns, write_picture
from cherrypicker.photo_check.places import places_along
from cherrypicker.photo_check.widths import branch_diameters, silhouette_widths
from cherrypicker.pointcloud import PointCloud
from cherrypicker.poses import Poses
from cherrypicker.report.stages import photo_section
from cherrypicker.skeleton import axes

WHOLE = (STEM, *TWIGS)


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    return open_scan(tmp_path_factory.mktemp("scan"))


@pytest.fixture(scope="module")
def judged(scan):
    def check(skeleton, beside=(), wood=None):
        wood = skeleton.points if wood is None else wood
        points = np.vstack([wood, *([beside] if len(beside) else [])])
        label = np.full(len(points), Label.BRANCH, np.uint8)
        label[len(wood) :] = Label.SIGN
        cloud = PointCloud(points, fields={"label": label})
        fused = skeleton_of(WHOLE).points
        return check_photos(skeleton, cloud, scan, fused, other_stems=np.empty((0, 2)))

    return check


@pytest.fixture(scope="module")
def whole(judged):
    return judged(skeleton_of(WHOLE))


def test_the_true_skeleton_is_all_there(whole):
    report, pictures = whole
    assert report["photo_precision"] > 0.99
    assert report["missing_length"] == 0.0
    # the stem's foot stands before the ground, where twigs could not be seen
    assert 0.6 < report["photo_sky_share"] < 0.95
    assert 0.94 < report["photo_recall"] < 0.98
    assert [axis["p_exists"] > 0.98 for axis in report["axes"]] == [True] * 6
    assert report["n_photos"] == 16
    assert {name: image.ndim for name, image in pictures.items()} == {"worst": 3, "best": 3}


def test_a_strand_through_the_air_is_refuted(judged, whole):
    strand = Rod((0.0, 0.0, 1.2), (-0.25, -0.2, 1.4), 0.002, BARK)
    report, _ = judged(skeleton_of((*WHOLE, strand)))
    length = np.linalg.norm(np.subtract(strand.end, strand.start))
    assert report["refuted_length"] == pytest.approx(length, rel=0.25)
    assert report["photo_precision"] < 0.9
    assert sorted(axis["p_exists"] for axis in report["axes"])[:2] == pytest.approx(
        [0.1, 0.99], abs=0.1
    )
    assert len(report["refuted_pieces"]) == 1
    assert report["photo_recall"] == pytest.approx(whole[0]["photo_recall"], abs=0.02)


def test_a_photo_says_nothing_of_what_its_user_hides(scan):
    """A hidden strip before clear sky is no twig that covers the places behind it."""
    poses = scan.poses
    places = places_along(skeleton_of((TWIGS[0],)), 0.01)
    size = (int(poses.height[0]), int(poses.width[0]))
    uv, _ = poses[0].project(places.points)
    strip = np.zeros(size, np.uint8)
    cv2.polylines(strip, [np.rint(uv).astype(np.int32)[:, None]], False, 1, thickness=5)
    photo = np.where(strip[..., None] > 0, 20, 220).astype(np.uint8).repeat(3, axis=2)
    shown = make_raster(photo, strip == 0, np.zeros(size, bool))
    assert np.isfinite(silhouette_widths(photo, shown, poses[0], places)[0]).any()
    hidden = make_raster(photo, strip == 0, strip > 0)
    assert np.isnan(silhouette_widths(photo, hidden, poses[0], places)[0]).all()


@pytest.mark.parametrize("wood", [255, 20])
def test_wood_that_an_overexposed_photo_does_not_show_has_no_width(scan, wood):
    """The upper half of a limb of 7 px is as white as the sky, or all of it is."""
    poses = scan.poses
    places = places_along(skeleton_of((TWIGS[0],)), 0.002)
    uv, _ = poses[0].project(places.points)
    line, half = np.rint(uv).astype(np.int32)[:, None], len(uv) // 2
    none = np.zeros((int(poses.height[0]), int(poses.width[0])), np.uint8)
    strip = cv2.polylines(none.copy(), [line], False, 1, thickness=7)
    photo = np.full((*none.shape, 3), 255, np.uint8)
    photo[cv2.polylines(none.copy(), [line[:half]], False, 1, thickness=7) > 0] = wood
    raster = make_raster(photo, strip == 0, none > 0)
    width = silhouette_widths(photo, raster, poses[0], places)[0]
    assert not (width[half + half // 4 :] > 0).any()
    assert (width[:half] > 0).any() == (wood < 255)


def test_pale_wood_is_as_thick_as_dark_wood(scan):
    """Half of the light comes back from it: what lacks of the sky's is no width."""
    poses = scan.poses
    places = places_along(skeleton_of((TWIGS[0],)), 0.01)
    uv, _ = poses[0].project(places.points)
    strip = np.zeros((int(poses.height[0]), int(poses.width[0])), np.uint8)
    cv2.polylines(strip, [np.rint(uv).astype(np.int32)[:, None]], False, 1, thickness=7)
    widths = []
    for wood in (20, 160):
        photo = np.where(strip[..., None] > 0, wood, 220).astype(np.uint8).repeat(3, axis=2)
        raster = make_raster(photo, strip == 0, np.zeros(strip.shape, bool))
        widths.append(np.nanmedian(silhouette_widths(photo, raster, poses[0], places)[0]))
    assert widths[1] == pytest.approx(widths[0], rel=0.1)


def test_thin_pale_wood_is_as_thick_as_thin_dark_wood(scan):
    """What wood takes of the light is learnt from the lower half of the twig, which is wide."""
    poses = scan.poses
    places = places_along(skeleton_of((TWIGS[0],)), 0.002)
    uv, _ = poses[0].project(places.points)
    line, half = np.rint(uv).astype(np.int32)[:, None], len(uv) // 2
    strip = np.zeros((int(poses.height[0]), int(poses.width[0])), np.uint8)
    cv2.polylines(strip, [line[:half]], False, 1, thickness=7)
    cv2.polylines(strip, [line[half:]], False, 1, thickness=1)
    thin = slice(half + half // 4, None)
    found = []
    for wood in (20, 160):
        photo = np.where(strip[..., None] > 0, wood, 220).astype(np.uint8).repeat(3, axis=2)
        raster = make_raster(photo, strip == 0, np.zeros(strip.shape, bool))
        width, pixel = silhouette_widths(photo, raster, poses[0], places)
        found.append(np.nanmedian((width / pixel)[thin]))
    assert 1.0 < found[0] < np.sqrt(2)  # a line of one pixel, aslant
    assert found[1] == pytest.approx(found[0], rel=0.1)


@pytest.mark.parametrize("lit", [None, (200, 170, 120)])
def test_wood_is_as_wide_as_its_edges_or_not_asked_where_the_sun_is_on_it(scan, lit):
    """Half of a limb of 7 px in the sun: red as the cloud's, blue not."""
    poses = scan.poses
    places = places_along(skeleton_of((TWIGS[0],)), 0.01)
    uv, _ = poses[0].project(places.points)
    line = np.rint(uv).astype(np.int32)[:, None]
    photo = np.full((int(poses.height[0]), int(poses.width[0]), 3), 205, np.uint8)
    strip = cv2.polylines(np.zeros(photo.shape[:2], np.uint8), [line], False, 1, thickness=7)
    photo[strip > 0] = 30
    if lit:
        photo[cv2.polylines(0 * strip, [line + [0, 2]], False, 1, thickness=3) > 0] = lit
    raster = make_raster(photo, strip == 0, np.zeros(strip.shape, bool))
    width, pixel = silhouette_widths(photo, raster, poses[0], places)
    if lit:
        assert np.isnan(width).all()
    else:
        drawn = strip.sum() / np.linalg.norm(np.ptp(uv, axis=0))
        assert np.nanmedian(width / pixel) == pytest.approx(drawn, abs=1.0)


@pytest.mark.parametrize("gone", [1, 2, 4])
def test_a_limb_that_was_removed_is_missing(judged, gone):
    kept = tuple(rod for rod in WHOLE if rod is not WHOLE[gone])
    report, _ = judged(skeleton_of(kept))
    length = np.linalg.norm(np.subtract(WHOLE[gone].end, WHOLE[gone].start))
    assert report["missing_length"] == pytest.approx(length, rel=0.35)
    assert report["photo_recall"] < 0.92
    (piece,) = report["missing_pieces"]
    middle = np.add(WHOLE[gone].end, WHOLE[gone].start) / 2
    assert np.linalg.norm(piece["at"] - middle) < 0.3 * length
    assert report["photo_precision"] > 0.98


def test_a_top_that_was_cut_off_is_missing_at_the_top(judged):
    skeleton = skeleton_of((STEM, *TWIGS[:3]))
    cut = skeleton.select(skeleton.points[:, 2] < 1.30)
    report, _ = judged(cut)
    assert report["photo_recall"] < 0.8
    layers = [layer["length"] for layer in report["missing_by_height"]]
    assert sum(layers[-2:]) > 0.9 * sum(layers)


def test_a_skeleton_beside_the_tree_is_refuted_and_the_tree_missing(judged):
    skeleton = skeleton_of(WHOLE)
    moved = replace(skeleton, points=skeleton.points + [0.0, 0.0, 0.02])
    report, _ = judged(moved, wood=skeleton.points)
    assert report["photo_precision"] < 0.8
    assert report["photo_recall"] < 0.95


def test_what_stands_nearer_to_a_sign_is_not_missing(judged):
    kept = (STEM, *TWIGS[1:])
    sign = skeleton_of((STEM, TWIGS[0])).points[76:]
    assert judged(skeleton_of(kept), beside=sign)[0]["missing_length"] < 0.05


def test_only_what_joins_the_tree_is_missing_from_it():
    patches = np.linspace([0.2, 0, 1], [0.9, 0, 1], 8)  # a limb in patches 10 cm apart
    row = np.linspace([2.0, 0, 1], [2.5, 0, 1], 50)  # a twig of the next row
    points = np.vstack([patches, row])
    joined = hang_together(points, points[:, 0], 0.25)
    assert joined.tolist() == [True] * 8 + [False] * 50


def test_silhouettes_tell_how_thick_twigs_are(judged):
    skeleton = skeleton_of(WHOLE)
    thick = replace(skeleton, radius=skeleton.radius + 0.0015)
    report, _ = judged(thick)
    found = {each["branch_id"]: each for each in report["branches"]}
    assert len(found) == 6
    for each in found.values():
        assert each["n_photos"] > 8 and each["length"] > 0.05
        true = 2 * _radius_of(skeleton, each["branch_id"])
        assert abs(each["diameter"] - true) < max(3 * each["diameter_se"], 0.0005)


def test_a_branch_that_takes_no_light_has_no_diameter():
    skeleton = skeleton_of((STEM,))
    places = places_along(skeleton, 0.01)
    width = np.full((6, len(places.points)), 0.01)
    pixel = np.full_like(width, 0.001)
    assert [each["diameter"] for each in branch_diameters(skeleton, places, width, pixel)] == [0.01]
    assert branch_diameters(skeleton, places, 0 * width, pixel) == []


def _radius_of(skeleton, branch):
    return float(np.median(skeleton.radius[axes(skeleton)[branch].nodes]))


def test_the_report_shows_what_the_photos_say(whole, tmp_path):
    report, pictures = whole
    data = {"photo_check": report}
    for name, picture in pictures.items():
        write_picture(tmp_path / name, picture)
        data[f"{name}_photo"] = (tmp_path / name).read_bytes()
    section = photo_section(data)
    facts = dict(section["facts"])
    assert facts["Precision by the photos"] == f"{report['photo_precision']:.3f}"
    assert [figure[:2] for figure, *_ in section["figures"]] == [b"\xff\xd8"] * 2
    assert [len(table["rows"]) for table in section["tables"]] == [1, 2, 4, 10]
    report["photos"][3]["word_of_clear_sky"] = -0.1
    assert photo_section(data)["tables"][-1]["rows"] == [["03.png", "-0.1"]]


def test_the_foot_before_the_ground_is_to_be_photographed_from_below(scan, whole):
    (stand,) = whole[0]["photograph_again"]
    centers = scan.poses.centers
    assert stand["height"] < np.median(centers[:, 2]) - STEM.start[2]
    assert stand["at"][2] < 1.0 and np.hypot(*stand["at"][:2]) < 0.05
    assert 0.05 < stand["unsure_length"] < 0.4


def test_where_all_is_sure_nobody_is_sent_out_again(scan):
    points = skeleton_of(WHOLE).points
    sure = np.zeros(len(points))
    assert where_to_stand(scan, points[0], points, np.full(len(points), 0.004), sure) == []


def test_the_cameras_stand_where_the_metric_poses_say(tmp_path):
    """In another frame and unit than the workspace's own, and without a photo that has no pose."""
    poses = write_scan(tmp_path)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    moved = poses.transformed(2.0, turn, np.array([1.0, -2.0, 0.5]))
    rows = np.arange(len(moved)) != 3
    fewer = Poses(*(getattr(moved, name)[rows] for name in vars(moved)))
    workspace = ScanPhotos(poses, tmp_path, fewer)
    assert workspace.unit == pytest.approx(2.0)
    assert workspace.poses.names.tolist() == fewer.names.tolist()
    assert workspace.poses.cam_from_world == pytest.approx(fewer.cam_from_world)
    centers = np.array([-view.R.T @ view.t for view in workspace.views])
    assert centers == pytest.approx(fewer.centers)
    assert [view.name for view in workspace.views] == fewer.names.tolist()


def test_pictures_are_turned_upright():
    level = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # looks along y, up is up
    photo = np.zeros((4, 6))
    photo[0] = 1  # the upper border
    for turns in range(4):
        stored = np.rot90(photo, -turns)
        angle = -turns * np.pi / 2  # counter-clockwise in the photo, y down
        turn = np.array(
            [[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
        )
        found = quarter_turns(turn @ level)
        assert np.array_equal(np.rot90(stored, found), photo), turns
