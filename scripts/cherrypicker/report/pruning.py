"""The pruning's section of a tree's page: target, the cuts in order, and a picture with numbers."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from cherrypicker.geometry.tree_walks import sum_from_root
from cherrypicker.pruning.table import CUT_COLUMNS
from cherrypicker.pruning.target import LIMIT_WORDS, TURNS
from cherrypicker.report.figures import tree_grid
from cherrypicker.report.style import COLOR, FONT, GREY
from cherrypicker.skeleton.model import Skeleton


def pruning_section(pruning: dict | None, rows: list[dict] | None) -> dict | None:
    """What the page shows of ``pruning.json`` and ``pruning.csv``; None where none was asked for.

    That is ``told``, what ``pruning.json`` holds; ``cuts``, the ``columns`` and ``rows`` of a
    table; ``words`` of targets, and ``left``, those of them that tell what may be left, not the
    config's limit.
    """
    if pruning is None or rows is None:
        return None
    columns = [
        column
        for name, column in CUT_COLUMNS.items()
        if column.title and any(row.get(name) is not None for row in rows)
    ]
    return {
        "told": pruning,
        "cuts": {"columns": columns, "rows": rows},
        "words": LIMIT_WORDS,
        "left": TURNS[1],
    }


def cuts_by_axis(rows: Sequence[Mapping]) -> dict[int, str]:
    """What the view says of the cuts on each ``branch_id``: their numbers, kinds and reasons."""
    told: dict[int, list[str]] = {}
    for row in rows:
        words = ", ".join(row["reasons"].split()).replace("_", " ")
        told.setdefault(row["branch_id"], []).append(f"{row['cut']} ({row['kind']}: {words})")
    return {axis: "; ".join(each) for axis, each in told.items()}


def pruning_figure(skeleton: Skeleton, rows: list[dict], width_px: int) -> Figure:
    """The skeleton from two sides: what goes in red, each cut with its number."""
    is_cut = np.zeros(len(skeleton))
    is_cut[[row["node"] for row in rows]] = 1
    gone = sum_from_root(skeleton.parent, is_cut) > 0
    figure, panels = tree_grid(skeleton, width_px, "Cuts by number")
    outline = [withStroke(linewidth=2.0, foreground="w")]
    for panel in panels:
        for some, color in ((~gone, str(GREY["wood"] / 2)), (gone, COLOR["fit"])):
            panel.wood(skeleton, color, np.flatnonzero(some[1:]) + 1)
        for row in rows:
            place = np.array([[row[name] for name in ("x_m", "y_m", "z_m")]])
            across, up = panel.view.flatten(place)[0]
            style: dict = {"fontsize": FONT["panel"], "ha": "center", "va": "center", "zorder": 3}
            panel.axes.text(
                across, up, str(row["cut"]), path_effects=outline, weight="bold", **style
            )
    return figure
