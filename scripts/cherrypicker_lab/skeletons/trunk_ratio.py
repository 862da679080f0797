"""S-LBC over LBC against the trunk's radius, on the paper's set with trunks of given thickness."""

from collections import defaultdict

import numpy as np
from matplotlib.figure import Figure

from cherrypicker.errors import StageError
from cherrypicker.files import read_json
from cherrypicker_lab.skeletons.distances import chamfer_cm2
from cherrypicker_lab.skeletons.methods import SETTINGS, contract_as_published
from cherrypicker_lab.skeletons.peer import run_peer
from cherrypicker_lab.skeletons.point_scores import chamfer_samples
from cherrypicker_lab.skeletons.tables import PAPER_RATIO, SETTING_NAMES, table_rows

__all__ = ["gather_trunks", "measure_trunk", "ratio_figure", "write_ratio_tables"]

METHODS = ("lbc", "slbc")
PEER = "peer"
NAMES = {
    "compound": "preset paper",
    "pc_skeletor": "preset paper, pc-skeletor's W_H",
    "cao": "preset paper, Cao's W_H",
    PEER: "pc-skeletor",
}
COLORS = {"compound": "#1b7f5c", "pc_skeletor": "#c2571a", "cao": "#3b5bab", PEER: "#111111"}
STEPS = (1, 2, 3, 5, 10)


def measure_trunk(cloud, skeleton, rules, *, max_iterations=20, peer_python=""):
    """Chamfer distances of LBC and S-LBC on a cloud after each iteration.

    Parameters
    ----------
    cloud : PointCloud
        Labelled, metres; contracted as it is.
    skeleton : Skeleton
        The truth.
    rules : iterable of str
        `contract.attraction_rule`.
    max_iterations : int
    peer_python : str
        Python that has pc-skeletor; empty leaves it out.

    Returns
    -------
    dict
        ``uncontracted``: Chamfer distance of the cloud itself, cm2. By rule, and as "peer", a
        dict by method of the distances after each iteration (of the peer the last alone).
    """
    truth, _ = chamfer_samples(skeleton)
    report = {"n_points": len(cloud), "uncontracted": chamfer_cm2(cloud.points, truth)}
    for rule in rules:
        constants = {"attraction_rule": rule, "max_iterations": max_iterations}
        report[rule] = {method: _steps(cloud, truth, method, constants) for method in METHODS}
    if peer_python:
        report[PEER] = {}
        for method in METHODS:
            end, _ = run_peer(peer_python, cloud, method, max_iterations=max_iterations)
            report[PEER][method] = [chamfer_cm2(end["contracted"], truth)]
    return report


def _steps(cloud, truth, method, constants):
    steps = []

    def score(iteration, ratio, points):
        steps.append(chamfer_cm2(points, truth))

    contract_as_published(cloud, method, callback=score, **constants)
    return steps


def gather_trunks(paths):
    """Read the measurements: (setting, trunk radius in m) to `measure_trunk`'s dicts by tree.

    Raises
    ------
    StageError
        If there is none.
    """
    found = defaultdict(dict)
    for path in paths:
        report = read_json(path)
        for setting, values in report["settings"].items():
            by_tree = found[setting, report["trunk_radius"]]
            by_tree[report["tree"]] = by_tree.get(report["tree"], {}) | values
    if not found:
        raise StageError("nothing was measured", key="benchmark.skeleton.trunk_radii_m")
    return {key: list(by_tree.values()) for key, by_tree in found.items()}


def _kinds(found):
    return [kind for kind in NAMES if any(kind in r for reports in found.values() for r in reports)]


def _mean(reports, kind, method, step=-1):
    """Mean Chamfer over the trees after so many iterations, or at the end where it came before."""
    runs = [report[kind][method] for report in reports if kind in report]
    return float(np.mean([run[-1 if step < 0 else min(step, len(run)) - 1] for run in runs]))


def _ratio(reports, kind, step=-1):
    return _mean(reports, kind, "slbc", step) / _mean(reports, kind, "lbc", step)


def write_ratio_tables(found):
    """Tables of Markdown from `gather_trunks`: at the end, and after each of a few iterations."""
    kinds = _kinds(found)
    ends, steps = [], []
    for setting, radius in sorted(found, key=lambda key: (SETTINGS.index(key[0]), key[1])):
        reports = found[setting, radius]
        head = [SETTING_NAMES[setting], f"{100 * radius:g}", f"{len(reports)}"]
        ends.append([*head, f"{np.mean([report['uncontracted'] for report in reports]):.2f}"])
        for kind in kinds:
            if any(kind in report for report in reports):
                values = [_mean(reports, kind, method) for method in METHODS]
                ends[-1] += [f"{values[0]:.2f}", f"{values[1]:.2f}", f"{_ratio(reports, kind):.3f}"]
            else:
                ends[-1] += ["–"] * 3
        for kind in kinds:
            if kind != PEER and any(kind in report for report in reports):
                cells = [f"{_ratio(reports, kind, step):.2f}" for step in (*STEPS, -1)]
                steps.append([*head[:2], NAMES[kind], *cells])
    header = ["cloud", "trunk radius, cm", "trees", "not contracted"]
    for kind in kinds:
        header += [f"LBC, {NAMES[kind]}", "S-LBC", "S-LBC / LBC"]
    text = "### Chamfer distance by trunk radius, cm2\n\n" + table_rows(header, ends, 1)
    header = ["cloud", "trunk radius, cm", "S-LBC / LBC", *(f"{n}" for n in STEPS), "end"]
    return text + "\n### Ratio after so many iterations\n\n" + table_rows(header, steps, 3)


def ratio_figure(found):
    """S-LBC / LBC over the trunk's radius, a panel a setting, beside the paper's ratio."""
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    for ax, setting in zip(figure.subplots(1, len(SETTINGS), sharey=True), SETTINGS, strict=True):
        for kind in _kinds(found):
            radii = sorted(
                radius
                for (one, radius), reports in found.items()
                if one == setting and any(kind in report for report in reports)
            )
            for step, style in ((-1, "o-"), (3, "o:")):
                if kind == PEER and step > 0:
                    continue
                ratios = [_ratio(found[setting, radius], kind, step) for radius in radii]
                name = NAMES[kind] + (", end" if step < 0 else f", {step} iterations")
                ax.plot([100 * radius for radius in radii], ratios, style, color=COLORS[kind],
                        ms=4, label=name)  # fmt: skip
        ax.axhline(PAPER_RATIO[setting], color="#888888", ls="--", label="the paper")
        ax.set_title(SETTING_NAMES[setting])
        ax.set_xlabel("trunk radius, cm")
        ax.grid(alpha=0.3)
    figure.axes[0].set_ylabel("Chamfer distance, S-LBC / LBC")
    figure.axes[0].legend(fontsize=7)
    return figure
