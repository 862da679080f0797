"""Known lengths beside markers: each gives the scale, they are joined, and a wrong one is named."""

import cv2
import numpy as np
import pytest
from marker_scene import charuco_pattern, checker_pattern, marker_scan, rectangle, square
from PIL import Image
from scan_scene import look_at_poses, ring

from cherrypicker.batch.config import resolve_config
from cherrypicker.errors import StageError
from cherrypicker.files import load_yaml
from cherrypicker.intake.places import stated_place
from cherrypicker.markers.boards import find_charuco
from cherrypicker.markers.combine import combine
from cherrypicker.markers.estimate_scale import estimate_scale
from cherrypicker.markers.reference_scales import measure_reference
from cherrypicker.markers.references import Reference, check_scale
from cherrypicker.markers.scan import Scan
from cherrypicker.markers.tape import scale_of_trunk

DICTIONARY = "DICT_4X4_50"
CENTERS = np.array([[0.30, -0.15, 0.05], [-0.35, 0.10, 0.02]])
LENGTH = float(np.linalg.norm(CENTERS[0] - CENTERS[1]))
BAR = {"kind": "distance", "markers": [7, 8], "length_m": LENGTH}
BOARD = {
    "kind": "charuco",
    "dictionary": "DICT_5X5_100",
    "squares": [5, 4],
    "length_m": 0.072,
    "marker_m": 0.056,
}
CUBE = {"kind": "cube", "length_m": 0.2, "cells": 4}
pytestmark = pytest.mark.usefixtures("read_once")
UNIT = 0.4  # metres a unit of the model


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    """Two markers, a ChArUco board and a cube of which two faces and the top are painted."""
    folder = tmp_path_factory.mktemp("references")
    poses = look_at_poses(ring(9, radius=2.0, heights=(1.0, 1.5)), np.array([0.0, 0.05, 0.1]))
    markers = [
        (DICTIONARY, 7, square(CENTERS[0], 0.15, normal=(0.1, 0, 1))),
        (DICTIONARY, 8, square(CENTERS[1], 0.15, turn_deg=30)),
    ]
    low, e = np.array([0.05, 0.25, 0.0]), 0.2
    x, y, z = np.eye(3) * e
    board = rectangle([-0.25, -0.15, 0.0], [0.36, 0, 0], [0, -0.288, 0])
    boards = [
        (charuco_pattern(BOARD), board, 2.0),
        (checker_pattern(4), rectangle(low + z, y, x), 0.0),
        (checker_pattern(4), rectangle(low, x, z), 0.0),
        (checker_pattern(4), rectangle(low + x, y, z), 0.0),
    ]
    boards[1:] = [(pattern, outward(at, low + e / 2), margin) for pattern, at, margin in boards[1:]]
    photos, model = marker_scan(
        folder, markers, poses, boards=boards, size=(960, 720), focal=1100.0
    )
    for image in model.images.values():
        pose = image.frame.rig_from_world
        pose.translation = pose.translation / UNIT
        image.frame.rig_from_world = pose
    return photos, model


def outward(corners, middle):
    """The face's corners in the order in which it is seen from outside."""
    normal = np.cross(corners[1] - corners[0], corners[3] - corners[0])
    return corners if normal @ (corners.mean(axis=0) - middle) < 0 else corners[[0, 3, 2, 1]]


def scale_of(scan, *references, sides="", photos=slice(None)):
    options = {
        "cell": "",
        "mode": "marker",
        "dictionary": DICTIONARY,
        "sides_m": sides,
        "min_images": 2,
        "references": list(references),
    }
    return estimate_scale(scan[0][photos], scan[1], **options)


