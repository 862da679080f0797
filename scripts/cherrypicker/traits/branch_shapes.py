"""Shapes of all axes of a skeleton: lengths, directions, radii, laterals."""

from __future__ import annotations

import numpy as np

from cherrypicker.geometry.lines import NEAR, Line
from cherrypicker.skeleton.axes import Axis, axis_polyline
from cherrypicker.skeleton.model import Skeleton

LEAST_WINDOW_M = 0.08  # of the stretch at an axis's base that its direction is taken over (guess)
WINDOW_RADII = 4.0  # of its first node: the same, where it is thick (guess)
TIP_WINDOW_M = 0.03  # of the stretch that the tip's diameter is taken over (guess)


def axis_shapes(skeleton: Skeleton, axis_list: list[Axis]) -> dict[str, np.ndarray]:
    """Measure every axis; `cherrypicker.traits.branches.branch_rows` tells what the numbers mean.

    Returns
    -------
    dict of str to ndarray of shape (n_axes,), float64
        Columns of ``branches.csv``, in the skeleton's unit and frame; `lateral_spacing_m` is NaN
        with fewer than two places of laterals. Beside them `base_residual`, the scatter of the
        points behind the base diameter, `base_error`, the standard error of a radius there, and
        `stretch`, the length that the direction is taken over.
    """
    none = np.zeros(len(skeleton))
    arc, n_points, residual, error, gap = (
        skeleton.fields.get(name, none)
        for name in ("arc_deg", "n_points", "residual", "radius_error", "gap")
    )
    radius, length = skeleton.radius, skeleton.edge_length
    lines = [Line(skeleton.points[axis_polyline(axis)]) for axis in axis_list]
    place = np.zeros(len(skeleton))  # of a node along its own axis
    for axis, line in zip(axis_list, lines, strict=True):
        place[axis.nodes] = line.along[-len(axis.nodes) :]
    feet = np.array([axis.attach for axis in axis_list if axis.attach >= 0], dtype=np.int64)
    is_foot = np.zeros(len(skeleton), dtype=bool)
    is_foot[feet] = True
    n_laterals = np.bincount([axis.parent + 1 for axis in axis_list], minlength=len(axis_list) + 1)
    rows = []
    for index, (axis, line) in enumerate(zip(axis_list, lines, strict=True)):
        nodes, total = axis.nodes, line.along[-1]
        skip = 0.0 if axis.attach < 0 else min(radius[axis.attach], 0.5 * total)
        window = max(LEAST_WINDOW_M, WINDOW_RADII * radius[nodes[0]])
        direction = line.direction(skip, skip + window)
        below = np.array([0.0, 0.0, 1.0])
        if axis.attach >= 0:
            # Through the place that it hangs on; where its parent ends, of what lies below
            parent, at = lines[axis.parent], place[axis.attach]
            is_end = at >= parent.along[-1] - NEAR
            below = parent.direction(at - 2 * window if is_end else at - window, at + window)
        base = _stretch(place[nodes], skip, skip + window)
        tip = _stretch(place[nodes], total - TIP_WINDOW_M, total)
        laterals = place[nodes][is_foot[nodes]]
        rows.append(
            {
                "length_m": total,
                "chord_m": np.linalg.norm(line.points[-1] - line.points[0]),
                "base_diameter_m": 2.0 * np.median(radius[nodes][base]),
                "tip_diameter_m": 2.0 * np.median(radius[nodes][tip]),
                "insertion_angle_deg": np.degrees(np.arccos(np.clip(direction @ below, -1.0, 1.0))),
                "azimuth_deg": np.degrees(np.arctan2(direction[1], direction[0])) % 360.0,
                "base_height_m": line.points[0, 2],
                **_wood(line.along, radius[nodes]),
                "n_laterals": n_laterals[index + 1],
                "lateral_spacing_m": np.median(np.diff(laterals)) if len(laterals) > 1 else np.nan,
                "shoot_length_m": total - (laterals[-1] if len(laterals) else 0.0),
                "base_arc_deg": np.median(arc[nodes][base]),
                "base_n_points": np.median(n_points[nodes][base]),
                "gap_share": length[nodes] @ (gap[nodes] > 0) / max(length[nodes].sum(), 1e-12),
                "base_residual": np.median(residual[nodes][base]),
                "base_error": np.median(error[nodes][base]),
                "stretch": min(window, total - skip),
            }
        )
    return {name: np.array([row[name] for row in rows], dtype=np.float64) for name in rows[0]}


def _stretch(place: np.ndarray, low: float, high: float) -> np.ndarray:
    """Which nodes of an axis lie in a stretch of it; the nearest where none does."""
    inside = (place >= low - NEAR) & (place <= high + NEAR)
    if not inside.any():
        inside[np.argmin(np.abs(place - (low + high) / 2))] = True
    return inside


def _wood(along: np.ndarray, radius: np.ndarray) -> dict[str, float]:
    """Mean diameter over the length, taper and volume, from the node that the axis hangs on."""
    if len(radius) < len(along):  # it hangs on another's node, with its own first radius
        radius = np.append(radius[0], radius)
    step, thick, thin = np.diff(along), radius[:-1], radius[1:]
    taper = 0.0
    if along[-1] > 0:
        offset = along - along.mean()
        # Of what it is thinner than at its base, so that no rounding tapers an even axis
        taper = 2e3 * (offset @ (radius[0] - radius)) / (offset @ offset)
    return {
        "mean_diameter_m": step @ (thick + thin) / max(along[-1], 1e-12),
        "taper_mm_per_m": taper,
        "volume_m3": np.pi / 3 * (step @ (thick**2 + thick * thin + thin**2)),
    }
