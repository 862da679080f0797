"""The known lengths that give a scale: columns of ``trees.tsv``, and ``scale.references``.

What a kind of reference needs, may have and how large it may be is in the config's schema; here is
what a schema cannot say. Light enough for the Snakefile to import: a tree whose lengths cannot work
is refused before any of its photos is touched, not by the stage that looks for the markers hours
later.
"""

import difflib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cherrypicker.errors import StageError
from cherrypicker.files import parse_yaml

KEY = "scale.references"
SIDES_COLUMN = "marker_sides_m in trees.tsv"
_PAIR = re.compile(r"([0-9]{1,4})\s*:\s*([0-9]+\.?[0-9]*|\.[0-9]+)")  # id:side
_SIDE_BOUNDS_M = (0.005, 2.0)  # of printed markers (guess)

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

KINDS = {
    "distance": (0.0, 0.0005),
    "charuco": (0.002, 0.0),
    "cube": (0.002, 0.0),
    "trunk": (0.0, 0.001),
    "gps": (0.0, 3.0),
}
"""Kinds of references by their name in the config, and how well a length is known unless said: a
share of it, and m (guesses: a ruler, a printer, a tape around bark; of a phone's position)."""


@dataclass(frozen=True)
class Reference:
    """An entry of ``scale.references``."""

    kind: str  # one of `KINDS`
    key: str  # to name in errors, ``scale.references.0``
    # Between two markers' centres, side of a board's square, edge of the cube, diameter of the
    # trunk, m; NaN for ``gps``
    length_m: float
    tolerance_m: float  # standard error of the length, or of a position of ``gps``, m
    values: Mapping[str, Any]  # every value of the entry

    @property
    def name(self) -> str:
        """What it is called in results and messages."""
        if self.kind == "distance":
            return "distance {} to {}".format(*self.values.get("markers", "??"))
        return f"{self.kind} ({self.key})"


def check_scale(
    cell: str, mode: str, dictionary: str, sides_m: str, entries: Sequence[Mapping | str] = ()
) -> tuple[dict[int, float], list[Reference]]:
    """Refuse columns and references that no photo can make good for.

    The cell of the column ``scale`` says ``marker``, ``none`` or metres per unit; where it is
    empty, the config's ``scale.mode``, ``marker`` or ``none``, decides. The columns
    ``marker_dictionary`` and ``marker_sides_m`` may be empty where the config's
    ``scale.references`` have an entry; one that is a string is read as YAML, for the command line.
    Returns the sides by marker id, m, and the references; both empty where the scale is given or
    not wanted.

    Raises
    ------
    StageError
        Naming the column or the config key to change.
    """
    if (cell.strip() or mode) != "marker":
        return {}, []
    references = [_parse(entry, f"{KEY}.{at}", dictionary) for at, entry in enumerate(entries)]
    if references and not sides_m:
        return {}, references
    columns = {"marker_dictionary": dictionary, "marker_sides_m": sides_m}
    missing = " and ".join(name for name, text in columns.items() if not text)
    if missing:
        raise StageError(
            f"the scale is to come from a marker, but {missing} {'are' if ' ' in missing else 'is'}"
            " empty; without a marker the column scale must be a number or 'none'",
            key=f"{missing}, or scale, in trees.tsv",
        )
    sides = parse_marker_sides(sides_m)
    check_ids(dictionary, sides)
    return sides, references


def _parse(entry: Mapping | str, key: str, dictionary: str) -> Reference:
    try:
        values: Any = parse_yaml(entry) if isinstance(entry, str) else dict(entry)
        kind, length = values["kind"], float(values.get("length_m", math.nan))
        share, least_m = KINDS[kind]
    except (ValueError, TypeError, LookupError, AttributeError) as error:
        raise StageError(f"{entry!r} is no reference ({error})", key=key) from error
    if kind in ("distance", "charuco"):
        dictionary = values.get("dictionary") or dictionary
        if not dictionary:
            raise StageError("neither it nor marker_dictionary names a dictionary", key=key)
        ids, keys = values.get("markers", ()), (f"{key}.markers", f"{key}.dictionary")
        values["dictionary"] = check_ids(dictionary, ids, *keys)
    if values.get("marker_m", 0.0) >= length:
        cause = "a board's markers (marker_m) are smaller than its squares (length_m)"
        raise StageError(cause, key=f"{key}.marker_m")
    tolerance = float(values.get("tolerance_m") or least_m or share * length)
    return Reference(kind, key, length, tolerance, values)


def parse_marker_sides(text: str) -> dict[int, float]:
    """Sides, m, by marker id of the column ``marker_sides_m``: ``7:0.20,8:0.15``.

    Raises
    ------
    StageError
        For an unreadable pair, a duplicate id, or a side that no printed marker has.
    """
    sides: dict[int, float] = {}
    low, high = _SIDE_BOUNDS_M
    for pair in map(str.strip, text.split(",")):
        found = _PAIR.fullmatch(pair)
        marker_id, side = (int(found[1]), float(found[2])) if found else (-1, 0.0)
        if not found:
            reason = f"{pair!r} is no pair id:side, such as 7:0.20"
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
    asked = dictionary.strip().upper()
    if asked not in names:
        near = names[difflib.get_close_matches(asked, names, n=1, cutoff=0.0)[0]]
        cause = f"OpenCV has no marker dictionary {dictionary!r}; did you mean {near!r}?"
        raise StageError(cause, key=dictionary_key)
    count = DICTIONARY_SIZES[names[asked]]
    for marker_id in ids:
        if marker_id >= count:
            cause = f"{names[asked]} has markers 0 to {count - 1}, not {marker_id}"
            raise StageError(cause, key=ids_key)
    return names[asked]
