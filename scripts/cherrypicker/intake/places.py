"""Where a photo says that it was taken, by the GPS tags of its EXIF header."""

import math
import os
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
    tag = ExifTags.GPS
    latitude = _degrees(tags.get(tag.GPSLatitude), tags.get(tag.GPSLatitudeRef), "NS", 90.0)
    longitude = _degrees(tags.get(tag.GPSLongitude), tags.get(tag.GPSLongitudeRef), "EW", 180.0)
    if math.isnan(latitude) or math.isnan(longitude) or latitude == longitude == 0.0:
        return None
    altitude = _number(tags.get(tag.GPSAltitude))
    is_below = tags.get(tag.GPSAltitudeRef, b"\0") in (1, b"\1")
    return Place(latitude, longitude, -altitude if is_below else altitude)


def _degrees(given: object, side: object, sides: str, most: float) -> float:
    """Degrees, minutes and seconds as degrees, negative on the second side; NaN for another form.

    The form is EXIF's: up to three numbers, of which an editor of tags may write the first alone;
    and a letter, which may come as bytes, with zeros behind it or written out.
    """
    parts = given if isinstance(given, tuple | list) else (given,)
    numbers = [_number(part) for part in parts]
    text = side.decode("latin-1") if isinstance(side, bytes) else str(side or "")
    letter = text.strip("\0 ").upper()[:1]
    if not 1 <= len(numbers) <= 3 or letter not in (*sides,):
        return math.nan
    degrees = sum(number / 60**power for power, number in enumerate(numbers))
    if min(numbers) < 0.0 or not degrees <= most:
        return math.nan
    return -degrees if letter == sides[1] else degrees


def _number(value: object) -> float:
    """Return a number of a tag; NaN for what is none, text among it, or not finite."""
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ArithmeticError):
        return math.nan
    is_plain = math.isfinite(number) and not isinstance(value, str | bytes)
    return number if is_plain else math.nan
