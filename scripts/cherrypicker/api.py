"""Skeletons in two calls, on a NumPy array, an Open3D cloud or a PointCloud.

`contract` is the contraction alone (LBC and S-LBC, any number of classes and weights);
`skeletonize` goes on to the rooted tree with radii, as the workflow does, which `as_networkx` gives
as a graph. docs/api.md maps the parameters of pc-skeletor to them.
"""

import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from cherrypicker.classes import Label
from cherrypicker.contraction.contract_points import SkeletonOptions
from cherrypicker.contraction.contract_wood import contract_tree, contract_wood
from cherrypicker.graph.extract import extract_skeleton
from cherrypicker.pointcloud import PointCloud
from cherrypicker.skeleton.model import Skeleton
from cherrypicker.skeleton.networks import as_networkx
from cherrypicker.wood.thinned import GrowthOptions

__all__ = ["as_networkx", "contract", "skeletonize"]


def contract(
    cloud: PointCloud | np.ndarray,
    labels: np.ndarray | None = None,
    *,
    weights: dict | None = None,
    method: str = "limbs",
    stem: int | None = Label.TRUNK,
    voxel_size: float | None = None,
    callback: Callable | None = None,
    **constants: Any,
) -> tuple[np.ndarray, np.ndarray]:
    """Contract a cloud to its skeleton points: LBC, or S-LBC where classes weigh differently.

    Parameters
    ----------
    cloud : array-like of shape (n_points, 3), open3d.geometry.PointCloud or PointCloud
        All of it is contracted: no ground, no neighbours. Metres, or a similar scale; z up where
        there is a stem.
    labels : array-like of shape (n_points,), int, optional
        Class of each point, any integers. A PointCloud's field ``label`` by default.
    weights : dict of int to float, optional
        Lambda by class for "slbc"; classes that are not named weigh 1. Left out: 10 for the stem.
    method : {"limbs", "slbc", "lbc"}
        Every point on the axis of its limb, or the contraction as published, semantic or plain.
    stem : int or None, default 1
        Class whose points are one stem, in which limbs cross gaps. None: no class is.
    voxel_size : float, optional
        Thin the cloud to one point a voxel beforehand.
    callback : callable, optional
        Called as ``callback(iteration, mass_ratio, points)`` after each iteration; raise in it to
        stop.
    **constants
        Attributes of `cherrypicker.contraction.contract_points.SkeletonOptions`.

    Returns
    -------
    points : ndarray of shape (n, 3), float64
        Contracted points.
    source : ndarray of shape (n,), int64
        Row of the cloud that each comes from: all rows in order, without `voxel_size`.

    Raises
    ------
    ValueError
        If the shapes do not fit.
    StageError
        If there are too few points or they cannot be contracted.

    Examples
    --------
    A tube of 4 cm radius, contracted to its axis:

    >>> import numpy as np
    >>> from cherrypicker.api import contract
    >>> rng = np.random.default_rng(0)
    >>> angle, z = rng.uniform(0, 2 * np.pi, 3000), rng.uniform(0, 1, 3000)
    >>> tube = np.column_stack([0.04 * np.cos(angle), 0.04 * np.sin(angle), z])
    >>> points, source = contract(tube, np.ones(3000, int))
    >>> points.shape
    (3000, 3)
    >>> bool(np.abs(points[:, :2]).max() < 0.004)
    True

    Three classes of your own, each with its weight, as published, with a progress report:

    >>> kinds = np.digitize(z, [0.3, 0.7])
    >>> points, _ = contract(tube, kinds, weights={0: 10.0, 1: 5.0, 2: 1.0}, stem=None,
    ...                      method="slbc", max_iterations=2,
    ...                      callback=lambda i, ratio, points: print(i, ratio < 1))
    1 True
    2 True
    """
    points, labels = _points_and_labels(cloud, labels)
    if "preset" in constants:
        published = "lbc" if labels is None or weights == {} else "slbc"
        method = _renamed(published, preset=constants.pop("preset"))
    options = SkeletonOptions(method, **constants)
    if callback is not None and method == "limbs":
        raise ValueError("limbs do not iterate: a callback needs method='slbc' or 'lbc'")
    if method == "slbc" and labels is None:
        raise ValueError("method='slbc' needs labels; without them it is method='lbc'")
    if weights is None:
        weights = {} if labels is None or stem is None else {int(stem): 10.0}
    if not isinstance(weights, Mapping):
        raise ValueError("weights must map classes to lambdas, as {1: 10.0}")
    if any(not weight > 0 for weight in weights.values()):
        raise ValueError(f"weights must be positive, got {dict(weights)}")
    if weights and labels is None:
        raise ValueError("weights need labels")
    contracted, source, *_ = contract_tree(
        points,
        labels,
        weights=weights,
        options=options,
        stem=stem,
        voxel_size=voxel_size,
        callback=callback,
    )
    return contracted, source