def test_a_board_that_two_photos_show_is_told_and_its_markers_go_on(scan):
    """Two photos locate it, but nothing tells how well."""
    photos, model = scan
    seen = [
        bool(find_charuco(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), BOARD)) for path in photos
    ]
    shown = [path for path, is_seen in zip(photos, seen, strict=True) if is_seen][:2]
    others = [path for path, is_seen in zip(photos, seen, strict=True) if not is_seen]
    with pytest.raises(StageError, match="2 of 2 photos agree on where it is, 3 are needed"):
        scale_of((shown, model), BOARD)
    report = scale_of((shown + others, model), BOARD, sides="7:0.15,8:0.15")
    (board,) = [each for each in report["references"] if each["kind"] == "charuco"]
    assert not board["used"] and "3 are needed" in board["flags"][0]


def test_boards_that_no_photo_shows_give_no_scale(tmp_path):
    poses = look_at_poses(ring(3, radius=2.0), np.zeros(3))
    with pytest.raises(StageError, match=r"charuco .*: 0 of 3 .*cube .*: 0 of 3 photos agree"):
        scale_of(marker_scan(tmp_path, [], poses), BOARD, CUBE)


@pytest.mark.parametrize("reference", [BAR, BOARD, CUBE], ids=["distance", "charuco", "cube"])
def test_each_kind_gives_the_scale_by_itself(scan, reference):
    report = scale_of(scan, reference, photos=slice(0, 18, 2))
    assert report["scale"] == pytest.approx(UNIT, rel=0.003)
    assert abs(report["scale"] / UNIT - 1) < 3 * report["scale_std"] / report["scale"] < 0.02
    assert report["references"][0]["check"] is None, "nothing to check it against"


def test_ends_of_a_distance_are_markers_whatever_their_dictionary(scan):
    bar = BAR | {"dictionary": DICTIONARY}
    photos, model = scan
    options = {"cell": "", "mode": "marker", "dictionary": "", "sides_m": "", "min_images": 2}
    report = estimate_scale(photos[::4], model, references=[bar], **options)
    told = [(marker["dictionary"], marker["id"]) for marker in report["markers"]]
    assert told == [(DICTIONARY, 7), (DICTIONARY, 8)] and report["mode"] == "marker"
    assert all(marker["is_square"] for marker in report["markers"])


def test_a_bar_two_percent_wrong_is_named_and_left_out(scan):
    wrong = BAR | {"length_m": 1.02 * LENGTH}
    report = scale_of(scan, wrong, BOARD, sides="7:0.15,8:0.15", photos=slice(0, 9, 2))
    assert report["scale"] == pytest.approx(UNIT, rel=0.003)
    entries = {one["name"]: one for one in report["references"]}
    assert not entries["distance 7 to 8"]["used"]
    assert entries["distance 7 to 8"]["check"]["difference"] == pytest.approx(0.02, abs=0.003)
    assert all(entries[name]["used"] for name in ("marker 7", "marker 8"))
    (line,) = report["doubts"]
    assert "distance 7 to 8" in line and "scale.references.0" in line


def test_references_that_agree_check_one_another(scan):
    report = scale_of(scan, BAR, BOARD, sides="7:0.15,8:0.15", photos=slice(0, 9, 2))
    assert report["doubts"] == []
    for one in report["references"]:
        assert one["used"] and abs(one["check"]["difference"]) < 0.005
    assert report["scale_std"] < max(one["scale_std"] for one in report["references"])


def test_a_bar_whose_marker_is_not_seen(scan):
    unseen = BAR | {"markers": [7, 9]}
    report = scale_of(scan, unseen, sides="7:0.15", photos=slice(3))
    assert any("distance 7 to 9" in line and "marker 9" in line for line in report["doubts"])
    with pytest.raises(StageError, match="marker 9") as caught:
        scale_of(scan, unseen, photos=slice(2))
    assert "scale.references.0" in caught.value.key


