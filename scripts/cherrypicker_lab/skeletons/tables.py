"""The skeleton benchmark's results as tables of Markdown."""

from collections import defaultdict

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.files import read_json
from cherrypicker_lab.skeletons.graph_scores import THICK_M
from cherrypicker_lab.skeletons.methods import SETTINGS
from cherrypicker_lab.skeletons.timing import growth_exponent

METHOD_NAMES = {
    "lbc_paper": "LBC",
    "slbc_paper": "S-LBC",
    "bare_default": "limbs, all branch",
    "slbc_default": "limbs",
    "peer_lbc": "pc-skeletor LBC",
    "peer_slbc": "pc-skeletor S-LBC",
    "peer_pytlidar": "PyTLidar",
}
GRAPH_NAMES = {"mst": "spanning tree", "tree": "limbs", "own": "its own"}
PAPER_RATIO = {"noise": 25.349 / 37.555, "holes": 26.353 / 51.072}
SETTING_NAMES = {"noise": "noise", "holes": "noise and holes"}


def gather(paths):
    """Read the measurements of trees, of ours and of the peer.

    Parameters
    ----------
    paths : iterable of path-like

    Returns
    -------
    dict
        (setting, method) to a dict of tree name to its report; runs that failed are left out.

    Raises
    ------
    StageError
        If there is none.
    """
    table = defaultdict(dict)
    for path in paths:
        report = read_json(path)
        for setting, methods in report["settings"].items():
            for method, found in methods.items():
                if "failed" in found:
                    continue
                table[setting, method][report["tree"]] = found | {"template": report["template"]}
    if not table:
        raise StageError("nothing was measured", key="benchmark.skeleton")
    return dict(table)


def write_tables(table, times, *, notes=()):
    """All tables as Markdown.

    Parameters
    ----------
    table : dict
        From `gather`.
    times : list of dict
        From `cherrypicker_lab.skeletons.timing.time_stages`.
    notes : iterable of str
        Lines on what is left out.
    """
    parts = [_chamfer_table(table), _ratio_table(table), _template_table(table)]
    parts += [_point_table(table), _graph_table(table), _order_table(table), _time_table(times)]
    head = "".join(f"- {note}\n" for note in notes)
    return "\n".join(part for part in [head, *parts] if part)


def table_rows(header, rows, n_left):
    rule = ["---"] * n_left + ["---:"] * (len(header) - n_left)
    return "\n".join("| " + " | ".join(line) + " |" for line in [header, rule, *rows]) + "\n"


def _methods(table, setting):
    return [name for name in METHOD_NAMES if (setting, name) in table]


def _mean(found, read):
    return float(np.mean([read(report) for report in found.values()]))


def _chamfer(report):
    return report["points"]["chamfer_cm2"]


def _common(table, setting, methods):
    """Trees that all of these methods have run on."""
    return sorted(set.intersection(*(set(table[setting, name]) for name in methods)))


def _chamfer_table(table):
    """Mean Chamfer on all trees of a method, and on the trees that every method has run on."""
    lines = []
    for setting in SETTINGS:
        methods = _methods(table, setting)
        common = _common(table, setting, methods) if methods else []
        for name in methods:
            found = table[setting, name]
            on_common = {tree: found[tree] for tree in common}
            lines.append(
                [
                    SETTING_NAMES[setting],
                    METHOD_NAMES[name],
                    f"{len(found)}",
                    f"{_mean(found, _chamfer):.3f}",
                    f"{_mean(on_common, _chamfer):.3f}" if common else "–",
                    f"{_mean(found, lambda r: r['points']['to_truth_cm2']):.3f}",
                    f"{_mean(found, lambda r: r['points']['to_points_cm2']):.3f}",
                    f"{_mean(found, lambda r: r['cpu_s']):.1f}",
                ]
            )
    header = ["cloud", "contraction", "trees", "Chamfer, cm2", "on the trees of all methods",
              "points to truth", "truth to points", "CPU s a cloud"]  # fmt: skip
    return "### Chamfer distance\n\n" + table_rows(header, lines, 2)


