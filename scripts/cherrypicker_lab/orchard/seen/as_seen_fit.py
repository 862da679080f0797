"""What a reconstructed cloud does to the surface, by the radius of the wood: to fit `AsSeen`."""

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.errors import StageError
from cherrypicker_lab.dense.surface import judge_points

RADIUS_EDGES_M = np.array([0.0, 0.0025, 0.0035, 0.005, 0.008, 0.012, 0.020, 0.10])
NEAR_M = 0.015
QUANTILES = (0.05, 0.16, 0.5, 0.84, 0.95)
_FEWEST = 50


def describe_cloud(points, colors, surface):
    """Compare a cloud with the true surface of its scene's target tree.

    Parameters
    ----------
    points : ndarray of shape (n, 3), float64
        Scene's frame, m.
    colors : ndarray of shape (n, 3)
        sRGB in [0, 1].
    surface : cherrypicker_lab.dense.truth.TrueSurface

    Returns
    -------
    dict of str to list
        A value for each class of radius between `RADIUS_EDGES_M`, None where the scene has too
        little such wood: ``offset_m`` (quantiles 5, 16, 50, 84, 95 % of the signed distance to the
        surface, outwards, of points within 15 mm), ``points_per_m2``, ``beyond_5mm``,
        ``beyond_10mm``, ``beyond_20mm`` (shares of the points), ``complete_1.5mm``,
        ``complete_3mm``, ``complete_5mm`` (shares of the surface that three photos see), and
        ``lightness`` (quantiles 10, 50, 90 % of the mean of red, green and blue).

    Raises
    ------
    StageError
        If no point lies near the tree.
    """
    judged = judge_points(points, surface)
    if not judged.any():
        raise StageError(f"none of {len(points):,} points lies near the true tree")
    points, light = points[judged], colors[judged].mean(axis=1)
    gap, nearest = cKDTree(surface.points).query(points, workers=1)
    away = points - surface.points[nearest]
    signed = np.einsum("ij,ij->i", away, surface.normals[nearest])
    reached = cKDTree(points).query(surface.points, workers=1)[0]
    seen = surface.n_views >= 3
    of_point = np.digitize(surface.radius[nearest], RADIUS_EDGES_M) - 1
    of_surface = np.digitize(surface.radius, RADIUS_EDGES_M) - 1
    names = ["offset_m", "points_per_m2", "beyond_5mm", "beyond_10mm", "beyond_20mm",
             "complete_1.5mm", "complete_3mm", "complete_5mm", "lightness"]  # fmt: skip
    report = {name: [] for name in names}
    for k in range(len(RADIUS_EDGES_M) - 1):
        mine, theirs = of_point == k, (of_surface == k) & seen
        if mine.sum() < _FEWEST or theirs.sum() < _FEWEST:
            for values in report.values():
                values.append(None)
            continue
        near = mine & (gap < NEAR_M)
        report["offset_m"].append(np.quantile(signed[near], QUANTILES).tolist())
        report["points_per_m2"].append(float(near.sum() / surface.area[of_surface == k].sum()))
        for name in names[2:5]:
            limit = float(name.removeprefix("beyond_").removesuffix("mm")) / 1000
            report[name].append(float((gap[mine] > limit).mean()))
        for name in names[5:8]:
            limit = float(name.removeprefix("complete_").removesuffix("mm")) / 1000
            weight = surface.area[theirs]
            report[name].append(float(weight @ (reached[theirs] < limit) / weight.sum()))
        report["lightness"].append(np.quantile(light[near], (0.1, 0.5, 0.9)).tolist())
    return report


def plot_fit(report, path):
    """Plot found clouds beside the model's, a column a scene.

    Parameters
    ----------
    report : dict
        Per scene `found` and `model`, each as from `describe_cloud`.
    path : path-like
        PNG.
    """
    from matplotlib.figure import Figure

    edges = 1000 * RADIUS_EDGES_M
    at = np.sqrt(np.maximum(edges[:-1], 1.5) * np.minimum(edges[1:], 60.0))
    figure = Figure(figsize=(4.2 * len(report), 8.5), layout="constrained")
    axes = figure.subplots(3, len(report), squeeze=False, sharex=True, sharey="row")
    for column, (name, kinds) in enumerate(report.items()):
        for kind, style in (("found", "-"), ("model", "--")):
            values = kinds[kind]
            known = [k for k, v in enumerate(values["offset_m"]) if v is not None]
            radius = at[known]
            offsets = 1000 * np.array([values["offset_m"][k] for k in known])
            for i, color in ((0, "C0"), (2, "C1"), (4, "C2")):
                label = f"{round(100 * QUANTILES[i])} %, {kind}"
                axes[0, column].plot(radius, offsets[:, i], style, color=color, label=label)
            for key, color in (("complete_3mm", "C0"), ("complete_5mm", "C1")):
                share = [100 * values[key][k] for k in known]
                label = f"within {key[9:-2]} mm, {kind}"
                axes[1, column].plot(radius, share, style, color=color, label=label)
            light = np.array([values["lightness"][k] for k in known])
            for i, color in ((0, "C0"), (1, "C1"), (2, "C2")):
                label = f"{(10, 50, 90)[i]} %, {kind}"
                axes[2, column].plot(radius, light[:, i], style, color=color, label=label)
        axes[0, column].set_title(name)
        axes[2, column].set_xlabel("radius of the wood, mm")
        axes[2, column].set_xscale("log")
        ticks = [2, 3, 5, 10, 20, 40]
        axes[2, column].set_xticks(ticks, [str(t) for t in ticks])
        axes[2, column].minorticks_off()
    for row, what in zip(axes, ("offset from the surface, mm", "surface found, %", "lightness")):
        row[0].set_ylabel(what)
        row[0].legend(fontsize=7)
        for panel in row:
            panel.grid(alpha=0.3)
    figure.savefig(path, format="png", dpi=80)
