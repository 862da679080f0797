"""Figures of the benchmark of skeletons: Chamfer distances, time, skeletons over clouds."""

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from cherrypicker_lab.skeletons.methods import SETTINGS
from cherrypicker_lab.skeletons.tables import METHOD_NAMES, SETTING_NAMES

COLORS = {
    "lbc_paper": "#8fb8a8",
    "slbc_paper": "#1b7f5c",
    "bare_default": "#9db2dd",
    "slbc_default": "#3b5bab",
    "peer_lbc": "#e8b48c",
    "peer_slbc": "#c2571a",
}
TEMPLATES = ("fir", "larch", "pine")
DETAIL_M = 0.7


def chamfer_figure(table):
    """Chamfer of every tree by template and method, one panel a setting."""
    figure = Figure(figsize=(10, 4), layout="constrained")
    axes = figure.subplots(1, len(SETTINGS), sharey=True)
    for ax, setting in zip(axes, SETTINGS):
        methods = [name for name in METHOD_NAMES if (setting, name) in table]
        for column, name in enumerate(methods):
            found = table[setting, name].values()
            for place, template in enumerate(TEMPLATES):
                values = [r["points"]["chamfer_cm2"] for r in found if r["template"] == template]
                x = place + 0.8 * (column - (len(methods) - 1) / 2) / max(len(methods), 1)
                ax.plot(np.full(len(values), x), values, ".", color=COLORS[name], ms=5)
                if values:
                    ax.plot(x, np.mean(values), "_", color=COLORS[name], ms=14, mew=2,
                            label=METHOD_NAMES[name] if place == 0 else None)  # fmt: skip
        ax.set_title(SETTING_NAMES[setting])
        ax.set_xticks(range(len(TEMPLATES)), TEMPLATES)
        ax.set_yscale("log")
        ax.grid(axis="y", which="both", alpha=0.3)
    axes[0].set_ylabel("Chamfer distance, cm²")
    axes[0].legend(fontsize=7)
    return figure


def time_figure(times):
    """CPU seconds over points, both logarithmic."""
    figure = Figure(figsize=(6, 4.2), layout="constrained")
    ax = figure.subplots()
    times = sorted(times, key=lambda t: t["n_points"])
    n = [t["n_points"] for t in times]
    ax.loglog(n, [t["contract"] for t in times], "o-", color="#3b5bab", label="contraction")
    whole = [t["contract"] + t["graph"] + t["traits"] for t in times]
    ax.loglog(n, whole, "s-", color="#1b7f5c", label="cloud to traits")
    peer = [t for t in times if t["peer"]]
    if peer:
        ax.loglog(
            [t["n_points"] for t in peer],
            [t["peer"]["cpu_s"] for t in peer],
            "^",
            color="#c2571a",
            label="pc-skeletor LBC",
        )
        for t in peer:
            ax.annotate(
                f"{t['peer']['iterations']} it.",
                (t["n_points"], t["peer"]["cpu_s"]),
                fontsize=7,
                xytext=(5, -3),
                textcoords="offset points",
            )
    ax.set_xlabel("points")
    ax.set_ylabel("CPU seconds")
    ax.grid(which="both", alpha=0.3)
    ax.legend(fontsize=8)
    return figure


def skeleton_figure(title, cloud, truth, found):
    """Contracted points over the cloud and the true skeleton, whole and in detail.

    Parameters
    ----------
    title : str
    cloud : ndarray of shape (n, 3)
    truth : ndarray of shape (m, 2, 3)
        True edges.
    found : dict of str to ndarray
        Name to contracted points (n, 3) or to edges (k, 2, 3).
    """
    figure = Figure(figsize=(4 * len(found), 9), layout="constrained")
    axes = figure.subplots(2, len(found), squeeze=False)
    foot = cloud[np.argmin(cloud[:, 2])]
    corner = np.array([foot[0] - DETAIL_M / 2, foot[2] + 0.5])
    for column, (name, values) in enumerate(found.items()):
        for ax in axes[:, column]:
            ax.plot(cloud[:, 0], cloud[:, 2], ",", color="#cccccc", zorder=0)
            ax.add_collection(LineCollection(truth[:, :, [0, 2]], colors="#2a9d4a", linewidths=0.6))
            if values.ndim == 3:
                ax.add_collection(
                    LineCollection(values[:, :, [0, 2]], colors="#c22f2f", linewidths=0.8)
                )
            else:
                ax.plot(values[:, 0], values[:, 2], ".", color="#c22f2f", ms=1.2, mew=0)
            ax.set_aspect("equal")
        axes[0, column].set_title(name, fontsize=9)
        axes[1, column].set_xlim(corner[0], corner[0] + DETAIL_M)
        axes[1, column].set_ylim(corner[1], corner[1] + 1.2 * DETAIL_M)
    figure.suptitle(title)
    return figure
