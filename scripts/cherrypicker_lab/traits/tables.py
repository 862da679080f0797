"""Table and figure of the benchmark of traits."""

import numpy as np
from matplotlib.figure import Figure

from cherrypicker.errors import StageError
from cherrypicker_lab.traits.table import JUDGED


def gather(reports):
    """Join the pairs of all trees by trait.

    Parameters
    ----------
    reports : iterable of dict
        From `cherrypicker_lab.traits.pairs.measure_tree`.

    Returns
    -------
    dict of str to dict of str to ndarray
        Trait to `true`, `found`, `low`, `high`; the latter two NaN where there is no interval.

    Raises
    ------
    StageError
        If there is no report.
    """
    reports = list(reports)
    if not reports:
        raise StageError("no tree was measured", key="benchmark.traits")
    joined = {}
    for name in JUDGED:
        pairs = [pair for report in reports for pair in report["traits"][name]]
        joined[name] = {
            key: np.array([pair[key] for pair in pairs], dtype=float)
            for key in ("true", "found", "low", "high")
        }
    return joined


def score_pairs(pairs):
    """Score one trait.

    Parameters
    ----------
    pairs : dict of str to ndarray of shape (n,), float64
        `true`, `found`, `low`, `high`.

    Returns
    -------
    dict
        `n`, `mae`, `bias` (found less true), `n_intervals`, `coverage` (share of the intervals
        that hold the truth, None without any), `width` (their median width, None without any).
    """
    error = pairs["found"] - pairs["true"]
    given = np.isfinite(pairs["low"]) & np.isfinite(pairs["high"])
    low, high, true = (pairs[key][given] for key in ("low", "high", "true"))
    return {
        "n": len(error),
        "mae": float(np.abs(error).mean()) if len(error) else None,
        "bias": float(error.mean()) if len(error) else None,
        "n_intervals": int(given.sum()),
        "coverage": float(((low <= true) & (true <= high)).mean()) if given.any() else None,
        "width": float(np.median(high - low)) if given.any() else None,
    }


def write_table(reports):
    """The benchmark's tables as Markdown, a row a trait: of thin trees, and of bearing ones."""
    reports = list(reports)
    if not reports:
        raise StageError("no tree was measured", key="benchmark.traits")
    sets = [[r for r in reports if r.get("bearing", False) is kind] for kind in (False, True)]
    return "\n".join(_table_of(each) for each in sets if each)


def _table_of(reports):
    joined = gather(reports)
    n_axes = sum(report["n_axes"] for report in reports)
    n_matched = sum(report["n_matched"] for report in reports)
    lines = [
        f"{_which(reports)}; {n_matched} of {n_axes} axes of 10 cm and more were found.",
        "",
        "| trait | unit | n | MAE | asked for | bias | 90 % intervals that hold the truth"
        " | median width |",
        "|---|---|---:|---:|---:|---:|---:|---:|",
    ]
    for name, trait in JUDGED.items():
        score = score_pairs(joined[name])
        if not score["n"]:
            lines.append(f"| {trait.words} | {trait.unit} | 0 | | | | no reference | |")
            continue
        covered = _covered(score)
        cells = [trait.words, trait.unit, str(score["n"]), _number(score["mae"], trait.factor)]
        cells += ["" if trait.bar is None else f"{trait.bar:g}"]
        cells += [_number(score["bias"], trait.factor, "+"), covered]
        lines.append("| " + " | ".join([*cells, _number(score["width"], trait.factor)]) + " |")
    return "\n".join([*lines, *_limbs(reports)]) + "\n"


def _limbs(reports):
    """Lines on the limbs of the trees; none where they were not judged."""
    judged = [report["limbs"] for report in reports if "limbs" in report]
    if not judged:
        return []
    n_true, n_found = (sum(each[name] for each in judged) for name in ("n_true", "n_found"))
    exact, near = (sum(each[name] for each in judged) for name in ("are_three", "are_three_to_2mm"))
    pairs = [pair for each in judged for pair in each["diameters"]]
    keys = ("true", "found", "low", "high")
    score = score_pairs({key: np.array([p[key] for p in pairs], dtype=float) for key in keys})
    return [
        "",
        f"{n_found} limbs were found, {n_true} are true, {len(pairs)} were matched: diameter's MAE "
        f"{_number(score['mae'], 1e3)} mm, bias {_number(score['bias'], 1e3, '+')} mm, "
        f"{_covered(score)} intervals hold it. The three thickest are the true three on {exact} of "
        f"{len(judged)} trees; on {near} no true limb is more than 2 mm thicker.",
    ]


def _covered(score):
    if score["coverage"] is None:
        return "none given"
    held = round(score["coverage"] * score["n_intervals"])
    return f"{held} of {score['n_intervals']} ({100 * score['coverage']:.0f} %)"


def _which(reports):
    """Of which trees a table is."""
    seeds = [report["seed"] for report in reports]
    mean = np.mean([report["n_points"] for report in reports])
    kind = "bearing trees" if reports[0].get("bearing") else "trees"
    return f"{len(seeds)} {kind}, seeds {min(seeds)} to {max(seeds)}, {mean:,.0f} points on average"


def _number(value, factor, sign=""):
    return "" if value is None else f"{value * factor:{sign}.2f}"


def traits_figure(reports):
    """Found against true values of every trait, with the intervals.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = Figure(figsize=(12, 6.2), layout="constrained")
    panels = figure.subplots(2, 4).flat
    for axis in panels[len(JUDGED) :]:
        axis.remove()
    for axis, (name, pairs) in zip(panels, gather(reports).items()):
        trait = JUDGED[name]
        factor, unit = trait.factor, trait.unit
        true, found = factor * pairs["true"], factor * pairs["found"]
        if np.isfinite(pairs["low"]).any():
            axis.vlines(true, factor * pairs["low"], factor * pairs["high"], "#9db8d6", lw=1)
        axis.plot(true, found, ".", ms=4, color="#1f4e8c")
        if len(true):
            ends = [min(true.min(), found.min()), max(true.max(), found.max())]
            axis.plot(ends, ends, color="0.6", lw=0.8, zorder=0)
        axis.set(title=trait.words, xlabel=f"true, {unit}", ylabel=f"found, {unit}")
    return figure