def _ratio_table(table):
    """S-LBC over LBC beside the paper's ratio, each on its own common trees."""
    pairs = {
        "ours, as published": ("lbc_paper", "slbc_paper"),
        "pc-skeletor": ("peer_lbc", "peer_slbc"),
    }
    lines = [["the paper", *(f"{PAPER_RATIO[setting]:.3f}" for setting in SETTINGS), "50"]]
    for label, (plain, semantic) in pairs.items():
        cells, n_trees = [], 0
        for setting in SETTINGS:
            if (setting, plain) not in table or (setting, semantic) not in table:
                cells.append("–")
                continue
            trees = _common(table, setting, [plain, semantic])
            n_trees = len(trees)
            values = [
                np.mean([_chamfer(table[setting, name][tree]) for tree in trees])
                for name in (semantic, plain)
            ]
            cells.append(f"{values[0] / values[1]:.3f}")
        if n_trees:
            lines.append([label, *cells, f"{n_trees}"])
    header = ["S-LBC / LBC", *(SETTING_NAMES[setting] for setting in SETTINGS), "trees"]
    return "### Ratio of S-LBC to LBC\n\n" + table_rows(header, lines, 1)


def _template_table(table):
    lines = []
    for setting in SETTINGS:
        for name in _methods(table, setting):
            found = table[setting, name]
            templates = sorted({report["template"] for report in found.values()})
            cells = []
            for template in ("fir", "larch", "pine"):
                values = [_chamfer(r) for r in found.values() if r["template"] == template]
                cells.append(f"{np.mean(values):.3f}" if template in templates else "–")
            lines.append([SETTING_NAMES[setting], METHOD_NAMES[name], *cells])
    header = ["cloud", "contraction", "fir", "larch", "pine"]
    return "### Chamfer distance by template, cm2\n\n" + table_rows(header, lines, 2)


def _point_table(table):
    lines = []
    for setting in SETTINGS:
        for name in _methods(table, setting):
            found = table[setting, name]
            cells = []
            for tolerance in ("1cm", "2cm", "5cm"):
                rates = [report["points"]["samples"][tolerance] for report in found.values()]
                cells += [
                    f"{np.mean([rate[key] for rate in rates]):.3f}"
                    for key in ("precision", "recall", "f1")
                ]
            lines.append([SETTING_NAMES[setting], METHOD_NAMES[name], *cells])
    header = ["cloud", "contraction"]
    header += [f"{what} {size} cm" for size in (1, 2, 5) for what in ("P", "R", "F1")]
    return "### Contracted points against the true skeleton every millimetre\n\n" + table_rows(
        header, lines, 2
    )


def _with_graphs(table):
    """(setting, method, graph) of every graph that was measured, with its reports by tree."""
    for setting in SETTINGS:
        for name in _methods(table, setting):
            for graph in GRAPH_NAMES:
                found = {
                    tree: report["graphs"][graph]
                    for tree, report in table[setting, name].items()
                    if graph in report.get("graphs", {})
                }
                if found:
                    yield setting, name, graph, found


def _graph_table(table):
    lines = []
    for setting, name, graph, found in _with_graphs(table):
        lines.append(
            [
                SETTING_NAMES[setting],
                METHOD_NAMES[name],
                GRAPH_NAMES[graph],
                f"{len(found)}",
                f"{_mean(found, lambda r: r['junctions']['f1']):.3f}",
                f"{_mean(found, lambda r: r['tips']['f1']):.3f}",
                f"{_mean(found, lambda r: r['n_components']):.1f}",
                f"{_mean(found, lambda r: r['n_cycles']):.1f}",
                f"{_mean(found, lambda r: r['false_edges']['n']):.1f}",
                f"{_mean(found, lambda r: r['false_edges']['n_joins']):.1f}",
                f"{100 * _mean(found, lambda r: r['false_edges']['length_share']):.2f} %",
                f"{100 * _mean(found, lambda r: abs(r['length_error'])):.1f} %",
                f"{100 * _mean(found, lambda r: r['length_error']):+.1f} %",
                f"{100 * _mean(found, lambda r: r['ways_within_10pct']):.1f} %",
                f"{100 * _mean(found, lambda r: r['axes']['share_found']):.1f} %",
                f"{_mean(found, lambda r: r['samples']['2cm']['precision']):.3f}",
                f"{_mean(found, lambda r: r['samples']['2cm']['recall']):.3f}",
                *_radius_cells(found),
                f"{_mean(found, lambda r: r['cpu_s']):.1f}",
            ]
        )
    header = ["cloud", "contraction", "graph", "trees", "junction F1", "tip F1", "components",
              "cycles", "false edges", "false joins", "false length", "length error, absolute",
              "signed", "ways within 10 %", "axes found", "P 2 cm", "R 2 cm",
              *(f"radius off by, mm, {name.replace('_', ' ')}" for name in THICK_M),
              "CPU s"]  # fmt: skip
    return "### Graphs\n\n" + table_rows(header, lines, 3) if lines else ""


