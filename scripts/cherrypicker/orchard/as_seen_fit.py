"""What a reconstructed cloud does to the surface, by the radius of the wood: to fit `AsSeen`."""

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.errors import StageError
from cherrypicker.stereo_benchmark.surface import judge_points

__all__ = ["RADIUS_EDGES_M", "describe_cloud"]

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
    surface : cherrypicker.stereo_benchmark.truth.TrueSurface

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
