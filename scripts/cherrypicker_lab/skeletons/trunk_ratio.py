"""S-LBC over LBC against the trunk's radius, on the paper's set with trunks of given thickness."""

from collections import defaultdict

import numpy as np
from matplotlib.figure import Figure

from cherrypicker.errors import StageError
from cherrypicker.files import atomic_path, read_json
from cherrypicker_lab.skeletons.graph_scores import score_points
from cherrypicker_lab.skeletons.methods import SETTINGS, contract_as_published
from cherrypicker_lab.skeletons.tables import PAPER_RATIO, SETTING_NAMES
from cherrypicker_lab.tables import markdown_table

METHODS = ("lbc", "slbc")
COLORS = {"compound": "#1b7f5c", "pc_skeletor": "#c2571a", "cao": "#3b5bab"}


def measure_trunk(cloud, skeleton, rules, *, max_iterations=20):
    """Chamfer distances of LBC and S-LBC on a cloud to its true skeleton.

    The cloud is labelled, in metres, and contracted as it is by each of the rules
    (`contract.attraction_rule`). Returns ``uncontracted``, the Chamfer distance of the cloud
    itself, cm2, and by rule a dict of the distances by method.
    """

    def chamfer(points):
        return score_points(points, skeleton)["chamfer_cm2"]

    report = {"n_points": len(cloud), "uncontracted": chamfer(cloud.points)}
    for rule in rules:
        constants = {"attraction_rule": rule, "max_iterations": max_iterations}
        report[rule] = {
            method: chamfer(contract_as_published(cloud, method, **constants)) for method in METHODS
        }
    return report


def gather_trunks(paths):
    """Read the measurements: (setting, trunk radius in m) to `measure_trunk`'s dicts by tree.

    Raises a `StageError` if there is none.
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


def _with(reports, kind):
    return [report for report in reports if kind in report]


def _ratio(reports, kind):
    """Mean Chamfer of S-LBC over that of LBC."""
    lbc, slbc = (_mean(reports, kind, method) for method in METHODS)
    return slbc / lbc


def _mean(reports, kind, method):
    return float(np.mean([report[kind][method] for report in reports]))


def write_ratio_table(found):
    """Table of Markdown from `gather_trunks`."""
    lines = []
    for kind in COLORS:
        for setting, radius in sorted(found, key=lambda key: (SETTINGS.index(key[0]), key[1])):
            reports = _with(found[setting, radius], kind)
            if reports:
                bare = np.mean([report["uncontracted"] for report in reports])
                ends = [_mean(reports, kind, method) for method in METHODS]
                lines.append(
                    [
                        kind,
                        SETTING_NAMES[setting],
                        f"{100 * radius:g}",
                        f"{len(reports)}",
                        *(f"{value:.2f}" for value in (bare, *ends)),
                        f"{_ratio(reports, kind):.2f}",
                    ]
                )
    header = ["W_H", "cloud", "trunk radius, cm", "trees", "not contracted, cm2", "LBC", "S-LBC",
              "S-LBC / LBC"]  # fmt: skip
    return "### Chamfer distance by trunk radius\n\n" + markdown_table(header, lines, 2)


def draw_ratio(found, path):
    """PNG of S-LBC / LBC over the trunk's radius, a panel a setting, beside the paper's ratio."""
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    for ax, setting in zip(figure.subplots(1, len(SETTINGS), sharey=True), SETTINGS, strict=True):
        for kind, color in COLORS.items():
            radii = sorted(
                radius
                for (one, radius), reports in found.items()
                if one == setting and _with(reports, kind)
            )
            ratios = [_ratio(_with(found[setting, radius], kind), kind) for radius in radii]
            if radii:
                ax.plot(100 * np.array(radii), ratios, "o-", color=color, label=kind)
        ax.axhline(PAPER_RATIO[setting], color="#888888", ls="--", label="the paper")
        ax.set_title(SETTING_NAMES[setting])
        ax.set_xlabel("trunk radius, cm")
        ax.grid(alpha=0.3)
    figure.axes[0].set_ylabel("Chamfer distance, S-LBC / LBC")
    figure.axes[0].legend(fontsize=7)
    with atomic_path(path) as partial:
        figure.savefig(partial, format="png", metadata={"Software": None})
