"""Which way was up when a photo was taken, by what the phone's accelerometer wrote into its header.

EXIF has no tag for it. Apple's phones write the acceleration into tag 8 of their maker note
(ExifTool's table of Apple tags, ``AccelerationVector``): in units of g, axes of the device in front
of the user, x to the right, y up, z towards the user; what lies still reads the way down. The
sensor's rows run along the device's y, so that a photo held upright bears EXIF orientation 6.
"""

from __future__ import annotations

import math
import os
import struct

import numpy as np
from PIL import ExifTags

from cherrypicker.intake.stills import tags_of

__all__ = ["acceleration", "stated_up"]

_APPLE = b"Apple iOS\0"
_ORDERS = {b"MM": ">", b"II": "<"}
_ORDER_AT, _COUNT_AT, _ENTRIES_AT, _ENTRY = 12, 14, 16, 12
_ACCELERATION, _SRATIONAL = 8, 10
# A phone that reads more or less than this was moved, g (guess; 23 photos of a walk read 0.92 to
# 1.07)
_STILL_G = (0.85, 1.15)


def stated_up(path: str | os.PathLike) -> np.ndarray | None:
    """Return the way up that a photo of any kind states; None where it states none.

    Returns
    -------
    ndarray of shape (3,) or None
        Unit vector in the axes of the camera with the sensor's grid: x right, y down, z forward.
    """
    note = tags_of(path).get_ifd(ExifTags.IFD.Exif).get(ExifTags.Base.MakerNote)
    found = acceleration(note) if isinstance(note, bytes) else None
    if found is None or not _STILL_G[0] <= np.linalg.norm(found) <= _STILL_G[1]:
        return None
    x, y, z = found
    # The sensor's x runs down the device, its y to the device's left, the lens looks away from it
    return np.array([y, x, z]) / np.linalg.norm(found)


def acceleration(note: bytes) -> tuple[float, float, float] | None:
    """Return what Apple's maker note says of the acceleration, g; None where it does not."""
    order = _ORDERS.get(note[_ORDER_AT:_COUNT_AT])
    if not note.startswith(_APPLE) or order is None:
        return None
    try:
        (n,) = struct.unpack_from(f"{order}H", note, _COUNT_AT)
        for i in range(n):
            entry = struct.unpack_from(f"{order}HHII", note, _ENTRIES_AT + _ENTRY * i)
            if entry[:3] == (_ACCELERATION, _SRATIONAL, 3):
                parts = struct.unpack_from(f"{order}6i", note, entry[3])
                x, y, z = (a / b for a, b in zip(parts[::2], parts[1::2], strict=True))
                return (x, y, z) if all(map(math.isfinite, (x, y, z))) else None
    except (struct.error, ZeroDivisionError):
        pass
    return None
