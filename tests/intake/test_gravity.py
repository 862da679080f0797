"""Gravity as a phone's maker note states it."""

import struct

import numpy as np
import pytest
from PIL import ExifTags, Image

from cherrypicker.intake.gravity import acceleration, stated_up
from cherrypicker.intake.stills import read_still


def apple_note(values, order="MM", tag=8):
    """A maker note with one entry before the acceleration, as a phone writes it."""
    sign = {"MM": ">", "II": "<"}[order]
    parts = [number for value in values for number in (round(value * 10_000), 10_000)]
    entries = struct.pack(f"{sign}HHIi", 1, 9, 1, 12) + struct.pack(f"{sign}HHII", tag, 10, 3, 44)
    head = b"Apple iOS\0\0\1" + order.encode() + struct.pack(f"{sign}H", 2)
    return (head + entries).ljust(44, b"\0") + struct.pack(f"{sign}6i", *parts)


def photo(path, note=None):
    exif = Image.Exif()
    if note is not None:
        exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.MakerNote] = note
    Image.new("RGB", (40, 30), (90, 120, 60)).save(path, exif=exif)
    return path


@pytest.mark.parametrize("order", ["MM", "II"])
def test_both_byte_orders_are_read(order):
    assert acceleration(apple_note((-0.085, -0.958, -0.252), order)) == pytest.approx(
        (-0.085, -0.958, -0.252)
    )


def test_a_phone_held_upright_has_up_on_the_left_of_the_sensor(tmp_path):
    """As EXIF orientation 6 says; tilted down, up is also before the lens's back."""
    upright = stated_up(photo(tmp_path / "a.jpg", apple_note((0.0, -1.0, 0.0))))
    np.testing.assert_allclose(upright, [-1.0, 0.0, 0.0], atol=1e-9)
    level = stated_up(photo(tmp_path / "b.jpg", apple_note((-1.0, 0.0, 0.0))))
    np.testing.assert_allclose(level, [0.0, -1.0, 0.0], atol=1e-9)
    # The lens looks down: what is up lies behind it, and the screen's z reads the way down
    down = stated_up(photo(tmp_path / "c.jpg", apple_note((0.0, -0.6, -0.8))))
    np.testing.assert_allclose(down, [-0.6, 0.0, -0.8], atol=1e-9)


def test_what_is_no_gravity_is_none(tmp_path):
    whole = apple_note((0.0, -1.0, 0.0))
    zero = whole[:-4] + struct.pack(">i", 0)
    notes = [None, b"Canon", whole[:30], whole[:-5], zero, apple_note((0, -1, 0), tag=9)]
    notes += [apple_note((0.0, 0.0, 0.0))]
    for i, note in enumerate(notes):
        assert stated_up(photo(tmp_path / f"{i}.jpg", note)) is None
    (tmp_path / "broken.jpg").write_bytes(b"no photo")
    assert stated_up(tmp_path / "broken.jpg") is None


def test_a_photo_that_is_prepared_keeps_it(tmp_path):
    still = read_still(photo(tmp_path / "a.jpg", apple_note((0.0, -1.0, 0.0))))
    Image.fromarray(still.pixels).save(tmp_path / "prepared.jpg", exif=still.exif)
    np.testing.assert_allclose(stated_up(tmp_path / "prepared.jpg"), [-1.0, 0.0, 0.0], atol=1e-9)
