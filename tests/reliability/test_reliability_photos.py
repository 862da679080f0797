"""Photos as people bring them: damaged, of all kinds and mixed; the poses stay right."""

import json

import cv2
import numpy as np
import pytest
from PIL import Image
from sfm_scene import FOCAL, HEIGHT, WIDTH, box_quads, centers_of, orbit, render, similarity_errors

from cherrypicker.errors import StageError
from cherrypicker.intake.kinds import list_captures
from cherrypicker.intake.prepare import PrepareOptions, prepare_photos
from cherrypicker.photos import list_photos
from cherrypicker.poses import read_poses
from cherrypicker.sfm.features import FeatureOptions, extract_features
from cherrypicker.sfm.mapping import MappingOptions
from cherrypicker.sfm.matching import MatchingOptions, match_features
from cherrypicker.sfm.photo_files import check_photos
from cherrypicker.sfm.sparse import reconstruct_sparse

SPAN_DEG = 120.0
RADIUS = 3.5  # of the orbit: errors are judged against it


def rendered(n_photos, **camera):
    """Photos of the box as RGB images, and their true poses."""
    quads = box_quads(np.random.default_rng(3))
    poses = orbit(n_photos, span_deg=SPAN_DEG)
    return [Image.fromarray(render(pose, quads, **camera)[..., ::-1]) for pose in poses], poses


def exif(focal_35mm=None, **tags):
    """EXIF data with a focal length on full frame."""
    data = Image.Exif()
    for tag, value in tags.items():
        data[{"model": 0x0110, "orientation": 0x0112}[tag]] = value
    if focal_35mm:
        data.get_ifd(0x8769)[0xA405] = int(round(focal_35mm))
        data.get_ifd(0x8769)[0x920A] = float(focal_35mm)
    return data


def reconstruct(folder, photos, **options):
    """Run the three steps on a folder's photos; return the report and the poses by name."""
    out = folder.with_name(f"{folder.name} out")
    extract_features(
        photos, out / "f.db", out / "l.json", options=FeatureOptions(max_features=800), threads=2
    )
    match_features(out / "f.db", out / "m.db", MatchingOptions(), threads=2)
    reconstruct_sparse(
        out / "m.db",
        photos,
        out / "l.json",
        out / "model",
        out / "report.json",
        out / "poses.npz",
        MappingOptions(**options),
        threads=2,
    )
    return json.loads((out / "report.json").read_text()), read_poses(out / "poses.npz")


def center_errors(poses, truth):
    """Distance of each camera from where it stood, after the best similarity."""
    wanted = np.array([centers_of(truth[str(name)][None])[0] for name in poses.names])
    return similarity_errors(poses.centers, wanted)


def test_all_kinds_of_photos_in_one_folder(tmp_path):
    """CMYK, 16 bit, a PNG named .jpg, TIFF, EXIF turns, portrait, a second camera, a copy."""
    folder = tmp_path / "photos"
    folder.mkdir()
    images, poses = rendered(12)
    wide, _ = rendered(12, width=400, height=300, focal=330.0)
    one, two = exif(model="One"), exif(model="Two")
    jpeg = {"quality": 97}
    truth = {}

    def save(i, name, image, **options):
        image.save(folder / name, **options)
        truth[name] = poses[i]

    save(0, "00.jpg", images[0], exif=one, **jpeg)
    save(1, "01 print.jpg", images[1].convert("CMYK"), exif=one, **jpeg)
    deep = np.asarray(images[2].convert("L")).astype(np.uint16) * 257
    save(2, "02 deep.png", Image.fromarray(deep))
    save(3, "03 is a png.jpg", images[3], format="PNG")
    save(4, "04.tif", images[4])
    save(5, "05 turned.jpg", images[5], exif=exif(model="One", orientation=6), **jpeg)
    save(6, "06 turned.jpg", images[6], exif=exif(model="One", orientation=3), **jpeg)
    save(7, "07 portrait.jpg", images[7].transpose(Image.Transpose.ROTATE_90), exif=one, **jpeg)
    save(8, "08 portrait.jpg", images[8].transpose(Image.Transpose.ROTATE_90), exif=one, **jpeg)
    for i in (9, 10, 11):
        save(i, f"{i:02d} wide.jpg", wide[i], exif=two, **jpeg)
    (folder / "99 copy.jpg").write_bytes((folder / "00.jpg").read_bytes())
    (folder / "notes.txt").write_text("no photo")

    report, found = reconstruct(folder, list_photos(folder))
    assert report["photos"]["99 copy.jpg"]["reason"].startswith("a copy of 00.jpg")
    assert len(found) == 12
    assert center_errors(found, truth).max() < 0.03 * RADIUS
    focal = dict(zip((str(name) for name in found.names), found.K[:, 0, 0]))
    assert focal["00.jpg"] == focal["05 turned.jpg"], "EXIF turns do not make another camera"
    assert focal["00.jpg"] == pytest.approx(FOCAL, rel=0.08)
    assert focal["10 wide.jpg"] == pytest.approx(330.0, rel=0.08)
    sizes = dict(zip((str(name) for name in found.names), zip(found.width, found.height)))
    assert sizes["07 portrait.jpg"][0] < sizes["07 portrait.jpg"][1]
    assert sizes["05 turned.jpg"][0] > sizes["05 turned.jpg"][1]


