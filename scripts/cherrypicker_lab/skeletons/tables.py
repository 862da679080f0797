"""The skeleton benchmark's results as tables of Markdown."""

from collections import defaultdict

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.files import read_json
from cherrypicker_lab.skeletons.graph_scores import THICK_M
from cherrypicker_lab.skeletons.methods import SETTINGS
from cherrypicker_lab.tables import markdown_table

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

    Returns (setting, method) to a dict of tree name to its report; runs that failed are left out.
    Raises a `StageError` if there is none.
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


def write_tables(table):
    """All tables as Markdown, of what `gather` gives."""
    return "\n".join(filter(None, [_chamfer_table(table), _graph_table(table)]))


def _methods(table, setting):
    return [name for name in METHOD_NAMES if (setting, name) in table]


def _mean(found, read):
    return float(np.mean([read(report) for report in found.values()]))


def _chamfer(report):
    return report["points"]["chamfer_cm2"]


def _chamfer_table(table):
    """Mean Chamfer on all trees of a method, and on the trees that every method has run on."""
    lines = []
    for setting in SETTINGS:
        methods = _methods(table, setting)
        trees = [set(table[setting, name]) for name in methods]
        common = sorted(set.intersection(*trees)) if trees else []
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
                    f"{_mean(found, lambda r: r['cpu_s']):.1f}",
                ]
            )
    header = ["cloud", "contraction", "trees", "Chamfer, cm2", "on the trees of all methods",
              "CPU s a cloud"]  # fmt: skip
    return "### Chamfer distance\n\n" + markdown_table(header, lines, 2)


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
                f"{_mean(found, lambda r: r['n_false_edges']):.1f}",
                f"{100 * _mean(found, lambda r: abs(r['length_error'])):.1f} %",
                f"{100 * _mean(found, lambda r: r['length_error']):+.1f} %",
                f"{100 * _mean(found, lambda r: r['ways_within_10pct']):.1f} %",
                *_radius_cells(found),
                f"{_mean(found, lambda r: r['cpu_s']):.1f}",
            ]
        )
    header = ["cloud", "contraction", "graph", "trees", "junction F1", "tip F1", "false edges",
              "length error, absolute", "signed", "ways within 10 %",
              *(f"radius off by, mm, {name.replace('_', ' ')}" for name in THICK_M),
              "CPU s"]  # fmt: skip
    return "### Graphs\n\n" + markdown_table(header, lines, 3) if lines else ""


def _radius_cells(found):
    """Mean over trees of `radius_errors`, millimetres, by `THICK_M`."""
    errors = [report.get("radius", {}) for report in found.values()]
    for name in THICK_M:
        values = [error[name] for error in errors if name in error]
        yield f"{1e3 * np.mean(values):+.2f}" if values else "–"
