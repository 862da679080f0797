"""Proposed cuts against what a later scan shows: made, missed, and more than was asked for."""

from collections.abc import Mapping, Sequence

import numpy as np

from cherrypicker.geometry.tree_walks import sum_from_root
from cherrypicker.series.compare import Step


def made_cuts(step: Step, rows: Sequence[Mapping]) -> dict:
    """Tell which of the cuts that were proposed on the earlier scan were made.

    `step` leads from the scan that the cuts were proposed on, `rows` of its ``pruning.csv``, to a
    later one. ``made_cuts`` and ``missed_cuts`` are numbers of rows; ``n_more_cuts`` and
    ``more_length_m`` pieces and wood that went without being proposed.
    """
    # Of the wood beyond a proposed cut that is gone where it was made, in whatever way; and of a
    # piece that is gone, of which no less was not asked for (a guess: most of it)
    share = 0.5
    wood, piece = step.earlier.wood, step.gone.piece
    asked = np.zeros(len(wood), dtype=bool)
    numbers: dict[bool, list[int]] = {True: [], False: []}
    for row in rows:
        own = (wood.axis == row["branch_id"]) & (wood.along > row["along_m"])
        beyond = sum_from_root(wood.parent, own.astype(np.float64)) > 0
        gone = wood.length[beyond & (piece >= 0)].sum()
        numbers[bool(gone > share * wood.length[beyond].sum())].append(row["cut"])
        asked |= beyond
    more = [wood.length[(piece == each) & ~asked].sum() for each in range(len(step.gone.first))]
    whole = [wood.length[piece == each].sum() for each in range(len(step.gone.first))]
    return {
        "made_cuts": numbers[True],
        "missed_cuts": numbers[False],
        "n_more_cuts": sum(a >= share * b for a, b in zip(more, whole, strict=True)),
        "more_length_m": float(sum(more)),
    }
