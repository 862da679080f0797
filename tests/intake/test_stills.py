"""Photos of every container become the same pixels, tags and cameras."""

import sys

import numpy as np
import pytest
from dng_file import write_dng
from PIL import Image

from cherrypicker.errors import StageError
from cherrypicker.intake.kinds import captures_in, list_captures, twins_in
from cherrypicker.intake.prepare import PrepareOptions, prepare_photos, size_of_capture
from cherrypicker.photos import exif_camera, exif_orientation, read_photo
from cherrypicker.sfm.photo_files import check_photos, group_by_camera

WIDTH, HEIGHT = 96, 64


def picture(seed=0):
    """A photo with a red corner at the top left of the sensor, smooth for the codecs' sake."""
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    image[:] = 60 + 10 * seed + np.linspace(0, 120, WIDTH, dtype=np.uint8)[None, :, None]
    image[: HEIGHT // 4, : WIDTH // 4] = (220, 30, 30)
    return image


def tags(orientation=1):
    exif = Image.Exif()
    exif[0x010F], exif[0x0110], exif[0x0112] = "Orchard", "Phone", orientation
    exif.get_ifd(0x8769)[0x920A] = 5.0
    exif.get_ifd(0x8769)[0xA405] = 26
    return exif


def save_heic(path, image, orientation=1):
    heif = pytest.importorskip("pillow_heif")
    heif.register_heif_opener()
    Image.fromarray(image).save(path, quality=95, exif=tags(orientation).tobytes())


def prepared(folder, **options):
    """Prepare a folder; return the listing and the folder of photos."""
    out = folder.with_name(f"{folder.name} out")
    listing = prepare_photos(
        captures_in(folder), out / "photos", out / "masks", PrepareOptions(**options)
    )
    return listing, out / "photos"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "photos").mkdir()
    return tmp_path / "photos"


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_a_heic_photo_keeps_the_grid_of_the_sensor_its_turn_and_its_lens(folder, orientation):
    save_heic(folder / "IMG_1.HEIC", picture(), orientation)
    listing, photos = prepared(folder)
    (name,) = listing["photos"]
    assert name == "IMG_1.jpg"
    pixels = read_photo(photos / name)
    assert np.abs(pixels.astype(int) - picture()).mean() < 6
    assert exif_orientation(photos / name) == orientation
    assert exif_camera(photos / name) == ("Orchard Phone", 5.0)
    assert size_of_capture(folder / "IMG_1.HEIC") == (WIDTH, HEIGHT, 0.0)


def test_turns_of_the_hand_make_no_other_camera_whatever_the_container(folder):
    for i, orientation in enumerate((1, 6, 3)):
        save_heic(folder / f"{i}.heic", picture(i), orientation)
    Image.fromarray(picture(3)).save(folder / "3.jpg", exif=tags(8), quality=95)
    listing, photos = prepared(folder)
    infos = check_photos(sorted(photos.iterdir()))
    assert len(group_by_camera(infos, "folder")) == 1
    assert [info.orientation for info in infos] == [1, 6, 3, 8]
    assert [entry["is_as_it_came"] for entry in listing["photos"].values()] == [False] * 3 + [True]


def test_a_raw_photo_is_developed_in_the_grid_of_the_sensor(folder):
    pytest.importorskip("rawpy")
    for i, orientation in enumerate((1, 6)):
        write_dng(folder / f"{i}.dng", picture(), orientation=orientation)
        assert size_of_capture(folder / f"{i}.dng") == (WIDTH, HEIGHT, 0.0)
    _, photos = prepared(folder)
    for i, orientation in enumerate((1, 6)):
        pixels = read_photo(photos / f"{i}.jpg").astype(int)
        assert pixels.shape == (HEIGHT, WIDTH, 3)
        assert pixels[6, 8, 0] > 150 and pixels[6, 8, 1] < 100
        assert abs(pixels[50, 80] - picture()[50, 80]).max() < 25
        assert exif_orientation(photos / f"{i}.jpg") == orientation
        assert exif_camera(photos / f"{i}.jpg") == ("Orchard Raw One", 35.0)


@pytest.mark.parametrize(
    ("name", "module", "package"),
    [("a.dng", "rawpy", "rawpy"), ("a.heic", "pillow_heif", "pillow-heif")],
)
def test_a_photo_whose_package_is_missing_says_which(folder, monkeypatch, name, module, package):
    monkeypatch.setitem(sys.modules, module, None)
    (folder / name).write_bytes(b"anything")
    with pytest.raises(StageError, match=f"pip install {package}") as caught:
        prepared(folder)
    assert caught.value.file.endswith(name)
    assert "photos in trees.tsv" in caught.value.key


@pytest.mark.parametrize("name", ["bad.heic", "bad.nef"])
@pytest.mark.parametrize("length", [0, 300])
def test_a_corrupt_photo_is_named_or_left_out(folder, name, length):
    save_heic(folder / "whole.heic", picture())
    content = (folder / "whole.heic").read_bytes()
    (folder / name).write_bytes(content[:length])
    with pytest.raises(StageError, match="cannot be read") as caught:
        prepared(folder)
    assert caught.value.file.endswith(name)
    listing, photos = prepared(folder, skip_unreadable=True)
    assert list(listing["photos"]) == ["whole.jpg"] == [path.name for path in photos.iterdir()]
    assert "cannot be read" in listing["left_out"][name]


def test_plain_photos_are_linked_and_too_large_ones_reduced_once(folder):
    Image.fromarray(picture()).save(folder / "small.jpg", exif=tags(6), quality=95)
    large = Image.fromarray(picture()).resize((4 * WIDTH, 4 * HEIGHT))
    large.save(folder / "large.jpg", exif=tags(6), quality=95)
    listing, photos = prepared(folder, max_size_px=2 * WIDTH)
    assert (photos / "small.jpg").read_bytes() == (folder / "small.jpg").read_bytes()
    assert read_photo(photos / "large.jpg").shape == (2 * HEIGHT, 2 * WIDTH, 3)
    assert exif_orientation(photos / "large.jpg") == 6
    assert exif_camera(photos / "large.jpg") == ("Orchard Phone", 5.0)
    entry = listing["photos"]["large.jpg"]
    assert (entry["source_width"], entry["width"]) == (4 * WIDTH, 2 * WIDTH)


def test_a_raw_beside_its_jpeg_and_a_live_photo_count_once(folder):
    for name in ("1.jpg", "1.dng", "2.heic", "2.mov", "3.mp4", "notes.txt", ".hidden.jpg"):
        (folder / name).write_bytes(b"anything")
    assert [path.name for path in captures_in(folder)] == ["1.jpg", "2.heic", "3.mp4"]
    assert twins_in(folder) == {"1.dng": "1.jpg", "2.mov": "2.heic"}


def test_two_raws_of_one_name_are_refused(folder):
    pytest.importorskip("rawpy")
    for name in ("1.dng", "1.nef"):
        write_dng(folder / name, picture())
    with pytest.raises(StageError, match=r"would both become 1\.jpg"):
        prepared(folder)


def test_a_folder_without_pictures_is_refused(folder):
    (folder / "notes.txt").write_text("none")
    with pytest.raises(StageError, match="no photo and no video"):
        list_captures(folder)
