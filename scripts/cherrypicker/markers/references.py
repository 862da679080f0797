"""The known lengths that give a scale: the marker columns, and the config's ``scale.references``.

What a kind needs, may have and how large it may be is in the config's schema; here is what a schema
cannot say. Light enough for the Snakefile to import, as `cherrypicker.markers.columns` is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cherrypicker.errors import StageError
from cherrypicker.files import parse_yaml
from cherrypicker.markers.columns import check_ids, choose_mode, parse_marker_sides

KEY = "scale.references"

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
            return "distance {} to {}".format(*self.values.get("markers", "??"))
        return f"{self.kind} ({self.key})"


def check_scale(
    cell: str, mode: str, dictionary: str, sides_m: str, entries: Sequence[Mapping | str] = ()
) -> tuple[dict[int, float], list[Reference]]:
    """Refuse columns and references that no photo can make good for.

    Parameters
    ----------
    cell, mode : str
        As for :func:`cherrypicker.markers.columns.choose_mode`.
    dictionary, sides_m : str
        The columns ``marker_dictionary`` and ``marker_sides_m``.
    entries : sequence of mapping or str
        The config's ``scale.references``; with one or more, the marker columns may be empty. A
        string is read as YAML, for the command line.

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
