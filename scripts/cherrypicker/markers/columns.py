"""The columns of ``trees.tsv`` that say where a tree's scale comes from: parsing and checking.

Light enough for the Snakefile to import: a tree whose columns cannot work is refused before any of
its photos is touched, not by the stage that looks for the markers hours later.
"""

from __future__ import annotations

import difflib
import math
from typing import NoReturn

from cherrypicker.errors import StageError

MODES = ("marker", "none")
SIDES_COLUMN = "marker_sides_m in trees.tsv"
_SIDE_BOUNDS_M = (0.005, 2.0)  # of printed markers (guess)
_MOST_DIGITS = 4  # of a marker's id: the largest dictionary has 2320
# Nobody photographs a fruit tree from nearer or further than this; a side in cm or mm would (guess)
CAMERA_DISTANCE_M = (0.25, 80.0)

DICTIONARY_SIZES = {
    **{f"DICT_{n}X{n}_{size}": size for n in (4, 5, 6, 7) for size in (50, 100, 250, 1000)},
    "DICT_APRILTAG_16h5": 30,
    "DICT_APRILTAG_25h9": 35,
    "DICT_APRILTAG_36h10": 2320,
    "DICT_APRILTAG_36h11": 587,
    "DICT_ARUCO_MIP_36h12": 250,
    "DICT_ARUCO_ORIGINAL": 1024,
}
"""OpenCV's marker dictionaries and how many markers each has."""


def choose_mode(cell: str, mode: str) -> tuple[str, float | None]:
    """What decides the scale: the tree's cell in the column ``scale``, else the config.

    Parameters
    ----------
    cell : str
        ``marker``, ``none``, a number of metres per unit, or empty.
    mode : str
        The config's ``scale.mode``.

    Returns
    -------
    mode : {"marker", "none", "number"}
    scale : float or None
        Metres per unit where a number is given.

    Raises
    ------
    StageError
    """
    text = str(cell or "").strip()
    if text in MODES:
        return text, None
    if text:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and value > 0):
            raise StageError(
                f"{text!r} is neither 'marker', 'none' nor a positive number",
                key="scale in trees.tsv",
            )
        return "number", value
    if mode not in MODES:
        raise StageError(f"{mode!r} is neither 'marker' nor 'none'", key="scale.mode")
    return mode, None


def check_scale_columns(cell: str, mode: str, dictionary: str, sides_m: str) -> dict[int, float]:
    """Refuse columns that no photo can make good for.

    Parameters
    ----------
    cell, mode : str
        As for :func:`choose_mode`.
    dictionary, sides_m : str
        The columns ``marker_dictionary`` and ``marker_sides_m``.

    Returns
    -------
    dict of int to float
        Side by marker id, m; empty where the scale does not come from markers.

    Raises
    ------
    StageError
        Naming the column to change.
    """
    mode, _ = choose_mode(cell, mode)
    if mode != "marker":
        return {}
    columns = (("marker_dictionary", dictionary), ("marker_sides_m", sides_m))
    missing = [name for name, text in columns if not text]
    if missing:
        raise StageError(
            f"the scale is to come from a marker, but {' and '.join(missing)} "
            f"{'is' if len(missing) == 1 else 'are'} empty; without a marker the column scale must "
            "be a number or 'none'",
            key=f"{' and '.join(missing)}, or scale, in trees.tsv",
        )
    sides = parse_marker_sides(sides_m)
    name = dictionary_name(dictionary)
    count = DICTIONARY_SIZES[name]
    for marker_id in sides:
        if marker_id >= count:
            raise StageError(
                f"{name} has markers 0 to {count - 1}, not {marker_id}", key=SIDES_COLUMN
            )
    return sides


def parse_marker_sides(text: str) -> dict[int, float]:
    """Parse the column ``marker_sides_m``: ``7:0.20,8:0.15``.

    Parameters
    ----------
    text : str
        Comma-separated pairs of marker id and side length in metres.

    Raises
    ------
    StageError
        For an unreadable pair, a duplicate id, or a side that no printed marker has.
    """

    def refuse(reason: str) -> NoReturn:
        raise StageError(f"marker_sides_m {text!r}: {reason}", key=SIDES_COLUMN)

    sides = {}
    for pair in str(text).split(","):
        if not pair.strip():
            refuse("an entry is empty; write id:side pairs, for example 7:0.20,8:0.15")
        name, separator, length = pair.partition(":")
        if not separator:
            refuse(f"{pair.strip()!r} has no colon; write id:side, for example 7:0.20")
        if not name.strip().isdecimal() or len(name.strip()) > _MOST_DIGITS:
            refuse(f"{name.strip()!r} is no marker id")
        marker_id = int(name)
        try:
            side = float(length)
        except ValueError:
            refuse(f"{length.strip()!r} is no length")
        if marker_id in sides:
            refuse(f"marker {marker_id} stands twice")
        low, high = _SIDE_BOUNDS_M
        if not math.isfinite(side) or side <= 0:
            refuse(f"the side of marker {marker_id} must be positive")
        if not low <= side <= high:
            refuse(
                f"the side of marker {marker_id} is {side:g} m, outside {low:g} to {high:g} m; "
                "sides are given in metres"
            )
        sides[marker_id] = side
    return sides


def dictionary_name(name: str) -> str:
    """Return OpenCV's spelling of a dictionary's name, upper and lower case aside.

    Raises
    ------
    StageError
        If OpenCV has no such dictionary.
    """
    names = {entry.upper(): entry for entry in DICTIONARY_SIZES}
    key = str(name).strip().upper()
    if key not in names:
        near = difflib.get_close_matches(key, names, n=1, cutoff=0.0)
        raise StageError(
            f"OpenCV has no marker dictionary {name!r}; did you mean {names[near[0]]!r}?",
            key="marker_dictionary in trees.tsv",
        )
    return names[key]
