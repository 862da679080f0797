"""The pictures of the benchmark of skeletons: skeletons over their clouds."""

from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from cherrypicker.files import read_json
from cherrypicker_lab.skeletons.methods import SETTINGS
from cherrypicker_lab.skeletons.tables import METHOD_NAMES

DETAIL_M = 0.7
SHOWN = ("peer_lbc", "peer_slbc", "lbc_paper", "slbc_paper", "slbc_default")


def skeleton_figures(scores):
    """Figures of the first tree of each template in each setting, ours and the peers' together.

    Parameters
    ----------
    scores : iterable of path-like
        ``scores_*.json``, each with its ``skeletons_*.npz`` beside it.

    Returns
    -------
    dict of str to Figure
    """
    chosen = {}
    for path in scores:
        report = read_json(path)
        tree, paths = chosen.setdefault(report["template"], (report["tree"], []))
        if tree == report["tree"]:
            paths.append(Path(path).with_name(Path(path).name.replace("scores", "skeletons")))
    figures = {}
    for tree, paths in chosen.values():
        arrays = {}
        for path in paths:
            with np.load(path.with_suffix(".npz"), allow_pickle=False) as stored:
                arrays |= {key: stored[key] for key in stored.files}
        for setting in SETTINGS:
            shown = {METHOD_NAMES[name]: arrays.get(f"{setting}_{name}") for name in SHOWN}
            shown["limbs"] = arrays.get(f"{setting}_slbc_default_tree", shown["limbs"])
            shown = {name: values for name, values in shown.items() if values is not None}
            figures[f"skeletons_{tree}_{setting}"] = skeleton_figure(
                f"{tree}, {setting}", arrays[f"{setting}_cloud"], arrays["truth"], shown
            )
    return figures


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
