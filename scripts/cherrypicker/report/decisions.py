"""What a batch of trees is sorted by to decide what to do: cuts, targets, light, bearing wood."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

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
        None of what no file tells.
    """
    told = []
    if pruning := found.get("pruning"):
        told.append(Decision("n_cuts", "Cuts", pruning["n_cuts"], str(pruning["n_cuts"])))
        over = [
            (each["before"] / each["limit"], TARGET_WORDS[each["name"]], each)
            for each in pruning["targets"]
            if each["limit"] > 0  # of what is to be gone altogether the cuts tell
        ]
        if over:
            share, words, target = max(over, key=lambda one: one[0])
            text = f"{words}: {target['before']:.2f}, at most {target['limit']:g}"
            text = text if share > 1 else "none"
            told.append(Decision("over_target", "Most over a target", share, text))
    if bearing := found.get("bearing"):
        shoots = bearing["shoots"]
        told.append(Decision("shoots", "One-year shoots", shoots, f"{shoots:.0f}"))
    if light := found.get("light"):
        share = light["sky_share"]
        told.append(
            Decision("sky_share", "Share of the sky's light", share, f"{100 * share:.0f} %")
        )
    return told
