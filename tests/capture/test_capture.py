"""The check of photos: what it tells of sharpness, light, markers and the walk round the tree."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from scan_scene import look_at_poses

from cherrypicker.capture.look import Look, blur_of, look_at
from cherrypicker.capture.overlap import Overlap
from cherrypicker.capture.ring import find_ring, widest_gaps
from cherrypicker.capture.verdict import judge
from cherrypicker.command.main import main
from cherrypicker.markers.detection import marker_dictionary

SIZE, FOCAL = 300, 1.2  # px, and in longer sides
DICTIONARY = "DICT_4X4_50"


def cameras(azimuths, height=1.5, distance=4.0):
    """Rotations and places of cameras that look at (0, 0, 1)."""
    angle = np.radians(azimuths)
    z = np.full(len(angle), height)
    places = np.column_stack([distance * np.cos(angle), distance * np.sin(angle), z])
    return list(zip(look_at_poses(places, [0, 0, 1.0]).rotations, places))


def turns(poses, pairs, rng, noise_deg=2.0, n_matches=60):
    found = []
    for first, second in pairs:
        turn, _ = cv2.Rodrigues(np.radians(noise_deg) * rng.normal(size=3))
        found.append(Overlap(first, second, n_matches, turn @ poses[second][0] @ poses[first][0].T))
    return found


def neighbours(azimuths, reach=50.0):
    apart = np.abs((np.subtract.outer(azimuths, azimuths) + 180) % 360 - 180)
    return [(i, j) for i, j in zip(*np.nonzero(np.triu(apart < reach, 1)))]


def test_azimuths_follow_from_turns_alone():
    rng = np.random.default_rng(0)
    true = np.sort(rng.uniform(0, 290, 40))
    ring = find_ring(40, turns(cameras(true), neighbours(true), rng))
    assert not ring.group.any()
    off = np.exp(1j * np.radians(ring.azimuth_deg - true))
    error = np.degrees(np.angle(off / off.mean()))
    assert np.abs(error).max() < 5.0
    width, before, after = widest_gaps(ring.azimuth_deg, 25.0)[0]
    assert (before, after) == (39, 0)
    assert width == pytest.approx(360 - true[-1] + true[0], abs=6.0)
    assert ring.is_told and np.isfinite(ring.told_deg).mean() > 0.9


def test_a_gap_over_north_is_a_gap():
    azimuth = np.array([np.nan, 310.0, 290.0, 40.0, *range(60, 290, 20)])
    assert widest_gaps(azimuth, 25.0) == [(90.0, 1, 3)]


@pytest.mark.parametrize("blur", [0.1, 0.9])
def test_where_photos_are_blurred_there_is_a_gap(monkeypatch, blur):
    true = np.arange(0, 360, 10.0)
    found = turns(cameras(true), neighbours(true, 40.0), np.random.default_rng(0))
    monkeypatch.setattr("cherrypicker.capture.verdict.find_overlaps", lambda *_: found)
    blurs = [blur if i in (10, 11, 12) else 0.1 for i in range(len(true))]
    looks = [Look(Path(f"{i}.jpg"), digest=str(i), blur=each) for i, each in enumerate(blurs)]
    verdict = judge(looks, (), 1)
    gaps = [set(each.photos) for each in verdict.findings if "between" in each.text]
    assert gaps == ([{9, 13}] if blur > 0.5 else []) and len(verdict.gaps) == len(gaps)


@pytest.mark.parametrize("noise_deg", [2.0, 40.0])
def test_azimuths_that_overlaps_disagree_on_cannot_be_told(monkeypatch, noise_deg):
    """With turns that are wrong a gap is a hint; with good ones the same gap is to be filled."""
    rng = np.random.default_rng(0)
    true = np.arange(0, 300, 7.5)
    found = turns(cameras(true), neighbours(true, 40.0), rng, noise_deg)
    ring = find_ring(len(true), found)
    assert ring.is_told is (noise_deg < 10)
    assert np.isfinite(ring.told_deg).any() == ring.is_told
    monkeypatch.setattr("cherrypicker.capture.verdict.find_overlaps", lambda *_: found)
    looks = [Look(Path(f"{i:02d}.jpg"), digest=str(i)) for i in range(len(true))]
    verdict = judge(looks, (), 1)
    told = [each.text for each in verdict.findings]
    assert verdict.is_go is not ring.is_told
    assert any("cannot tell where the photos stand" in text for text in told) is not ring.is_told
    assert any("photograph between" in text for text in told) is ring.is_told
    assert bool(verdict.gaps) is ring.is_told


@pytest.mark.parametrize("n", [3, 8, 16])
def test_a_chain_of_photos_each_held_by_one_overlap_is_not_told(n):
    true = np.arange(0, 10.0 * n, 10.0)
    found = turns(cameras(true), [(i, i + 1) for i in range(n - 1)], np.random.default_rng(0))
    assert not find_ring(n, found).is_told


def test_photos_that_hang_on_no_others_are_a_group_of_their_own():
    rng = np.random.default_rng(0)
    true = np.array([0.0, 10, 20, 30, 40, 200, 210])
    ring = find_ring(8, turns(cameras(true), neighbours(true), rng))
    assert ring.group[:5].tolist() == [0] * 5 and ring.group[5] == ring.group[6] > 0
    assert np.isfinite(ring.azimuth_deg[:5]).all() and np.isnan(ring.azimuth_deg[5:]).all()


def test_a_walk_of_blurred_photos_alone_is_no_go(monkeypatch):
    monkeypatch.setattr("cherrypicker.capture.verdict.find_overlaps", lambda *_: [])
    looks = [Look(Path(f"{i:02d}.jpg"), blur=0.6) for i in range(20)]
    assert any(each.is_stop and "blurred" in each.text for each in judge(looks, (), 1).findings)


def test_blur_hardly_depends_on_the_scene():
    rng = np.random.default_rng(0)
    for cells in (60, 150):
        small = (255 * rng.random((cells, cells))).astype(np.uint8)
        sharp = cv2.resize(small, (600, 600), interpolation=cv2.INTER_NEAREST)
        sharp = cv2.GaussianBlur(sharp, None, 0.7)
        values = []
        for reach in (1, 5, 9):
            motion = np.full((1, reach), 1.0 / reach, np.float32)
            values.append(blur_of(cv2.filter2D(sharp, -1, motion)))
        assert values == sorted(values) and values[2] - values[0] > 0.12


def bark(rng, n_dots=500):
    """Dots on an upright cylinder 1.6 m wide: places, grey values and sizes."""
    angle, height = rng.uniform(0, 2 * np.pi, n_dots), rng.uniform(-0.2, 2.2, n_dots)
    places = np.column_stack([0.8 * np.cos(angle), 0.8 * np.sin(angle), height])
    return places, rng.integers(0, 255, n_dots), rng.uniform(0.015, 0.06, n_dots)


def rendered(pose, places, greys, sizes):
    """What of the dots a camera sees."""
    rotation, place = pose
    facing = ((place - places)[:, :2] * places[:, :2]).sum(axis=1) > 0.2
    picture = np.full((SIZE, SIZE), 120, np.uint8)
    seen = (places - place) @ rotation.T
    pixels = FOCAL * SIZE * seen[:, :2] / seen[:, 2:] + SIZE / 2
    radii = FOCAL * SIZE * sizes / seen[:, 2]
    for row in np.flatnonzero(facing):
        center = tuple((16 * pixels[row]).astype(int).tolist())
        cv2.circle(picture, center, int(16 * radii[row]), int(greys[row]), -1, cv2.LINE_AA, 4)
    return picture


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    """A work folder with three walks: whole, half of one side left out, and spoilt."""
    folder = tmp_path_factory.mktemp("walks")
    rng = np.random.default_rng(1)
    dots, azimuths = bark(rng), np.arange(0, 360, 15)
    marker = np.full((60, 60), 255, np.uint8)
    marker[9:51, 9:51] = cv2.aruco.generateImageMarker(marker_dictionary(DICTIONARY), 7, 42)
    for number, pose in enumerate(cameras(azimuths)):
        picture = rendered(pose, *dots)
        if number in (2, 3, 4):
            picture[-60:, :60] = marker
        name = f"IMG_{number:02d}.png"
        for tree in ("whole", "thin", "spoilt"):
            (folder / tree).mkdir(exist_ok=True)
            if tree == "thin" and number in (13, 15, 17):
                continue
            if tree == "spoilt" and number == 5:
                picture = cv2.blur(picture, (11, 11))
            if tree == "spoilt" and number == 6:
                picture = (picture * 0.4).astype(np.uint8)
            if tree == "spoilt" and number in (2, 3):
                picture[-60:, :60] = 120
            Image.fromarray(picture).convert("RGB").save(folder / tree / name)
    (folder / "spoilt/IMG_07.png").write_bytes(b"no photo")
    (folder / "config").mkdir()
    rows = ["tree\tphotos\tmarker_dictionary\tmarker_sides_m"]
    rows += [f"{tree}\t{tree}\t{DICTIONARY}\t7:0.2" for tree in ("whole", "thin", "spoilt")]
    rows += ["unscaled\twhole\t\t", "empty\tnone\t" + DICTIONARY + "\t7:0.2"]
    (folder / "config/trees.tsv").write_text("\n".join(rows) + "\n")
    return folder


def test_check_tells_what_to_photograph_again(walk, monkeypatch, capsys):
    monkeypatch.chdir(walk)
    assert main(["check", "--cores", "1"]) == 1
    told, tree = {}, ""
    for line in capsys.readouterr().out.splitlines():
        tree = tree if line.startswith(" ") else line.partition(":")[0]
        told.setdefault(tree, []).append(line)
    assert told["whole"][0].startswith("whole: go, 24 photos")
    assert not any("marker" in line for line in told["whole"])
    thin = "\n".join(told["thin"])
    assert "photograph again" in thin and "IMG_12.png and IMG_14.png" in thin
    assert "IMG_14.png and IMG_16.png" in thin and "IMG_16.png and IMG_18.png" in thin
    spoilt = "\n".join(told["spoilt"])
    assert "- IMG_07.png: cannot be read" in spoilt and "- marker 7 in 1 photos" in spoilt
    assert "blurred: IMG_05.png; they count as missing" in spoilt
    assert "exposed otherwise than the rest, lock the exposure: IMG_06.png" in spoilt
    assert "between IMG_04.png and IMG_06.png" in spoilt or "IMG_04.png and IMG_08.png" in spoilt
    assert "scale" in told["unscaled"][1] and "cannot run" in told["empty"][0]
    for tree in ("whole", "thin", "spoilt"):
        with Image.open(walk / f"check/{tree}.jpg") as sheet:
            assert sheet.width > 1000 and sheet.height > 1000


def test_check_looks_at_what_the_run_would_read(tmp_path, monkeypatch, capsys):
    """HEIC photos, frames of a film and masks: prepared beside the sheet, and gone afterwards."""
    heif = pytest.importorskip("pillow_heif")
    heif.register_heif_opener()
    dots = bark(np.random.default_rng(1))
    writer = cv2.VideoWriter(
        str(tmp_path / "walk.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 10, (SIZE, SIZE)
    )
    (tmp_path / "heic").mkdir()
    for number, pose in enumerate(cameras(np.arange(0, 60, 3))):
        picture = cv2.cvtColor(rendered(pose, *dots), cv2.COLOR_GRAY2BGR)
        writer.write(picture)
        if number % 5 == 0:
            Image.fromarray(picture).save(tmp_path / f"heic/{number}.heic", quality=90)
    writer.release()
    (tmp_path / "film").mkdir()
    (tmp_path / "walk.avi").rename(tmp_path / "film/walk.avi")
    (tmp_path / "own").mkdir()
    Image.new("L", (SIZE, SIZE - 1), 255).save(tmp_path / "own/0.png")
    (tmp_path / "config").mkdir()
    rows = ["tree\tphotos\tscale\tmasks", "film\tfilm\tnone\t", "heic\theic\tnone\t"]
    (tmp_path / "config/trees.tsv").write_text("\n".join([*rows, "masked\theic\tnone\town"]) + "\n")
    monkeypatch.chdir(tmp_path)
    assert main(["check", "--cores", "1"]) == 1
    told = capsys.readouterr().out
    film = re.search(r"film: .*, (\d+) photos", told)
    assert film and 5 <= int(film[1]) <= 20, told
    assert re.search(r"heic: .*, 4 photos", told)
    assert re.search(rf"masked: cannot run\n.*{SIZE} x {SIZE - 1} pixels.*masks in trees.tsv", told)
    assert sorted(path.name for path in (tmp_path / "check").iterdir()) == ["film.jpg", "heic.jpg"]


def test_markers_of_another_id_are_named(tmp_path):
    looks = [Look(tmp_path / f"{i}.jpg", digest=str(i), marker_ids=[8]) for i in range(4)]
    stops = [one.text for one in judge(looks, [7], 1).findings if one.is_stop]
    assert any("marker 7 in 0 photos; seen are 8" in text for text in stops)


def test_two_focal_lengths_and_copies_are_told(tmp_path):
    looks = [Look(tmp_path / f"{i}.jpg", digest="same", focal_mm=5 + i % 2) for i in range(4)]
    texts = " / ".join(one.text for one in judge(looks, [], 1).findings)
    assert "2 cameras, focal lengths or sizes" in texts and "copies of other photos: 1.jpg" in texts


def test_photos_are_looked_at_upright(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.new("RGB", (40, 30)).save(tmp_path / "turned.jpg", exif=exif)
    (look,) = look_at([tmp_path / "turned.jpg"], {}, 1)
    assert (look.width, look.height) == (40, 30) and look.thumbnail.shape == (40, 30, 3)
