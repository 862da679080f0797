"""The page of a series: both skeletons of each step in one view, and the tables."""

from operator import itemgetter

import numpy as np

from cherrypicker.report.text import page_template
from cherrypicker.series.compare import Comparison, Step
from cherrypicker.series.tables import TABLES, is_shoot
from cherrypicker.series.wood import PIECE_M, STEP_M

#: What wood can be, from the bottom of the drawing up, and what it is called there.
STATES = {
    "kept": "there at both dates",
    "unseen": "not seen at the later date",
    "removed": "removed",
    "grown": "grown at its end",
    "shoot": "new shoot",
}
VIEWS = {"seen along y": 0, "seen along x": 1}  # and the coordinate that runs to the right
HEIGHT_PX, MARGIN_PX = 620, 22
LEAST_STROKE_PX = 1.1
PIECE = round(PIECE_M / STEP_M)  # of the samples, so many make a line of one width
BAR_M = 0.5


def series_page(
    series: str, comparison: Comparison, tables: dict[str, list[dict]], numbers: list[dict]
) -> str:
    """Render the page of a series, HTML that needs no network; all text from data is escaped.

    The tables are rows by the names of `tables.TABLES`, the numbers what is told of each step as of
    `tables.totals`, and what became of proposed cuts besides.
    """
    steps, trees = [], itemgetter("from_tree", "to_tree")
    for index, (step, told) in enumerate(zip(comparison.steps, numbers, strict=True)):
        rows = {
            name: [row for row in tables[name] if trees(row) == trees(told)]
            for name in ("cuts", "shoots", "growth")
        }
        views = _views(step, comparison.ids[index : index + 2], rows["cuts"])
        steps.append({"numbers": told, "views": views, **rows})
    page = page_template("series.html.j2").render(
        series=series,
        scans=[f"{scan.tree} ({scan.date})" for scan in comparison.scans],
        left_out=comparison.left_out,
        files=[*(f"{name}.csv" for name in (*TABLES, "bearing")), "series.json"],
        states=STATES,
        steps=steps,
    )
    return page + "\n"


def _views(step: Step, ids: list[np.ndarray], cuts: list[dict]) -> list[dict]:
    """Both skeletons seen from two sides, as paths of SVGs of one size and scale, wide as high."""
    points = np.concatenate([step.earlier.wood.points, step.later.wood.points])
    low, high = points.min(axis=0), points.max(axis=0)
    factor = (HEIGHT_PX - 2 * MARGIN_PX) / max(high[2] - low[2], 1e-6)
    width = max(factor * max(high[:2] - low[:2]) + 2 * MARGIN_PX, HEIGHT_PX)
    middle = 0.5 * (low + high)
    lines = _lines(step, ids)
    at_cuts = np.array([[cut[name] for name in ("x_m", "y_m", "z_m")] for cut in cuts])

    def place(at: np.ndarray, side: int) -> np.ndarray:
        x = 0.5 * width + factor * (at[:, side] - middle[side])
        return np.column_stack([x, HEIGHT_PX - MARGIN_PX - factor * (at[:, 2] - low[2])])

    return [
        {
            "title": title,
            "width": round(width),
            "height": HEIGHT_PX,
            "bar": f"M16,{HEIGHT_PX - 12}h{factor * BAR_M:.1f}",
            "bar_length": f"{BAR_M:g} m",
            "paths": [
                {
                    "state": state,
                    "d": "M" + " ".join(f"{x:.1f},{y:.1f}" for x, y in place(line, side)),
                    "width": f"{max(2 * radius * factor, LEAST_STROKE_PX):.1f}",
                    "title": f"branch {lasting}, {STATES[state]}",
                }
                for state, line, radius, lasting in lines
            ],
            "cuts": list(zip(place(at_cuts.reshape(-1, 3), side), cuts, strict=True)),
        }
        for title, side in VIEWS.items()
    ]


def _lines(step: Step, ids: list[np.ndarray]) -> list[tuple[str, np.ndarray, float, int]]:
    """Short lines of one state along one axis, `STATES` in order.

    Each is its state, its points (n, 3), its mean radius and the lasting id of its axis.
    """
    # A sample without a state is not drawn: what is there at both dates is where it is later
    earlier = np.select([step.is_unseen, step.gone.piece >= 0], ["unseen", "removed"], "")
    kinds = ["shoot" if is_shoot(step, row) else "grown" for row in step.new.first]
    later = np.array([*kinds, "kept"])[step.new.piece]  # -1, the last, of no new piece
    woods, found = (step.earlier.wood, step.later.wood), []
    for wood, state, lasting in zip(woods, (earlier, later), ids, strict=True):
        is_first = (np.diff(wood.axis, prepend=-1) != 0) | np.append(False, state[1:] != state[:-1])
        starts = np.flatnonzero(is_first)
        for start, end in zip(starts, [*starts[1:], len(wood)], strict=True):
            for first in range(start, end, PIECE) if state[start] else ():
                last = min(first + PIECE, end) - 1
                rows = np.arange(first, last + 1)
                if wood.parent[first] >= 0:
                    rows = np.append(wood.parent[first], rows)
                radius = float(wood.radius[first : last + 1].mean())
                axis = int(lasting[wood.axis[start]])
                found.append((str(state[start]), wood.points[rows], radius, axis))
    return sorted(found, key=lambda each: list(STATES).index(each[0]))
