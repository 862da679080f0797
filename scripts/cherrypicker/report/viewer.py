"""Data of the interactive 3D view: a thinned cloud and the skeleton as base64 text.

Positions are 16-bit steps of the cloud's box (0.1 mm in a box of 6 m), colours and labels bytes,
so that 150 thousand points take 2 MB in the page.
"""

from __future__ import annotations

import base64
import json

import numpy as np
from matplotlib.colors import to_hex, to_rgb

from cherrypicker.classes import Label, wood_mask
from cherrypicker.pointcloud import PointCloud
from cherrypicker.report.colors import CLASS_COLORS
from cherrypicker.report.figures import cloud_colors, order_color
from cherrypicker.report.style import ORDER_COLORS
from cherrypicker.skeleton import axes, node_order
from cherrypicker.skeleton.model import Skeleton

_WOOD_SHARE = 0.7  # of the points shown, where there are enough (taste)
_STEPS = np.iinfo(np.uint16).max


def pick_points(labels: np.ndarray, n_most: int, rng: np.random.Generator) -> np.ndarray:
    """Choose points to show by their labels (n_points,), wood before the rest; increasing rows."""
    wood = np.flatnonzero(wood_mask(labels))
    rest = np.flatnonzero(~wood_mask(labels))
    n_wood = min(len(wood), max(int(_WOOD_SHARE * n_most), n_most - len(rest)))
    n_rest = min(len(rest), n_most - n_wood)
    picked = np.concatenate(
        [rng.choice(wood, n_wood, replace=False), rng.choice(rest, n_rest, replace=False)]
    )
    return np.sort(picked.astype(np.int64))


def viewer_data(cloud: PointCloud, skeleton: Skeleton, *, n_points: int, seed: int = 0) -> dict:
    """Return the view's data as text for the page.

    Parameters
    ----------
    cloud : PointCloud
        With labels.

    Returns
    -------
    dict
        ``meta`` (JSON text, safe inside a script element), ``positions``, ``colors``, ``labels``,
        ``edges`` (base64), ``classes`` (id, name and CSS colour of the classes shown), ``orders``
        (order and CSS colour), ``n_shown``.
    """
    shown = cloud.select(pick_points(cloud["label"], n_points, np.random.default_rng(seed)))
    low, high = shown.points.min(axis=0), shown.points.max(axis=0)
    span = np.maximum(high - low, 1e-6)
    positions = np.rint((shown.points - low) / span * _STEPS).astype("<u2")
    colors = np.clip(np.rint(cloud_colors(shown) * 255), 0, 255).astype(np.uint8)
    is_known = np.isin(shown["label"], list(CLASS_COLORS))
    labels = np.where(is_known, shown["label"], Label.UNLABELLED).astype(np.uint8)
    present = np.unique(labels).tolist()
    orders = node_order(skeleton, axes(skeleton))
    box = skeleton.points.min(axis=0), skeleton.points.max(axis=0)
    meta = {
        "low": low.tolist(),
        "span": span.tolist(),
        "center": ((box[0] + box[1]) / 2).tolist(),
        "reach": max(float(np.linalg.norm(box[1] - box[0])) / 2, 1e-3),
        "has_color": cloud.colors is not None,
        "labels": present,
        "label_colors": [list(map(float, CLASS_COLORS[label])) for label in present],
        "order_colors": [to_rgb(order_color(order)) for order in range(len(ORDER_COLORS))],
    }
    return {
        "meta": json.dumps(meta).replace("<", "\\u003c"),
        "positions": _base64(positions),
        "colors": _base64(colors),
        "labels": _base64(labels),
        "edges": _base64(_edges(skeleton, orders)),
        "classes": [
            {
                "id": label,
                "name": Label(label).title,
                "color": to_hex(CLASS_COLORS[label]),
            }
            for label in present
        ],
        "orders": [
            {"order": int(order), "color": order_color(order)} for order in np.unique(orders)
        ],
        "n_shown": len(shown),
    }


def _edges(skeleton: Skeleton, orders: np.ndarray) -> np.ndarray:
    """Both ends with radius, then the order, (n_edges, 9) float32."""
    end = np.arange(1, len(skeleton))
    start = skeleton.parent[1:]
    return np.column_stack(
        [
            skeleton.points[start],
            # A junction's radius is the thicker axis's
            np.where(orders[start] == orders[end], skeleton.radius[start], skeleton.radius[end]),
            skeleton.points[end],
            skeleton.radius[end],
            orders[end],
        ]
    ).astype("<f4")


def _base64(array: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")