@pytest.mark.parametrize(
    ("entry", "text", "key"),
    [
        ({"kind": "rope", "length_m": 1.0}, "'rope' is not one of", "scale.references.0.kind"),
        ({"kind": "distance", "markers": [7, 8]}, "'length_m' is a req", "scale.references.0"),
        ({"kind": "distance", "length_m": 1.0}, "'markers' is a req", "scale.references.0"),
        ({"kind": "charuco", "length_m": 1.0}, "'marker_m' is a req", "scale.references.0"),
        ({"kind": "cube", "length_m": 1.0}, "'cells' is a req", "scale.references.0"),
        ({"kind": "trunk", "length_m": 1.0}, "'height_m' is a req", "scale.references.0"),
        ({"kind": "gps", "length_m": 1.0}, "'length_m' is not one of", "scale.references.0"),
        (BAR | {"height_m": 1.0}, "'height_m' is not one of", "scale.references.0"),
        (BAR | {"length_m": -1}, "less than", "scale.references.0.length_m"),
        (BAR | {"length_m": True}, "not of type 'number'", "scale.references.0.length_m"),
        (BAR | {"length_m": float("nan")}, "not of type 'number'", "scale.references.0.length_m"),
        (BAR | {"markers": [7, 7]}, "non-unique", "scale.references.0.markers"),
        (BAR | {"markers": [7, 50]}, "0 to 49", "scale.references.0.markers"),
        (BAR | {"dictionary": "DICT_4X4"}, "no marker dict", "scale.references.0.dictionary"),
        (BOARD | {"squares": [2, 4]}, "less than", "scale.references.0.squares.0"),
        (BOARD | {"marker_m": 0.08}, "smaller than its squares", "scale.references.0.marker_m"),
        (CUBE | {"cells": 3}, "less than", "scale.references.0.cells"),
    ],
)
def test_a_reference_that_cannot_be_is_refused_by_its_key(project, entry, text, key):
    schema = load_yaml(project / "workflow/schemas/config.schema.yaml")
    with pytest.raises(StageError, match=text) as caught:
        settings = resolve_config(schema, {"scale": {"references": [entry]}})
        check_scale("", "marker", DICTIONARY, "", settings["scale"]["references"])
    assert caught.value.key == key


def test_a_reference_by_hand_goes_past_the_schema_and_is_refused_by_its_key(scan):
    for bad in ("{kind: rope}", "[", "kind", "{kind: cube, length_m: 0.2}"):
        with pytest.raises(StageError) as caught:
            scale_of(scan, bad, photos=slice(2))
        assert caught.value.key == "scale.references.0"
    (bar,) = check_scale("", "marker", DICTIONARY, "", ["{kind: trunk, length_m: 2}"])[1]
    assert (bar.kind, bar.length_m, bar.tolerance_m) == ("trunk", 2.0, 0.001)


def entry(name, scale, std, slack=0.0):
    return {
        "name": name,
        "key": f"key of {name}",
        "scale": scale,
        "scale_std": std * scale,
        "slack": slack,
        "used": True,
        "flags": [],
    }


def test_the_standard_error_holds_what_references_differ_by():
    """Ten pairs that scatter by 0.3 % though each says 0.05 %: the joint error covers."""
    rng = np.random.default_rng(3)
    inside = []
    for _ in range(200):
        pair = [entry(str(i), 2.0 * (1 + rng.normal(0, 0.003)), 5e-4, 0.003) for i in range(5)]
        scale, std = combine(pair, [])
        inside.append(abs(scale - 2.0) < 1.645 * std)
    assert 0.75 < np.mean(inside) <= 1.0


def test_two_that_contradict_are_in_doubt_or_an_error():
    doubts = []
    pair = [entry("bar", 2.0, 5e-4), entry("tape", 2.04, 5e-4)]
    _, std = combine(pair, doubts)
    assert "bar" in doubts[0] and "tape" in doubts[0] and "key of tape" in doubts[0]
    assert std > 0.005 * 2.0
    with pytest.raises(StageError, match=r"contradict .* 9\.5 %"):
        combine([entry("bar", 2.0, 5e-4), entry("tape", 2.2, 5e-4)], [])


