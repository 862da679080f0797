"""What a batch of trees is sorted by to decide what to do: cuts, targets, light, bearing wood."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import NamedTuple

from cherrypicker.pruning.target import LIMIT_WORDS

# Names of the batch table's columns and whether the most comes first, by the words for an order
ORDERS = {
    "most over a target": ("over_target", True),
    "most cuts": ("n_cuts", True),
    "most shoots": ("shoots", True),
    "darkest": ("sky_share", False),
    "least sure by the photos": ("photo_precision", False),
}


class Decision(NamedTuple):
    """A column of the batch's table: its name, its title, and of a tree the number and its text."""

    name: str
    title: str
    number: float
    text: str


def decisions_of(found: Mapping[str, Mapping]) -> list[Decision]:
    """What is to be decided of a tree, by its ``pruning.json``, ``bearing.json``, ``light.json``.

    None of what no file tells, or tells in another form: no single file may keep the other trees
    from being listed.
    """
    told: list[Decision] = []
    with suppress(LookupError, TypeError, ValueError):
        number = found["pruning"]["n_cuts"]
        told.append(Decision("n_cuts", "Cuts", float(number), f"{number:d}"))
    with suppress(LookupError, TypeError, ValueError):
        # Of what is to be gone altogether the cuts tell; of none there is no maximum
        limits = [each for each in found["pruning"]["targets"] if each["limit"] > 0]
        most = max(limits, key=lambda each: each["before"] / each["limit"])
        share, words = most["before"] / most["limit"], LIMIT_WORDS[most["name"]]
        text = f"{words}: {most['before']:.2f}, at most {most['limit']:g}" if share > 1 else "none"
        told.append(Decision("over_target", "Most over a target", share, text))
    for name, title, file, form in (
        ("shoots", "One-year shoots", "bearing", "{:.0f}"),
        ("sky_share", "Share of the sky's light", "light", "{:.0%}"),
    ):
        with suppress(LookupError, TypeError, ValueError):
            number = float(found[file][name])
            told.append(Decision(name, title, number, form.format(number).replace("%", " %")))
    return told
