"""What a comparison says, as rows of tables and as numbers."""

import math
from collections.abc import Iterator

import numpy as np

from cherrypicker.files import csv_text
from cherrypicker.series.changes import Gone
from cherrypicker.series.compare import Comparison, Scan, Step
from cherrypicker.traits.intervals import base_shares, volume_ends
from cherrypicker.units import unit_ending

_DECIMALS = {"_m": 4, "_m3": 8, "_deg": 1}


def branch_table(comparison: Comparison) -> list[dict]:
    """A row an axis and scan: its lasting id beside the id that it has in its own tree."""
    rows = []
    known: set[int] = set()
    for scan, ids in zip(comparison.scans, comparison.ids, strict=True):
        for number, branch in enumerate(scan.branches):
            rows.append(
                {
                    "series_branch_id": int(ids[number]),
                    "tree": scan.tree,
                    "date": scan.date,
                    "branch_id": number,
                    "series_parent_id": _bearer(scan, ids, number),
                    "order": int(branch["order"]),
                    "seen_before": int(ids[number] in known),
                    **{name: branch[name] for name in _SIZES},
                }
            )
        known |= set(ids.tolist())
    return rows


def growth_table(comparison: Comparison) -> list[dict]:
    """A row for each axis that a step found again."""
    rows = []
    for step, ids in zip(comparison.steps, comparison.ids, strict=False):
        at_tip = _tip_growth(step)
        wood = step.earlier.wood
        cut = np.bincount(wood.axis, wood.length * (step.gone.piece >= 0))
        for before, after in sorted(step.match.axes.items()):
            was, now = step.earlier.branches[before], step.later.branches[after]
            (low_was, mid_was, high_was), (low, mid, high) = _base_ends(was), _base_ends(now)
            ends: tuple = (None, None)
            if None not in (low_was, high_was, low, high):  # the scans are independent
                ends = (
                    mid - mid_was - math.hypot(mid - low, high_was - mid_was),
                    mid - mid_was + math.hypot(high - mid, mid_was - low_was),
                )
            rows.append(
                {
                    "series_branch_id": int(ids[before]),
                    **_between(step),
                    "order": int(was["order"]),
                    "length_before_m": was["length_m"],
                    "length_after_m": now["length_m"],
                    "tip_growth_m": float(at_tip[after]),
                    "removed_m": float(cut[before]),
                    "base_diameter_before_m": was["base_diameter_m"],
                    "base_diameter_after_m": now["base_diameter_m"],
                    "base_diameter_growth_m": mid - mid_was,
                    "base_diameter_growth_low_m": ends[0],
                    "base_diameter_growth_high_m": ends[1],
                }
            )
    return rows


def shoot_table(comparison: Comparison) -> list[dict]:
    """A row for each new shoot: wood that hangs on an axis that was there."""
    rows = []
    for step, ids in zip(comparison.steps, comparison.ids[1:], strict=True):
        wood = step.later.wood
        for row, piece, about in _pieces(step, step.later, ids, step.new):
            if is_shoot(step, row):
                # with its foot, which lies in the wood that was there
                length = wood.length[piece].sum() + wood.along[row] - wood.length[row]
                sizes = {
                    "length_m": float(length),
                    "base_diameter_m": 2.0 * float(wood.radius[row]),
                }
                rows.append(about | sizes)
    return rows


def cut_table(comparison: Comparison) -> list[dict]:
    """A row for each cut: its place in the frame of the first scan, and what it took away."""
    rows = []
    for step, ids in zip(comparison.steps, comparison.ids, strict=False):
        wood = step.earlier.wood
        for row, piece, about in _pieces(step, step.earlier, ids, step.gone):
            rows.append(
                {
                    **about,
                    "left_m": float(wood.along[row] - wood.length[row]),
                    "diameter_m": 2.0 * float(wood.radius[row]),
                    "length_m": float(wood.length[piece].sum()),
                    "volume_m3": float(wood.volume[piece].sum()),
                    "n_branches": len(np.unique(wood.axis[piece])),
                    **_volume_ends("volume", step.earlier, piece),
                }
            )
    return rows


def totals(comparison: Comparison) -> dict:
    """The numbers of the series as a whole."""
    steps = []
    for step in comparison.steps:
        wood, other = step.earlier.wood, step.later.wood
        gone, new = step.gone.piece >= 0, step.new.piece >= 0
        steps.append(
            {
                **_between(step),
                "n_matched_branches": len(step.match.axes),
                "n_cuts": len(step.gone.first),
                "removed_length_m": float(wood.length[gone].sum()),
                "removed_volume_m3": float(wood.volume[gone].sum()),
                **_volume_ends("removed_volume", step.earlier, np.flatnonzero(gone)),
                "n_shoots": sum(is_shoot(step, row) for row in step.new.first),
                "new_length_m": float(other.length[new].sum()),
                "tip_growth_m": float(_tip_growth(step).sum()),
                "unseen_length_m": float(wood.length[step.is_unseen].sum()),
                "length_before_m": float(wood.length.sum()),
                "length_after_m": float(other.length.sum()),
                "tolerance_m": step.match.tolerance,
                "frame": step.fit.matrix.tolist(),
                "frame_source": step.fit.source,
                "frame_score": step.fit.score,
                "frame_runner_up": step.fit.runner_up,
                "scale_ratio": step.scale_ratio,
                "markers_moved_m": step.moved_markers,
                "warnings": step.warnings,
            }
        )
    return {
        "scans": [{"tree": scan.tree, "date": scan.date} for scan in comparison.scans],
        "steps": steps,
        "left_out": comparison.left_out,
    }


