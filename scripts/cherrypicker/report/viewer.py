"""The interactive 3D view: its data as text for the page, and its scripts.

Positions are 16-bit steps of the cloud's box (0.1 mm in a box of 6 m), colours and labels bytes,
all compressed, so that 300 thousand points take 3 MB in the page. The scripts are ES modules of
``viewer_js/``, which the page carries as an import map: no build step, no network.
"""

import base64
import gzip
import json
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain, repeat
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb

from cherrypicker.classes import Label, Removal, wood_mask
from cherrypicker.geometry.neighbors import rows_in_box
from cherrypicker.pointcloud import PointCloud, joined
from cherrypicker.report.figures import cloud_colors, order_color
from cherrypicker.report.style import CLASS_COLORS, ORDER_COLORS
from cherrypicker.report.text import data_url
from cherrypicker.skeleton import axes, axis_of_node
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.traits.support import MIN_REACH_M, owning_nodes
from cherrypicker.units import unit_name

_WOOD_SHARE = 0.7  # of the points shown, where there are enough (taste)
_STEPS = np.iinfo(np.uint16).max
_N_FIRST = 150_000  # points that are drawn without a GPU
_MODULES = Path(__file__).resolve().parent / "viewer_js"


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


def viewer_data(
    skeleton: Skeleton,
    cloud: PointCloud,
    *,
    n_points: int,
    branches: Sequence[dict] = (),
    wood: tuple[np.ndarray, np.ndarray] | None = None,
    removed: PointCloud | None = None,
    cameras: Sequence[dict] = (),
    edits: dict | None = None,
    date: str = "",
    seed: int = 0,
) -> dict:
    """Return the view's data, for `cherrypicker.report.text.script_json`.

    The cloud has labels, and ``n_points`` of it are shown at most. Of each branch, by its number,
    are known ``facts`` (names and texts), how probable it is by the photos (``there``) and its
    share of the sky's ``light``, None where nobody knows. ``wood`` is kind and age of the wood at
    each node, (n_nodes,) uint8, 255 where nobody knows. Of the points that were ``removed``, with
    ``removed_by``, those in the cloud's box can be shown. For ``cameras`` see
    `cherrypicker.report.cameras.camera_views`, for ``edits``
    `cherrypicker.report.edit_file.edit_file`; without these nothing can be edited. The ``date`` is
    that of the scan.

    Places are relative to ``origin``; arrays are base64 of gzip. The ``first`` points of the cloud
    are a sample of it.
    """
    low, high = skeleton.points.min(axis=0), skeleton.points.max(axis=0)
    origin = np.round((low + high) / 2, 3)
    reach = max(float(np.linalg.norm(high - low)) / 2, 1e-3)
    to_frame = np.eye(4)
    to_frame[:3, 3] = origin
    rng = np.random.default_rng(seed)
    cloud = cloud.select(pick_points(cloud["label"], n_points, rng))
    present = np.unique(_known_labels(cloud["label"])).tolist()
    if removed is not None:
        cloud = _with_removed(cloud, removed, int((1 - _WOOD_SHARE) * n_points), rng)
    return {
        "unit": unit_name(skeleton.unit),
        "date": date,
        "origin": origin.tolist(),
        "home": {"center": [0.0, 0.0, 0.0], "reach": reach},
        "box": {"low": (low - origin).tolist(), "high": (high - origin).tolist()},
        "classes": [
            {"id": label, "name": Label(label).title, "color": _bytes_of(CLASS_COLORS[label])}
            for label in present
        ],
        "removals": [
            {"id": int(reason), "name": reason.title, "color": _bytes_of(order_color(reason))}
            for reason in Removal
        ],
        "order_colors": [_bytes_of(order_color(order)) for order in range(len(ORDER_COLORS))],
        "cloud": _cloud_data(cloud, skeleton, origin, rng),
        "skeleton": _skeleton_data(skeleton, origin, branches, wood),
        "cameras": [
            {
                **camera,
                "center": (camera["center"] - origin).tolist(),
                "matrix": (camera["matrix"] @ to_frame).ravel().tolist(),
            }
            for camera in cameras
        ],
        "edits": edits,
    }


