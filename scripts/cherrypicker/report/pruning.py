"""The pruning's section of a tree's page: target, the cuts in order, and a picture with numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from cherrypicker.pruning.table import CUT_COLUMNS
from cherrypicker.pruning.target import LIMIT_WORDS, TURNS
from cherrypicker.report.figures import tree_grid
from cherrypicker.report.style import COLOR, FONT, GREY, LINE
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.traits.table import BranchColumn
from cherrypicker.units import unit_word


def pruning_section(pruning: dict | None, rows: list[dict] | None, unit: str) -> dict | None:
    """What the page shows of ``pruning.json`` and ``pruning.csv``; None where none was asked for.

    Returns
    -------
    dict
        ``cuts`` (the ``columns`` and ``rows`` of a table), ``targets`` (texts, whether
        each is reached, and the name and number of a limit that the page may change), ``preset``,
        ``source``, ``notes`` and ``keep``, the axes that no cut takes.
    """
    if pruning is None or rows is None:
        return None
    columns: list[BranchColumn] = [
        column
        for name, column in CUT_COLUMNS.items()
        if column.title and any(row.get(name) is not None for row in rows)
    ]
    return {
        "preset": pruning["preset"].replace("_", " "),
        "source": pruning["source"],
        "notes": pruning["notes"],
        "keep": pruning["keep"],
        "cuts": {"columns": columns, "rows": rows},
        "targets": [_told(each, unit) for each in pruning["targets"]],
    }


def cuts_by_axis(rows: Sequence[Mapping]) -> dict[int, str]:
    """What the view says of the cuts on each ``branch_id``: their numbers, kinds and reasons."""
    told: dict[int, list[str]] = {}
    for row in rows:
        words = ", ".join(row["reasons"].split()).replace("_", " ")
        told.setdefault(row["branch_id"], []).append(f"{row['cut']} ({row['kind']}: {words})")
    return {axis: "; ".join(each) for axis, each in told.items()}


def _told(target: dict, unit: str) -> dict:
    end = f" {unit_word(target['name'], unit)}" if target["name"].endswith("_m") else ""
    before, after = (f"{target[when]:.2f}".removesuffix(".00") for when in ("before", "after"))
    error = "" if target["after_se"] is None else f" ± {target['after_se']:.2f}"
    limit = f"{target['limit']:g}"
    return {
        # Of what goes by a limit the told one is of what may be left, not the config's
        "name": "" if target["name"] in TURNS[1] else target["name"],
        "number": limit,
        "words": LIMIT_WORDS[target["name"]],
        "limit": limit + end,
        "before": before + end,
        "after": after + error + end,
        "is_reached": target["is_reached"],
    }


def pruning_figure(skeleton: Skeleton, rows: list[dict], width_px: int) -> Figure:
    """The skeleton from two sides: what goes in red, each cut with its number."""
    gone = np.zeros(len(skeleton), dtype=bool)
    gone[[row["node"] for row in rows]] = True
    for node in range(1, len(skeleton)):
        gone[node] |= gone[skeleton.parent[node]]
    thick = LINE["least_wood"] + LINE["most_wood"] * skeleton.radius / skeleton.radius.max()
    figure, panels = tree_grid(skeleton, width_px, "Cuts by number")
    outline = [withStroke(linewidth=2.0, foreground="w")]
    for panel in panels:
        for some, color in ((~gone, str(GREY["wood"] / 2)), (gone, COLOR["fit"])):
            ends = np.flatnonzero(some[1:]) + 1
            start = skeleton.points[skeleton.parent[ends]]
            panel.lines(start, skeleton.points[ends], linewidths=thick[ends], colors=color)
        for row in rows:
            place = np.array([[row[name] for name in ("x_m", "y_m", "z_m")]])
            across, up = panel.view.flatten(place)[0]
            style: dict = {"fontsize": FONT["panel"], "ha": "center", "va": "center", "zorder": 3}
            panel.axes.text(
                across, up, str(row["cut"]), path_effects=outline, weight="bold", **style
            )
    return figure
