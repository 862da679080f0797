"""Where a photo says that it was taken, by the GPS tags of its EXIF header."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import NamedTuple

from PIL import ExifTags

from cherrypicker.intake.stills import tags_of


class Place(NamedTuple):
    """A place on WGS 84."""

    latitude: float  # degrees, north positive
    longitude: float  # degrees, east positive
    altitude: float  # m; NaN where the photo states none


def stated_place(path: str | os.PathLike) -> Place | None:
    """Return the place that a photo of any kind states; None where it states none.

    Latitude and longitude of exactly 0 are what some phones write before they have a fix.
    """
    tags = tags_of(path).get_ifd(ExifTags.IFD.GPSInfo)
    try:
        latitude = _degrees(tags[ExifTags.GPS.GPSLatitude], tags[ExifTags.GPS.GPSLatitudeRef])
        longitude = _degrees(tags[ExifTags.GPS.GPSLongitude], tags[ExifTags.GPS.GPSLongitudeRef])
        altitude = float(tags.get(ExifTags.GPS.GPSAltitude, math.nan))
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return None
    if not (math.isfinite(latitude) and math.isfinite(longitude)) or latitude == longitude == 0.0:
        return None
    is_below = tags.get(ExifTags.GPS.GPSAltitudeRef, b"\0") in (1, b"\1")
    return Place(latitude, longitude, -altitude if is_below else altitude)


def _degrees(parts: Sequence, side: str) -> float:
    """Degrees, minutes and seconds as degrees, south and west negative."""
    degrees = sum(float(part) / 60**power for power, part in enumerate(parts))
    return -degrees if str(side).strip("\0 ").upper() in ("S", "W") else degrees