def skeletonize(
    cloud: PointCloud | np.ndarray,
    labels: np.ndarray | None = None,
    *,
    method: str = "limbs",
    weights: dict[str, float] | None = None,
    target_xy: npt.ArrayLike | None = None,
    **options: Any,
) -> Skeleton:
    """The skeleton of a tree: wood chosen, contracted, connected, rooted and measured.

    Parameters
    ----------
    cloud : array-like of shape (n_points, 3), open3d.geometry.PointCloud or PointCloud
        Metres, z up; ground and neighbouring trees may be in it where labels tell them.
    labels : array-like of shape (n_points,), int, optional
        `cherrypicker.classes.Label`; a PointCloud's field ``label`` by default, else all branch.
    method : {"limbs", "slbc", "lbc"}
        The limbs of the wood, joined; or its contraction, semantic or plain, and the minimum
        spanning tree.
    weights : dict of str to float, optional
        Lambda by class name for "slbc", 10 for the trunk if left out.
    target_xy : array-like of 2 floats, optional
        Where the tree stands; left out, the wood decides.
    **options
        Of `cherrypicker.limbs.orchard.GrowthOptions`: ``classes``, ``voxel_size_m``,
        ``max_points``, ...

    Returns
    -------
    Skeleton
        Nodes with parents, radii and classes.

    Raises
    ------
    ValueError
        If the shapes do not fit.
    StageError
        If there is too little wood.

    Examples
    --------
    >>> import numpy as np
    >>> from cherrypicker.api import skeletonize
    >>> rng = np.random.default_rng(0)
    >>> angle, z = rng.uniform(0, 2 * np.pi, 6000), rng.uniform(0, 1, 6000)
    >>> stem = np.column_stack([0.04 * np.cos(angle), 0.04 * np.sin(angle), z])
    >>> skeleton = skeletonize(stem, np.ones(6000, int))
    >>> round(float(np.median(skeleton.radius)), 3), len(np.flatnonzero(skeleton.degree == 1))
    (0.04, 2)
    """
    points, labels = _points_and_labels(cloud, labels)
    old = {name: options.pop(name) for name in ("preset", "graph") if name in options}
    if old:
        method = _renamed("slbc" if method == "limbs" else method, **old)
    if labels is None:
        labels = np.full(len(points), int(Label.BRANCH))
    whole = PointCloud(points, fields={"label": labels.astype(np.uint8)}, frame="metric", unit="m")
    contracted, report = contract_wood(
        whole,
        GrowthOptions(**options),
        options=SkeletonOptions(method, {"trunk": 10.0} if weights is None else weights),
        target_xy=target_xy,
    )
    return extract_skeleton(contracted, whole, base=report["base"], limbs=report["limbs"])


def _renamed(published: str, **old: str) -> str:
    """The method that the parameters of the last release stand for, with a warning."""
    method = "limbs" if {"default", "tree"} & set(old.values()) else published
    said = ", ".join(f"{name}={value!r}" for name, value in old.items())
    warnings.warn(f"{said} is now method={method!r}", DeprecationWarning, stacklevel=3)
    return method


def _points_and_labels(cloud: PointCloud | np.ndarray, labels: np.ndarray | None) -> tuple:
    """Points (n, 3) float64 and labels (n,) int64 or None, from any kind of cloud."""
    if isinstance(cloud, PointCloud) and labels is None and "label" in cloud:
        labels = cloud["label"]
    points = np.array(getattr(cloud, "points", cloud), dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points must have shape (N, 3), got {points.shape}")
    if len(points) == 0 or not np.isfinite(points).all():
        raise ValueError("points must be finite, and there must be some")
    if labels is None:
        return points, None
    labels = np.asarray(labels)
    if labels.shape != (len(points),):
        raise ValueError(f"labels must have shape ({len(points)},), got {labels.shape}")
    return points, labels.astype(np.int64)
