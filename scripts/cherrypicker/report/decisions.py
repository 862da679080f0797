"""What a batch of trees is sorted by to decide what to do: cuts, targets, light, bearing wood."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

from cherrypicker.pruning.target import LIMIT_WORDS

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
    with suppress(LookupError, TypeError, ValueError):
        told += _of_pruning(found["pruning"])
    with suppress(LookupError, TypeError, ValueError):
        shoots = float(found["bearing"]["shoots"])
        told.append(Decision("shoots", "One-year shoots", shoots, f"{shoots:.0f}"))
    with suppress(LookupError, TypeError, ValueError):
        share = float(found["light"]["sky_share"])
        words = "Share of the sky's light"
        told.append(Decision("sky_share", words, share, f"{100 * share:.0f} %"))
    return told


def _of_pruning(pruning: Mapping) -> list[Decision]:
    told = [Decision("n_cuts", "Cuts", float(pruning["n_cuts"]), f"{pruning['n_cuts']:d}")]
    # Of what is to be gone altogether the cuts tell
    limits = [each for each in pruning["targets"] if each["limit"] > 0]
    if limits:
        most = max(limits, key=lambda each: each["before"] / each["limit"])
        share, words = most["before"] / most["limit"], LIMIT_WORDS[most["name"]]
        text = f"{words}: {most['before']:.2f}, at most {most['limit']:g}" if share > 1 else "none"
        told.append(Decision("over_target", "Most over a target", share, text))
    return told