def stem(diameter, height=1.0, *, seed=0):
    """Points on a stem at (0.1, 0) over ground at z = 0, with a post farther off, m."""
    rng = np.random.default_rng(seed)
    angle, z = rng.uniform(0, 2 * np.pi, 6000), rng.uniform(0, height, 6000)
    around = np.column_stack([np.cos(angle), np.sin(angle)])
    trunk = np.column_stack([(diameter / 2 + rng.normal(0, 0.001, 6000))[:, None] * around, z])
    post = np.column_stack([0.04 * around + [0.9, 0.2], z * 1.5 / height])
    ground = np.column_stack([rng.uniform(-1.5, 1.5, (8000, 2)), rng.normal(0, 0.004, 8000)])
    return np.concatenate([trunk + [0.1, 0.0, 0.0], post, ground])


@pytest.mark.parametrize("start", [0.25, 0.4, 0.7])
def test_a_tape_around_the_trunk(start):
    scale, error = scale_of_trunk(stem(0.12) / UNIT, 0.5, 0.12, start, seed=0)
    assert scale == pytest.approx(UNIT, rel=0.01)
    assert 0.003 < error < 0.03


def test_a_tape_where_no_trunk_stands():
    with pytest.raises(StageError, match="no trunk stands 2 m over the ground"):
        scale_of_trunk(stem(0.12) / UNIT, 2.0, 0.12, UNIT, seed=0)


def test_positions_in_exif(tmp_path):
    rng = np.random.default_rng(5)
    centers = 10 * ring(40, radius=1.0, heights=(0.1, 0.3))
    metres = UNIT * centers[:, [1, 0, 2]] * [1, -1, 1] + rng.normal(0, 0.1, centers.shape)
    degrees = metres[:, [1, 0, 2]] / [111_132.0, 111_320.0 * np.cos(np.radians(48.0)), 1.0]
    paths = []
    for number, (north, east, up) in enumerate(degrees + [48.0, -1.0, 300.0]):
        paths.append(tmp_path / f"{number}.jpg")
        exif = Image.Exif()
        exif[0x8825] = {1: "N", 2: parts(north), 3: "W", 4: parts(-east), 5: b"\0", 6: up}
        Image.new("L", (8, 8)).save(paths[-1], exif=exif)
    poses = np.stack([np.column_stack([np.eye(3), -center]) for center in centers])
    reference = Reference("gps", "scale.references.0", np.nan, 0.1, {})
    found = measure_reference(reference, Scan(paths, [], poses), {}, None)
    assert found["scale"] == pytest.approx(UNIT, rel=0.03)
    assert abs(found["scale"] / UNIT - 1) < 3 * found["scale_std"] / UNIT < 0.03
    two = measure_reference(reference, Scan(paths[:2], [], poses[:2]), {}, None)
    assert not two["used"] and "too few" in two["flags"][0]
    cv2.imwrite(str(tmp_path / "bare.jpg"), np.zeros((8, 8), np.uint8))
    assert stated_place(tmp_path / "bare.jpg") is None
    exif[0x8825] = {1: "N", 2: parts(0.0), 3: "W", 4: parts(0.0)}  # no fix yet
    Image.new("L", (8, 8)).save(tmp_path / "nowhere.jpg", exif=exif)
    assert stated_place(tmp_path / "nowhere.jpg") is None


def test_references_do_not_trouble_a_tree_whose_scale_is_given():
    bar = [{"kind": "distance", "markers": [7, 8], "length_m": 1.0}]
    assert check_scale("0.8", "marker", "", "", bar) == ({}, [])
    assert check_scale("none", "marker", "", "", bar) == ({}, [])


def parts(degrees):
    """Degrees, minutes and seconds."""
    minutes = 60 * (degrees - int(degrees))
    return int(degrees), int(minutes), 60 * (minutes - int(minutes))


def test_the_surer_reference_counts_for_more():
    scale, std = combine([entry("board", 2.0, 1e-3), entry("tape", 2.04, 1e-2)], [])
    assert abs(scale - 2.0) < 0.002
    assert std < 0.01