def _radius_cells(found):
    """Mean over trees of `radius_errors`, millimetres, by `THICK_M`."""
    errors = [report.get("radius", {}) for report in found.values()]
    for name in THICK_M:
        values = [error[name] for error in errors if name in error]
        yield f"{1e3 * np.mean(values):+.2f}" if values else "–"


def _order_table(table):
    lines = []
    for setting, name, graph, found in _with_graphs(table):
        orders = sorted({order for report in found.values() for order in report["by_order"]})
        for order in orders:
            parts = [r["by_order"][order] for r in found.values() if order in r["by_order"]]
            lines.append(
                [
                    SETTING_NAMES[setting],
                    METHOD_NAMES[name],
                    GRAPH_NAMES[graph],
                    order,
                    f"{np.mean([part['true_length_m'] for part in parts]):.1f}",
                    *(f"{np.mean([part['recall'][t] for part in parts]):.3f}"
                      for t in ("1cm", "2cm", "5cm")),
                    f"{100 * np.mean([part['axes']['share_found'] for part in parts]):.1f} %",
                    f"{np.mean([part['tip_recall'] for part in parts]):.3f}",
                ]
            )  # fmt: skip
    header = ["cloud", "contraction", "graph", "order", "true length, m", "R 1 cm", "R 2 cm",
              "R 5 cm", "axes found", "tip recall 5 cm"]  # fmt: skip
    return "### Graphs by order\n\n" + table_rows(header, lines, 4) if lines else ""


def _time_table(times):
    lines = []
    for t in sorted(times, key=lambda t: t["n_points"]):
        peer = t["peer"]
        whole = t["contract"] + t["graph"] + t["traits"]
        lines.append(
            [
                f"{t['n_points']:,}",
                f"{t['n_contracted']:,}",
                f"{t['contract']:.2f}",
                f"{t['graph']:.2f}",
                f"{t['traits']:.2f}",
                f"{whole:.1f}",
                f"{t['contract_peak_mb']:.0f}",
                f"{t['peak_mb']:.0f}",
                f"{t['chamfer_cm2']:.3f}",
                *(
                    [f"{peer['cpu_s']:.0f} ({peer['iterations']} iterations)",
                     f"{peer['peak_mb']:.0f}", f"{peer['chamfer_cm2']:.2f}",
                     f"1/{peer['cpu_s'] / t['contract']:.0f}"]
                    if peer
                    else ["–"] * 4
                ),
            ]
        )  # fmt: skip
    if not lines:
        return ""
    header = ["points", "contracted", "contraction, CPU s", "graph", "traits", "together",
              "MB, contraction", "MB, all", "Chamfer, cm2", "pc-skeletor LBC, CPU s", "its MB",
              "its Chamfer", "ours / its time"]  # fmt: skip
    text = "### Time and memory\n\n" + table_rows(header, lines, 0)
    large = [t for t in times if t["n_points"] >= 2e4]
    if len(large) > 1:
        exponent = growth_exponent([t["n_points"] for t in large], [t["contract"] for t in large])
        text += f"\nExponent of the contraction's time from 20 thousand points on: {exponent:.2f}\n"
    return text
