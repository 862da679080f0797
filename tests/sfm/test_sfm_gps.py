"""GPS beside the cameras that were found: scale and fit, and when it is no check."""

import numpy as np
import pytest
from PIL import ExifTags, Image

from cherrypicker.intake import places
from cherrypicker.sfm.gps import compare_places, stated_places

SCALE = 2.5  # metres a unit
N = 40


def walk(noise_m, seed=0, n_places=N):
    """Cameras on a ring of 10 m, in a tilted frame, and what a receiver states of them."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(0, 2 * np.pi, N, endpoint=False)
    metres = 10.0 * np.column_stack([np.cos(angle), np.sin(angle), 0.02 * np.cos(3 * angle)])
    tilt = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    names = [f"{i}.jpg" for i in range(N)]
    centers = dict(zip(names, metres @ tilt / SCALE + rng.normal(size=3), strict=True))
    seen = metres[:, :2] + rng.normal(0, noise_m, (N, 2))
    seen = seen[np.arange(N) * n_places // N * N // n_places]
    degrees = seen * 360 / 40e6 / [np.cos(np.radians(48.0)), 1.0] + [11.0, 48.0]
    seen_at = [places.Place(latitude, longitude, np.nan) for longitude, latitude in degrees]
    return centers, dict(zip(names, seen_at, strict=True))


def test_a_good_receiver_tells_the_scale_within_its_error():
    for seed in range(5):
        told = compare_places(*walk(1.0, seed))
        assert told["is_consistent"]
        assert abs(told["metres_per_unit"] - SCALE) < 4 * told["metres_per_unit_std"] < 0.3
        assert told["residual_m"] == pytest.approx(1.4, rel=0.3)


def test_a_receiver_that_only_knows_the_field_is_no_check():
    assert not compare_places(*walk(60.0))["is_consistent"]


def test_one_fix_for_all_photos_is_none():
    assert compare_places(*walk(0.0, n_places=4)) is None
    assert compare_places(walk(0.0)[0], {}) is None


LATITUDE, LONGITUDE = (48.0, 30.0, 36.0), (9.0, 15.0, 0.0)


@pytest.mark.parametrize(
    ("tags", "place"),
    [
        (("N", LATITUDE, "E", LONGITUDE), (48.51, 9.25)),
        ((b"S\0", LATITUDE, b"W", LONGITUDE), (-48.51, -9.25)),
        (("South", LATITUDE, "east", LONGITUDE), (-48.51, 9.25)),
        (("N", 48.51, "E", (9.25,)), (48.51, 9.25)),
        (("N", "48,30.6N", "E", LONGITUDE), None),
        (("N", "485", "E", LONGITUDE), None),
        (("", LATITUDE, "E", LONGITUDE), None),
        (("E", LATITUDE, "N", LONGITUDE), None),
        (("N", (91.0, 0.0, 0.0), "E", LONGITUDE), None),
        (("N", (48.0, -30.0, 0.0), "E", LONGITUDE), None),
        (("N", (48.0, 30.0, 36.0, 1.0), "E", LONGITUDE), None),
        (("N", (float("nan"), 0.0, 0.0), "E", LONGITUDE), None),
        (("N", (), "E", LONGITUDE), None),
    ],
)
def test_odd_forms_of_a_place_are_read_or_none(monkeypatch, tags, place):
    exif = Image.Exif()
    exif.get_ifd(ExifTags.IFD.GPSInfo).update(enumerate(tags, start=1))
    exif.get_ifd(ExifTags.IFD.GPSInfo)[ExifTags.GPS.GPSAltitude] = "high"
    monkeypatch.setattr(places, "tags_of", lambda path: exif)
    told = places.stated_place("a.jpg")
    if place is None:
        assert told is None
    else:
        assert told[:2] == pytest.approx(place) and np.isnan(told.altitude)


def test_places_are_read_from_the_tags(tmp_path):
    exif = Image.Exif()
    gps = exif.get_ifd(ExifTags.IFD.GPSInfo)
    gps[ExifTags.GPS.GPSLatitudeRef], gps[ExifTags.GPS.GPSLatitude] = "S", (33.0, 30.0, 36.0)
    gps[ExifTags.GPS.GPSLongitudeRef], gps[ExifTags.GPS.GPSLongitude] = "E", (18.0, 15.0, 0.0)
    Image.new("RGB", (8, 8)).save(tmp_path / "a.jpg", exif=exif)
    Image.new("RGB", (8, 8)).save(tmp_path / "b.jpg")
    found = stated_places([tmp_path / "a.jpg", tmp_path / "b.jpg", tmp_path / "none.jpg"])
    assert found.keys() == {"a.jpg"}
    assert found["a.jpg"][:2] == pytest.approx((-33.51, 18.25))
