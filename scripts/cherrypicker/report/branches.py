"""``branches.csv`` on the page: the table that can be sorted, and what is said of one branch."""

from __future__ import annotations

from collections.abc import Sequence

from cherrypicker.report.text import tell, tell_all
from cherrypicker.traits.table import BRANCH_COLUMNS, BranchColumn
from cherrypicker.units import unit_ending, unit_name, unit_word

_FLAGS = {
    "low_arc": "points on under half of its girth",
    "few_points": "few points at its base",
    "gap": "bridges gaps in the points",
}


def branch_table(rows: list, unit: str) -> dict:
    """The table of axes as `sortable_table` gives it, the longest first within an order."""
    columns = [column for column in BRANCH_COLUMNS.values() if rows and column.name in rows[0]]
    ordered = sorted(rows, key=lambda row: (row["order"], -row["length_m"]))
    return sortable_table(columns, ordered, unit)


def sortable_table(columns: Sequence[BranchColumn], rows: list, unit: str) -> dict:
    """A table whose rows are bound to axes of the view.

    Returns
    -------
    dict
        ``heads`` (``text``, ``kind`` and whether it ``is_more`` than a first look needs) and
        ``rows`` (``id`` and ``cells``, each the text shown and the value to sort by).
    """
    return {
        "heads": [
            {"text": column_head(column, unit), "kind": column.kind, "is_more": not column.title}
            for column in columns
        ],
        "rows": [
            {
                "id": row["branch_id"],
                "cells": [
                    (column_cell(column, row), _sorted_by(row[column.name])) for column in columns
                ],
            }
            for row in rows
        ],
    }


def limb_sums(columns: Sequence[BranchColumn], tree: dict, limbs: list, unit: str) -> dict:
    """A table of limbs by rank, each with all that it carries, and of the tree.

    Returns
    -------
    dict
        The limbs as of `sortable_table`, and ``tree``, the text of the tree's own cells, without
        rank and axis.
    """
    head = [BranchColumn("rank", "whole", "rank"), BranchColumn("branch_id", "whole", "axis")]
    table = sortable_table([*head, *columns], limbs, unit)
    return {**table, "tree": [column_cell(column, tree) for column in columns]}


def branch_facts(row: dict, unit: str) -> list[tuple[str, str]]:
    """What the view says of a branch: names and texts."""
    flags = [_FLAGS.get(flag, flag.replace("_", " ")) for flag in row.get("flags", "").split()]
    facts = {
        "order": "{order}",
        "parent": "none" if row["parent_id"] < 0 else "{parent_id}",
        "length": "{length_m:.3f} {m}",
        "diameter at the base": "{base_diameter_m:.4f} {m}"
        + tell(" ({base_diameter_low_m:.4f} to {base_diameter_high_m:.4f})", row),
        "at the tip": "{tip_diameter_m:.4f} {m}",
        "angle": "{insertion_angle_deg:.1f}°"
        + tell(" ({insertion_angle_low_deg:.1f} to {insertion_angle_high_deg:.1f})", row),
        "height of its base": "{base_height_m:.3f} {m}",
        "diameter by the photos": "{photo_diameter_m:.4f} {m}",
        "there, by the photos": "{percent:.0f} %",
        "light": "{sky_percent:.0f} % of the sky",
        "cut": "{cuts}",
        "rests on": "{base_n_points:,} points, {base_arc_deg:.0f}° of its girth",
        "flags": "{words}",
    }
    percent, sky_percent = (
        None if row.get(name) is None else 100 * row[name] for name in ("p_exists", "sky_share")
    )
    told = {"percent": percent, "sky_percent": sky_percent, "words": "; ".join(flags) or "none"}
    return tell_all(facts, row | told | {"m": unit_name(unit)})


def column_head(column: BranchColumn, unit: str) -> str:
    """The head of a column of ``branches.csv`` or ``limbs.csv``, with its unit."""
    end, word = unit_ending(column.name), unit_word(column.name, unit)
    if end == "_cm2" and unit != "m":
        word = f"1e-4 {word}"
    title = column.title or column.name.removesuffix(end).replace("_", " ")
    return f"{title} [{word}]" if end else title


def column_cell(column: BranchColumn, row: dict) -> str:
    """The text of a row's cell; a dash where there is no such number."""
    value = row[column.name]
    if column.kind == "text":
        return ", ".join(value.split()).replace("_", " ")
    if value is None or (column.name == "parent_id" and value < 0):
        return "–"
    if column.kind == "whole":
        return str(value)
    return f"{value:.{column.decimals if column.title else min(column.decimals_in_file, 6)}f}"


def _sorted_by(value: float | int | str | None) -> str:
    return "" if value is None else str(value)
