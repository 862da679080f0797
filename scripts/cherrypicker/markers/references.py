"""Known lengths beside the marker columns: the config's list ``scale.references``, checked.

Light enough for the Snakefile to import, as `cherrypicker.markers.columns` is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

from cherrypicker.errors import StageError
from cherrypicker.files import is_number, parse_yaml
from cherrypicker.markers.columns import (
    DICTIONARY_SIZES,
    check_scale_columns,
    choose_mode,
    dictionary_name,
)

KEY = "scale.references"


@dataclass(frozen=True)
class Kind:
    """What a kind of reference needs to be told, and how well its length is known unless said."""

    needed: tuple[str, ...]
    allowed: tuple[str, ...] = ()
    # Standard error of `length_m`: a share of it, m (guesses: a ruler, a printer, a tape around
    # bark; of a phone's position)
    tolerance_share: float = 0.0
    tolerance_m: float = 0.0


KINDS = {
    "distance": Kind(("length_m", "markers"), ("dictionary",), tolerance_m=0.0005),
    "charuco": Kind(
        ("length_m", "marker_m", "squares"), ("dictionary", "legacy"), tolerance_share=0.002
    ),
    "cube": Kind(("length_m", "cells"), tolerance_share=0.002),
    "trunk": Kind(("length_m", "height_m"), tolerance_m=0.001),
    "gps": Kind((), tolerance_m=3.0),
}
"""Kinds of references by their name in the config."""

FEWEST_CELLS = 4  # of a cube's edge: OpenCV finds boards of three inner corners and more


@dataclass(frozen=True)
class Reference:
    """An entry of ``scale.references``.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    key : str
        The config key to name in errors, ``scale.references.0``.
    length_m : float
        Between two markers' centres, side of a board's square, edge of the cube, diameter of the
        trunk, m; NaN for ``gps``.
    tolerance_m : float
        Standard error of the length, or of a position of ``gps``, m.
    values : mapping
        Every value of the entry.
    """

    kind: str
    key: str
    length_m: float
    tolerance_m: float
    values: Mapping[str, Any]

    @property
    def name(self) -> str:
        """What it is called in results and messages."""
        if self.kind == "distance":
            return "distance {} to {}".format(*self.values["markers"])
        return f"{self.kind} ({self.key})"


def check_scale(
    cell: str, mode: str, dictionary: str, sides_m: str, entries: Sequence[Mapping | str] = ()
) -> tuple[dict[int, float], list[Reference]]:
    """Refuse columns and references that no photo can make good for.

    Parameters
    ----------
    cell, mode, dictionary, sides_m : str
        As for :func:`cherrypicker.markers.columns.check_scale_columns`.
    entries : sequence of mapping or str
        The config's ``scale.references``; with one or more, the marker columns may be empty.

    Returns
    -------
    sides : dict of int to float
        Side by marker id, m.
    references : list of Reference
        Both empty where the scale is given or not wanted.

    Raises
    ------
    StageError
        Naming the column or the config key to change.
    """
    if choose_mode(cell, mode)[0] != "marker":
        return {}, []
    references = parse_references(entries, dictionary)
    needs_columns = bool(sides_m) or not references
    sides = check_scale_columns(cell, mode, dictionary, sides_m) if needs_columns else {}
    return sides, references


def parse_references(entries: Sequence[Mapping | str], dictionary: str = "") -> list[Reference]:
    """Check the entries of ``scale.references``.

    Parameters
    ----------
    entries : sequence of mapping or str
        A string is read as YAML, for the command line.
    dictionary : str
        The column ``marker_dictionary``, for entries without one.

    Raises
    ------
    StageError
        For an unknown kind, a missing or foreign value, or one that cannot be.
    """
    return [_parse(entry, f"{KEY}.{at}", dictionary) for at, entry in enumerate(entries)]


def _parse(entry: object, key: str, dictionary: str) -> Reference:
    def refuse(reason: str, name: str = "") -> NoReturn:
        raise StageError(reason, key=f"{key}.{name}" if name else key)

    if isinstance(entry, str):
        try:
            entry = parse_yaml(entry)
        except ValueError as error:
            refuse(f"{entry!r} is no YAML ({error})")
    if not isinstance(entry, Mapping):
        refuse("a reference is a mapping such as {kind: distance, markers: [7, 8], length_m: 1.0}")
    values = {name: value for name, value in entry.items() if value is not None}
    kind = KINDS.get(str(values.get("kind")))
    if kind is None:
        refuse(f"{values.get('kind')!r} is no kind of reference: {', '.join(KINDS)}", "kind")
    known = {"kind", "tolerance_m", *kind.needed, *kind.allowed}
    for name in kind.needed:
        if name not in values:
            refuse(f"a reference of kind {values['kind']} needs {name}", name)
    for name in values:
        if name not in known:
            refuse(f"a reference of kind {values['kind']} has no {name}", name)
    for name in ("length_m", "marker_m", "height_m", "tolerance_m"):
        value = values.get(name, 1.0)
        if not (is_number(value) and value > 0):
            refuse(f"{value!r} is no length above 0 m", name)
    _check_counts(values, refuse)
    if values["kind"] in ("distance", "charuco"):
        values["dictionary"] = _dictionary(values.get("dictionary") or dictionary, key, refuse)
        size = DICTIONARY_SIZES[values["dictionary"]]
        for marker_id in values.get("markers", ()):
            if not 0 <= marker_id < size:
                refuse(f"{values['dictionary']} has markers 0 to {size - 1}, not {marker_id}")
    length = float(values.get("length_m", math.nan))
    tolerance = values.get("tolerance_m", kind.tolerance_m or kind.tolerance_share * length)
    return Reference(values["kind"], key, length, float(tolerance), values)


def _dictionary(name: str, key: str, refuse: Any) -> str:
    if not name:
        refuse("neither the reference nor marker_dictionary in trees.tsv names a dictionary")
    try:
        return dictionary_name(name)
    except StageError as error:
        raise StageError(error.cause, key=f"{key}.dictionary") from None


def _check_counts(values: Mapping, refuse: Any) -> None:
    """Refuse numbers of markers, squares and cells that no board has."""
    markers = values.get("markers", (0, 1))
    if not _are_whole(markers) or len(markers) != 2 or markers[0] == markers[1]:
        refuse(f"{markers!r} are not the ids of two markers", "markers")
    squares = values.get("squares", (3, 3))
    if not _are_whole(squares) or len(squares) != 2 or min(squares) < 3:
        refuse(f"{squares!r} is no number of squares across and down, 3 or more each", "squares")
    cells = values.get("cells", FEWEST_CELLS)
    if not _are_whole([cells]) or cells < FEWEST_CELLS:
        refuse(f"a cube with {cells!r} cells an edge cannot be found, {FEWEST_CELLS} are", "cells")
    if values["kind"] == "charuco" and not values["marker_m"] < values["length_m"]:
        refuse("a board's markers (marker_m) are smaller than its squares (length_m)", "marker_m")


def _are_whole(numbers: Any) -> bool:
    return isinstance(numbers, Sequence) and all(type(number) is int for number in numbers)