def test_a_video_and_photos_of_a_phone_in_one_folder(tmp_path):
    """A film of the walk, HEIC photos held both ways: all cameras where they stood."""
    heif = pytest.importorskip("pillow_heif")
    heif.register_heif_opener()
    folder, ready = tmp_path / "photos", tmp_path / "ready"
    folder.mkdir()
    images, poses = rendered(40)
    film = cv2.VideoWriter(
        str(folder / "walk.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 10, (WIDTH, HEIGHT)
    )
    for image in images:
        film.write(np.ascontiguousarray(np.asarray(image)[..., ::-1]))
    film.release()
    truth = {f"walk_{i:06d}.jpg": pose for i, pose in enumerate(poses)}
    for i in (0, 10, 20):
        tags = exif(model="Phone", orientation=(1, 6)[i % 20 // 10])
        images[i].save(folder / f"{i:02d}.HEIC", quality=95, exif=tags.tobytes())
        truth[f"{i:02d}.jpg"] = poses[i]
    options = PrepareOptions(video_step=0.15)
    made = prepare_photos(list_captures(folder), ready, tmp_path / "masks", options)
    n_frames = len(made["photos"]) - 3
    assert 5 <= n_frames <= 15
    _, found = reconstruct(ready, list_photos(ready))
    assert len(found) == n_frames + 3
    assert center_errors(found, truth).max() < 0.03 * RADIUS
    focal = dict(zip((str(name) for name in found.names), found.K[:, 0, 0]))
    assert focal["00.jpg"] == focal["10.jpg"], "a turn of the hand makes no other camera"
    assert all(value == pytest.approx(FOCAL, rel=0.08) for value in focal.values())


def test_ten_blurred_photos_among_good_ones(tmp_path):
    folder = tmp_path / "photos"
    folder.mkdir()
    images, poses = rendered(20)
    truth = {}
    for i, image in enumerate(images):
        name = f"{i:02d}{' blurred' * (i % 2)}.jpg"
        pixels = np.asarray(image)
        if i % 2:
            pixels = cv2.GaussianBlur(pixels, (0, 0), 9.0)
        Image.fromarray(pixels).save(folder / name, quality=97)
        truth[name] = poses[i]
    report, found = reconstruct(folder, list_photos(folder))
    assert {name for name in truth if "blurred" not in name} <= set(map(str, found.names))
    assert center_errors(found, truth).max() < 0.05 * RADIUS
    for name, facts in report["photos"].items():
        assert facts["registered"] or facts["reason"], f"{name} is missing without a reason"


@pytest.mark.parametrize("times", [4, 8])
def test_an_exif_focal_length_far_too_long(tmp_path, times):
    folder = tmp_path / "photos"
    folder.mkdir()
    images, poses = rendered(8)
    truth = {}
    wrong = exif(times * 35.0 * FOCAL / max(WIDTH, HEIGHT), model="Liar")
    for i, image in enumerate(images):
        image.save(folder / f"{i}.jpg", quality=97, exif=wrong)
        truth[f"{i}.jpg"] = poses[i]
    _, found = reconstruct(folder, list_photos(folder))
    assert len(found) == 8
    np.testing.assert_allclose(found.K[:, 0, 0], FOCAL, rtol=0.08)
    assert center_errors(found, truth).max() < 0.03 * RADIUS


def test_one_photo_is_not_enough_and_its_copies_do_not_help(tmp_path):
    image, _ = rendered(1)
    for name in ("a.jpg", "b.jpg", "c.jpg"):
        image[0].save(tmp_path / name)
    with pytest.raises(StageError, match="1 usable") as caught:
        check_photos(list_photos(tmp_path))
    assert "trees.tsv" in caught.value.key


@pytest.mark.parametrize("suffix", [".svg", ".gif", ".txt", ".jpg.part"])
def test_a_folder_without_a_readable_kind_of_photo(tmp_path, suffix):
    (tmp_path / f"IMG{suffix}").write_bytes(b"anything")
    with pytest.raises(StageError, match="holds no photo") as caught:
        list_captures(tmp_path)
    assert caught.value.file == str(tmp_path)
