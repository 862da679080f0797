"""Which way was up when a photo was taken, by what the phone's accelerometer wrote into its header.

EXIF has no tag for it. Apple's phones write the acceleration into tag 8 of their maker note
(ExifTool's table of Apple tags, ``AccelerationVector``): in units of g, axes of the device in front
of the user, x to the right, y up, z towards the user; what lies still reads the way down. The
sensor's rows run along the device's y, so that a photo held upright bears EXIF orientation 6.
"""

import io
import math
import os

import numpy as np
from PIL import ExifTags, TiffImagePlugin

from cherrypicker.intake.stills import tags_of
from cherrypicker.photos import UNREADABLE

_APPLE = b"Apple iOS\0"
_HEADS = {b"MM": b"MM\0*\0\0\0\0", b"II": b"II*\0\0\0\0\0"}
_ORDER, _ACCELERATION = slice(12, 14), 8


def stated_up(path: str | os.PathLike) -> np.ndarray | None:
    """Return the way up that a photo of any kind states; None where it states none.

    It is a unit vector (3,) in the axes of the camera with the sensor's grid: x right, y down, z
    forward.
    """
    note = tags_of(path).get_ifd(ExifTags.IFD.Exif).get(ExifTags.Base.MakerNote)
    found = acceleration(note) if isinstance(note, bytes) else None
    if found is None or not any(found):
        return None
    x, y, z = found
    # The sensor's x runs down the device, its y to the device's left, the lens looks away from it
    return np.array([y, x, z]) / np.linalg.norm(found)


def acceleration(note: bytes) -> tuple[float, float, float] | None:
    """Return what Apple's maker note says of the acceleration, g; None where it does not."""
    head = _HEADS.get(note[_ORDER], b"") if note.startswith(_APPLE) else b""
    try:
        directory, stream = TiffImagePlugin.ImageFileDirectory_v2(head), io.BytesIO(note)
        stream.seek(_ORDER.stop)
        directory.load(stream)
        x, y, z = map(float, directory[_ACCELERATION])
    except UNREADABLE:  # among them what is no note of Apple's, or lacks the tag
        return None
    return (x, y, z) if all(map(math.isfinite, (x, y, z))) else None
