"""How traits are told in tables, and the table of their benchmark."""

from typing import NamedTuple

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker_lab.tables import markdown_table


class Judged(NamedTuple):
    """How a trait is told in tables."""

    words: str
    unit: str
    factor: float  # from metres, degrees or shares to that unit


#: Trait to how it is told, in the order of the tables.
JUDGED = {
    "trunk_diameter_m": Judged("trunk diameter", "mm", 1e3),
    "base_diameter_m": Judged("branch diameter, 10 mm and more", "mm", 1e3),
    "height_m": Judged("height", "cm", 1e2),
    "insertion_angle_deg": Judged("insertion angle", "deg", 1.0),
    "crown_width_m": Judged("crown width", "cm", 1e2),
    "crown_volume_m3": Judged("crown volume", "dm3", 1e3),
    "total_length_m": Judged("total length", "m", 1.0),
    "n_shoots": Judged("shoots", "1", 1.0),
    "wood_volume_m3": Judged("volume of wood", "dm3", 1e3),
    "limb_trunk_ratio": Judged("limb-to-trunk ratio", "%", 1e2),
}


def score(cases):
    """Score the cases of one trait.

    Returns `n`, `mae`, `bias` (found less true), `n_intervals`, `n_held` (intervals that hold the
    truth), `width` (their median width). A number of no cases is NaN.
    """
    true, found, low, high = (
        np.array([case[key] for case in cases], dtype=float)
        for key in ("true", "found", "low", "high")
    )
    error, given = found - true, np.isfinite(low) & np.isfinite(high)
    return {
        "n": len(error),
        "mae": float(np.abs(error).mean()) if len(error) else np.nan,
        "bias": float(error.mean()) if len(error) else np.nan,
        "n_intervals": int(given.sum()),
        "n_held": int(((low <= true) & (true <= high)).sum()),
        "width": float(np.median((high - low)[given])) if given.any() else np.nan,
    }


def write_table(reports):
    """The benchmark's tables as Markdown, a row a trait: of thin trees, and of bearing ones.

    The reports are of `measure_grown`; a `StageError` is raised if there is none.
    """
    sets = {}
    for report in reports:
        sets.setdefault(report["source"], []).append(report)
    if not sets:
        raise StageError("no tree was measured", key="benchmark.traits")
    return "\n".join(_table_of(source, own) for source, own in sets.items())


def _table_of(source, reports):
    seeds = [report["seed"] for report in reports]
    lines = []
    for name, trait in JUDGED.items():
        of_it = score([c for report in reports for c in report["cases"] if c["trait"] == name])
        cells = [trait.words, trait.unit, str(of_it["n"]), _number(of_it["mae"], trait.factor)]
        cells += [_number(of_it["bias"], trait.factor, "+"), _held(of_it)]
        lines.append([*cells, _number(of_it["width"], trait.factor)])
    header = ["trait", "unit", "n", "MAE", "bias", "90 % intervals that hold the truth",
              "median width"]  # fmt: skip
    limbs = [report["limbs"] for report in reports]
    n_true, n_found, exact, near = (
        sum(each[name] for each in limbs)
        for name in ("n_true", "n_found", "are_three", "are_three_to_2mm")
    )
    of_it = score([pair for each in limbs for pair in each["diameters"]])
    return (
        f"{len(seeds)} {source} trees, seeds {min(seeds)} to {max(seeds)}.\n\n"
        f"{markdown_table(header, lines, 2)}\n"
        f"{n_found} limbs were found, {n_true} are true, {of_it['n']} were matched: diameter's MAE "
        f"{_number(of_it['mae'], 1e3)} mm, bias {_number(of_it['bias'], 1e3, '+')} mm, "
        f"{_held(of_it)} intervals hold it. The three thickest are the true three on {exact} of "
        f"{len(limbs)} trees; on {near} no true limb is more than 2 mm thicker.\n"
    )


def _held(of_it):
    if not of_it["n_intervals"]:
        return "none given"
    share = 100 * of_it["n_held"] / of_it["n_intervals"]
    return f"{of_it['n_held']} of {of_it['n_intervals']} ({share:.0f} %)"


def _number(value, factor, sign=""):
    return "" if np.isnan(value) else f"{value * factor:{sign}.2f}"