def as_csv(rows: list[dict], columns: tuple[str, ...]) -> str:
    """Rows as CSV with a header; metres to 0.1 mm."""
    cells = ({name: _cell(name, row[name]) for name in columns} for row in rows)
    return csv_text(cells, columns)


_STEP = ("from_tree", "to_tree", "from_date", "to_date")
_WHERE = ("on_series_branch_id", "x_m", "y_m", "z_m", "height_m", "azimuth_deg")
_SIZES = ("length_m", "base_diameter_m", "base_height_m")
BRANCH_COLUMNS = (
    *("series_branch_id", "tree", "date", "branch_id", "series_parent_id", "order"),
    *("seen_before", *_SIZES),
)
GROWTH_COLUMNS = (
    *("series_branch_id", *_STEP, "order", "length_before_m", "length_after_m", "tip_growth_m"),
    *("removed_m", "base_diameter_before_m", "base_diameter_after_m", "base_diameter_growth_m"),
    *("base_diameter_growth_low_m", "base_diameter_growth_high_m"),
)
SHOOT_COLUMNS = ("series_branch_id", *_STEP, *_WHERE, "length_m", "base_diameter_m")
CUT_COLUMNS = (
    *("series_branch_id", *_STEP, *_WHERE, "left_m", "diameter_m", "length_m"),
    *("volume_m3", "n_branches", "volume_low_m3", "volume_high_m3"),
)


def _between(step: Step) -> dict[str, str]:
    values = step.earlier.tree, step.later.tree, step.earlier.date, step.later.date
    return dict(zip(_STEP, values, strict=True))


def _bearer(scan: Scan, ids: np.ndarray, axis: int) -> int:
    """Lasting id of the axis that an axis hangs on, -1 for the trunk's."""
    parent = int(scan.branches[axis]["parent_id"])
    return int(ids[parent]) if parent >= 0 else -1


def _pieces(step: Step, scan: Scan, ids: np.ndarray, pieces: Gone) -> Iterator[tuple]:
    """Of each piece of a scan's wood its first sample, all of them, and what both tables tell.

    Heights are above the stem's foot of its own scan.
    """
    wood = scan.wood
    foot = wood.points[0, 2] - scan.branches[0]["base_height_m"]
    for piece, row in enumerate(pieces.first):
        x, y, z = wood.points[wood.parent[row]]
        azimuth = math.degrees(math.atan2(y - wood.points[0, 1], x - wood.points[0, 0])) % 360.0
        where = _bearer(scan, ids, wood.axis[row]), x, y, z, z - foot, azimuth
        about = {"series_branch_id": int(ids[wood.axis[row]]), **_between(step)}
        about |= dict(zip(_WHERE, where, strict=True))
        yield row, np.flatnonzero(pieces.piece == piece), about


def is_shoot(step: Step, row: int) -> bool:
    """Whether a new piece of wood is a shoot, not the end of an axis that went on."""
    return int(step.later.wood.axis[row]) not in step.match.axes.values()


def _tip_growth(step: Step) -> np.ndarray:
    """New wood at the end of each later axis that was there, metres, (n_axes,)."""
    wood = step.later.wood
    is_new = step.new.piece >= 0
    grown = np.bincount(wood.axis, wood.length * is_new)
    grown[[axis not in step.match.axes.values() for axis in range(len(grown))]] = 0.0
    return grown


def _volume_ends(name: str, scan: Scan, rows: np.ndarray) -> dict[str, float | None]:
    """90 % interval of the volume of some samples of a scan's wood."""
    shares = base_shares(scan.branches)[scan.wood.axis[rows]]
    low, high = volume_ends(scan.wood.volume[rows], shares, scan.scale_error)
    return {f"{name}_low_m3": low, f"{name}_high_m3": high}


def _base_ends(branch: dict) -> tuple:
    """Diameter at the base of an axis, between the ends of its 90 % interval, None without one."""
    return tuple(branch[f"base_diameter_{end}m"] for end in ("low_", "", "high_"))


def _cell(name: str, value: object) -> object:
    return f"{value:.{_DECIMALS[unit_ending(name)]}f}" if isinstance(value, float) else value


#: Name of a table's file to what makes its rows, and its columns.
TABLES = {
    "branches": (branch_table, BRANCH_COLUMNS),
    "growth": (growth_table, GROWTH_COLUMNS),
    "shoots": (shoot_table, SHOOT_COLUMNS),
    "cuts": (cut_table, CUT_COLUMNS),
}