def _with_removed(
    cloud: PointCloud, removed: PointCloud, n_most: int, rng: np.random.Generator
) -> PointCloud:
    """The cloud, then at most `n_most` of the points in its box that were taken out of it."""
    rows = rows_in_box(removed.points, cloud.points.min(axis=0), cloud.points.max(axis=0))
    out = removed.select(np.sort(rng.choice(rows, min(n_most, len(rows)), replace=False)))
    if cloud.colors is not None and out.colors is None:
        out = replace(out, colors=np.full((len(out), 3), 0.5))
    out = out.with_fields(
        label=np.full(len(out), Label.UNLABELLED, np.uint8),
        confidence=np.zeros(len(out), np.float32),
    )
    return joined([cloud.with_fields(removed_by=np.zeros(len(cloud), np.uint8)), out])


def _known_labels(labels: np.ndarray) -> np.ndarray:
    is_known = np.isin(labels, list(CLASS_COLORS))
    return np.where(is_known, labels, Label.UNLABELLED).astype(np.uint8)


def _cloud_data(
    shown: PointCloud, skeleton: Skeleton, origin: np.ndarray, rng: np.random.Generator
) -> dict:
    low, high = shown.points.min(axis=0), shown.points.max(axis=0)
    span = np.maximum(high - low, 1e-6)
    steps = np.rint((shown.points - low) / span * _STEPS).astype("<u2", order="C")
    is_later = np.ones(len(shown), bool)
    is_later[pick_points(shown["label"], _N_FIRST, rng)] = False
    # By cells of 256 steps: drawn in half the time, for neighbours share memory
    order = np.lexsort((*(steps >> 8).T, is_later))
    shown, steps = shown.select(order), steps[order]
    sure = np.nan_to_num(shown["confidence"]) if "confidence" in shown else None
    # Of the wood, the node whose edge a point belongs to, by the rule of branches.ply but its reach
    node, wood = np.full(len(shown), -1), np.flatnonzero(wood_mask(shown["label"]))
    owner, away, radius = owning_nodes(shown.points[wood], skeleton)
    node[wood] = np.where(away <= radius + MIN_REACH_M, owner, -1)
    return {
        "first": len(shown) - int(is_later.sum()),
        "low": (low - origin).tolist(),
        "span": span.tolist(),
        "has_color": shown.colors is not None,
        # The low bytes of all x, the high bytes, those of y ...: smaller than point by point
        "positions": _packed(steps.view("u1").reshape(-1, 6).T, "u1"),
        "colors": _packed(np.clip(np.rint(cloud_colors(shown) * 255), 0, 255), "u1"),
        "labels": _packed(_known_labels(shown["label"]), "u1"),
        "confidence": None if sure is None else _packed(np.clip(np.rint(sure * 255), 0, 255), "u1"),
        "removed": _packed(shown["removed_by"], "u1") if "removed_by" in shown else None,
        "nodes": _packed(node, "<i4"),
    }


def _skeleton_data(
    skeleton: Skeleton, origin: np.ndarray, branches: Sequence[dict], wood: tuple | None
) -> dict:
    axis_list, error = axes(skeleton), skeleton.fields.get("radius_error")
    told = chain(branches, repeat({"facts": [], "there": None, "light": None}))
    kind, age = (None, None) if wood is None else (_packed(each, "u1") for each in wood)
    return {
        "points": _packed(skeleton.points - origin, "<f4"),
        "parent": _packed(skeleton.parent, "<i4"),
        "radius": _packed(skeleton.radius, "<f4"),
        "error": None if error is None else _packed(error, "<f4"),
        "label": _packed(_known_labels(skeleton.label), "u1"),
        "kind": kind,
        "age": age,
        "axis": _packed(axis_of_node(skeleton, axis_list), "<i4"),
        "branches": [
            {"order": int(axis.order), **branch}
            for axis, branch in zip(axis_list, told, strict=False)
        ],
    }


def module_map() -> str:
    """The view's modules as the text of an import map, by their names ``viewer/*.js``."""
    imports = {
        f"viewer/{path.name}": data_url("text/javascript", path.read_bytes())
        for path in sorted(_MODULES.glob("*.js"))
    }
    return json.dumps({"imports": imports})


def _bytes_of(color: Any) -> list[int]:
    """RGB of a colour, 0 to 255."""
    return [round(255 * value) for value in to_rgb(color)]


def _packed(array: np.ndarray, kind: str) -> str:
    packed = gzip.compress(np.ascontiguousarray(array, dtype=kind).tobytes(), mtime=0)
    return base64.b64encode(packed).decode("ascii")
