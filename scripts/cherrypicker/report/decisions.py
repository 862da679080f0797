"""What a batch of trees is sorted by to decide what to do: cuts, targets, light, bearing wood."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from operator import itemgetter

from cherrypicker.pruning.table import TARGET_WORDS

__all__ = ["ORDERS", "Decision", "decisions_of"]

# Names of the batch table's columns and whether the most comes first, by the words for an order
ORDERS = {
    "most over a target": ("over_target", True),
    "most cuts": ("n_cuts", True),
    "most shoots": ("shoots", True),
    "darkest": ("sky_share", False),
    "least sure by the photos": ("photo_precision", False),
}


@dataclass(frozen=True)
class Decision:
    """A column of the batch's table: its name, its title, and of a tree the number and its text."""

    name: str
    title: str
    number: float
    text: str


def decisions_of(found: Mapping[str, Mapping]) -> list[Decision]:
    """What is to be decided of a tree.

    Parameters
    ----------
    found : mapping of str to mapping
        Content of ``pruning.json``, ``bearing.json`` and ``light.json`` by these names, as far as
        the tree has them.

    Returns
    -------
    list of Decision
        None of what no file tells, or tells in another form: no single file may keep the other
        trees from being listed.
    """
    told: list[Decision] = []
    for kind, columns_of in _COLUMNS_OF.items():
        with suppress(LookupError, TypeError, ValueError):
            told += columns_of(found[kind])
    return told


def _of_pruning(pruning: Mapping) -> list[Decision]:
    told = [Decision("n_cuts", "Cuts", float(pruning["n_cuts"]), f"{pruning['n_cuts']:d}")]
    over = [
        (each["before"] / each["limit"], TARGET_WORDS[each["name"]], each)
        for each in pruning["targets"]
        if each["limit"] > 0  # of what is to be gone altogether the cuts tell
    ]
    if over:
        share, words, target = max(over, key=itemgetter(0))
        text = f"{words}: {target['before']:.2f}, at most {target['limit']:g}"
        text = text if share > 1 else "none"
        told.append(Decision("over_target", "Most over a target", share, text))
    return told


def _of_bearing(bearing: Mapping) -> list[Decision]:
    shoots = float(bearing["shoots"])
    return [Decision("shoots", "One-year shoots", shoots, f"{shoots:.0f}")]


def _of_light(light: Mapping) -> list[Decision]:
    share = float(light["sky_share"])
    return [Decision("sky_share", "Share of the sky's light", share, f"{100 * share:.0f} %")]


_COLUMNS_OF = {"pruning": _of_pruning, "bearing": _of_bearing, "light": _of_light}
