"""The columns of ``trees.tsv`` that say where a tree's scale comes from: parsing and checking.

Light enough for the Snakefile to import: a tree whose columns cannot work is refused before any of
its photos is touched, not by the stage that looks for the markers hours later.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

from cherrypicker.errors import StageError

SIDES_COLUMN = "marker_sides_m in trees.tsv"
_PAIR = re.compile(r"([0-9]{1,4})\s*:\s*([0-9]+\.?[0-9]*|\.[0-9]+)")  # id:side
_SIDE_BOUNDS_M = (0.005, 2.0)  # of printed markers (guess)
# Nobody photographs a fruit tree from nearer or further than this; a side in cm or mm would (guess)
_CAMERA_DISTANCE_M = (0.25, 80.0)

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
        ``marker``, ``none``, a number of metres per unit, or empty, as the table's schema has it.
    mode : {"marker", "none"}
        The config's ``scale.mode``.

    Returns
    -------
    mode : {"marker", "none", "number"}
    scale : float or None
        Metres per unit where a number is given.
    """
    text = str(cell or "").strip()
    if text in ("", "marker", "none"):
        return text or mode, None
    return "number", float(text)


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
    sides: dict[int, float] = {}
    low, high = _SIDE_BOUNDS_M
    for pair in text.split(","):
        found = _PAIR.fullmatch(pair.strip())
        marker_id, side = (int(found[1]), float(found[2])) if found else (-1, 0.0)
        if not found:
            reason = f"{pair.strip()!r} is no pair id:side, such as 7:0.20"
        elif marker_id in sides:
            reason = f"marker {marker_id} stands twice"
        elif not low <= side <= high:
            reason = (
                f"the side of marker {marker_id} is {side:g} m, outside {low:g} to {high:g} m; "
                "sides are given in metres"
            )
        else:
            sides[marker_id] = side
            continue
        raise StageError(f"marker_sides_m {text!r}: {reason}", key=SIDES_COLUMN)
    return sides


def check_ids(
    dictionary: str,
    ids: Iterable[int] = (),
    ids_key: str = SIDES_COLUMN,
    dictionary_key: str = "marker_dictionary in trees.tsv",
) -> str:
    """Return OpenCV's spelling of a dictionary's name, upper and lower case aside.

    Raises
    ------
    StageError
        If OpenCV has no such dictionary, or that has no marker of one of the ids.
    """
    names = {entry.upper(): entry for entry in DICTIONARY_SIZES}
    name = names.get(dictionary.strip().upper())
    if name is None:
        near = difflib.get_close_matches(dictionary.strip().upper(), names, n=1, cutoff=0.0)
        raise StageError(
            f"OpenCV has no marker dictionary {dictionary!r}; did you mean {names[near[0]]!r}?",
            key=dictionary_key,
        )
    count = DICTIONARY_SIZES[name]
    for marker_id in ids:
        if marker_id >= count:
            raise StageError(f"{name} has markers 0 to {count - 1}, not {marker_id}", key=ids_key)
    return name


def check_distance(distance_m: float, what: str, key: str) -> None:
    """Refuse a scale under which the cameras stood impossibly near to something, or far from it.

    Raises
    ------
    StageError
    """
    low, high = _CAMERA_DISTANCE_M
    if not low <= distance_m <= high:
        raise StageError(
            f"the cameras stand {distance_m:.3g} m from the {what}, outside what a tree is "
            "photographed from; are the lengths in metres?",
            key=key,
        )
