"""The picture of the benchmark of skeletons: skeletons over their clouds."""

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

DETAIL_M = 0.7


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
