"""Photos are looked at before COLMAP sees them."""

from types import SimpleNamespace

import numpy as np
import pycolmap
import pytest
from PIL import Image

from cherrypicker.errors import StageError
from cherrypicker.photos import read_photo
from cherrypicker.sfm import diagnosis
from cherrypicker.sfm.photo_files import check_photos, group_by_camera


def save(path, seed=0, size=(40, 30), exif=None, **options):
    rng = np.random.default_rng(seed)
    image = Image.fromarray(rng.integers(0, 255, (size[1], size[0], 3), dtype=np.uint8))
    tags = Image.Exif()
    for tag, value in (exif or {}).items():
        if tag == "focal":
            tags.get_ifd(0x8769)[0x920A] = value
        else:
            tags[tag] = value
    image.save(path, exif=tags, **options)
    return path


@pytest.fixture
def folder(tmp_path):
    for i in range(4):
        save(tmp_path / f"{i}.jpg", seed=i)
    return tmp_path


def photos_in(folder):
    return sorted(folder.iterdir())


def test_no_photo_names_the_column():
    with pytest.raises(StageError, match="no photo") as caught:
        check_photos([], folder="orchard/one")
    assert "trees.tsv" in caught.value.key
    assert caught.value.file == "orchard/one"


@pytest.mark.parametrize("damage", ["truncated", "empty", "text"])
def test_unreadable_photo_is_an_error_naming_it(folder, damage):
    bad = folder / "2.jpg"
    content = bad.read_bytes()
    bad.write_bytes(
        {"truncated": content[: len(content) // 2], "empty": b"", "text": b"hi"}[damage]
    )
    with pytest.raises(StageError, match=r"2\.jpg") as caught:
        check_photos(photos_in(folder))
    assert "sfm.skip_unreadable" in caught.value.key
    infos = check_photos(photos_in(folder), skip_unreadable=True)
    assert [bool(info.problem) for info in infos] == [False, False, True, False]


def test_copies_are_left_out(folder):
    (folder / "9.jpg").write_bytes((folder / "1.jpg").read_bytes())
    infos = check_photos(photos_in(folder))
    assert infos[-1].problem == "a copy of 1.jpg"
    assert sum(map(len, group_by_camera(infos, "folder"))) == 4


def test_cameras_are_not_forced_into_one(tmp_path):
    exif = {0x0110: "A", "focal": 28.0}
    save(tmp_path / "a1.jpg", 1, exif=exif)
    save(tmp_path / "a2_turned.jpg", 2, exif={**exif, 0x0112: 6})
    save(tmp_path / "a3_zoomed.jpg", 3, exif={**exif, "focal": 50.0})
    save(tmp_path / "b.jpg", 4, exif={**exif, 0x0110: "B"})
    save(tmp_path / "c_portrait.jpg", 5, size=(30, 40), exif=exif)
    infos = check_photos(photos_in(tmp_path))
    groups = [[info.name for info in group] for group in group_by_camera(infos, "folder")]
    assert groups == [["a1.jpg", "a2_turned.jpg"], ["a3_zoomed.jpg"], ["b.jpg"], ["c_portrait.jpg"]]
    assert infos[1].orientation == 6
    assert len(group_by_camera(infos, "per_image")) == 5


def test_auto_shares_only_named_cameras(tmp_path):
    for i in range(2):
        save(tmp_path / f"named{i}.jpg", i, exif={0x0110: "A"})
        save(tmp_path / f"bare{i}.jpg", 5 + i)
    infos = check_photos(photos_in(tmp_path))
    assert len(group_by_camera(infos, "auto")) == 3
    assert len(group_by_camera(infos, "folder")) == 2


def test_read_photo_has_the_pixel_grid_of_colmap(tmp_path):
    photos = [
        save(tmp_path / "portrait.jpg", 0, exif={0x0112: 6}),
        save(tmp_path / "down.png", 1, exif={0x0112: 3}),
        save(tmp_path / "left.tif", 2, exif={0x0112: 8}),
        save(tmp_path / "png_inside.jpg", 3, format="PNG"),
    ]
    for name, mode in (("print.jpg", "CMYK"), ("grey.jpg", "L"), ("alpha.png", "RGBA")):
        with Image.open(photos[1]) as image:
            image.convert("RGB").convert(mode).save(tmp_path / name)
        photos.append(tmp_path / name)
    deep = (np.arange(1200, dtype=np.uint16) * 50).reshape(30, 40)
    Image.fromarray(deep).save(tmp_path / "deep.png")
    for path in [*photos, tmp_path / "deep.png"]:
        colmap = pycolmap.Bitmap.read(path, True).to_array()
        ours = read_photo(path)
        assert ours.shape == colmap.shape, path.name
        assert np.abs(ours.astype(int) - colmap).max() <= 1, path.name


@pytest.mark.data
def test_turned_phone_photos_keep_their_stored_grid(real_data):
    folder = real_data / "photos" / "monstree"
    infos = check_photos(photos_in(folder)[:6])
    assert {info.orientation for info in infos} >= {6}
    for info in infos:
        assert (info.width, info.height) == (1600, 1200)
        colmap = pycolmap.Bitmap.read(info.path, True).to_array()
        assert np.abs(read_photo(info.path).astype(int) - colmap).max() <= 1
    assert len(group_by_camera(infos, "folder")) == 1


def test_a_camera_known_worse_than_asked_is_doubtful(monkeypatch):
    names = ["a.jpg", "b.jpg"]
    photo = {"problem": "", "exif_orientation": 1, "n_features": 900}
    pair = {"a.jpg": {"b.jpg": 80}, "b.jpg": {"a.jpg": 80}}
    monkeypatch.setattr(diagnosis, "verified_inliers", lambda *_: pair)
    images = [SimpleNamespace(name=name, has_pose=True, num_points3D=50) for name in names]
    attempt = SimpleNamespace(
        database=None,
        model=SimpleNamespace(images=dict(enumerate(images))),
        other_models=[],
        errors={"a.jpg": 0.4, "b.jpg": 1.4},
        left_out={},
    )
    listing = {"photos": dict.fromkeys(names, photo)}
    report = diagnosis.diagnose_photos(attempt, listing, doubtful_px=1.0)
    assert report["a.jpg"]["doubt"] == ""
    assert report["b.jpg"]["doubt"].startswith("known within 1.4 px")
