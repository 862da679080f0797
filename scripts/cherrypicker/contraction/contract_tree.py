"""From the points of one tree to its skeleton points: thinned, given a class each, contracted."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from cherrypicker.classes import Label
from cherrypicker.contraction.contract_points import SkeletonOptions, contract_points
from cherrypicker.contraction.on_axes import points_on_axes
from cherrypicker.geometry.sampling import majority_label, thin_to_limit
from cherrypicker.limbs.growth import grow_limbs
from cherrypicker.wood.target_wood import lowest_base
from cherrypicker.wood.thinned import agreed_labels

__all__ = ["ContractedTree", "contract_tree"]

logger = logging.getLogger(__name__)


class ContractedTree(NamedTuple):
    """Skeleton points of a tree.

    Attributes
    ----------
    points : ndarray of shape (n, 3), float64
    source : ndarray of shape (n,), int64
        Row of the tree's points that each comes from, increasing.
    label : ndarray of shape (n,), int64, or None
        Class of each; None where the tree has none.
    details : dict
        How it went; plain values.
    """

    points: np.ndarray
    source: np.ndarray
    label: np.ndarray | None
    details: dict


def contract_tree(
    points: np.ndarray,
    labels: np.ndarray | None = None,
    *,
    weights: Mapping[int, float] | None = None,
    options: SkeletonOptions,
    stem: int | None = Label.TRUNK,
    voxel_size: float | None = None,
    max_points: int | None = None,
    callback: Callable | None = None,
) -> ContractedTree:
    """Contract all points of one tree.

    The methods "lbc" and "slbc" run the published iteration on the points, or on the means of their
    voxels, with the class of most points of a voxel. The method "limbs" moves points of the cloud
    itself, one a voxel, to the axes of their limbs, and its classes agree with those around them.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
        Metres, z up.
    labels : ndarray of shape (n_points,), int, optional
        Class of each point, any integers.
    weights : mapping of int to float, optional
        Lambda by class for "slbc"; classes that are not named weigh 1.
    options : SkeletonOptions
    stem : int or None
        Class whose points are one stem, for the limbs; None: no class is.
    voxel_size : float, optional
        Thin to one point a voxel, of this edge or as large as leaves `max_points`.
    max_points : int, optional
    callback : callable, optional
        As in `contract_points`; limbs do not iterate.

    Returns
    -------
    ContractedTree

    Raises
    ------
    StageError
        If the points cannot be contracted.
    """
    thin, source, label = points, np.arange(len(points)), labels
    if voxel_size is not None:
        limit = len(points) if max_points is None else max_points
        thin, source, member, voxel_size = thin_to_limit(points, voxel_size, limit)
        label = None if labels is None else majority_label(labels, member, len(thin))
        logger.info(
            "thinned %s to %s points (voxels of %.1f mm)",
            f"{len(points):,}",
            f"{len(thin):,}",
            1000 * voxel_size,
        )
    details: dict = {"voxel_size": voxel_size, "n_contracted": len(thin)}
    if options.method == "limbs":
        label = None if label is None else agreed_labels(thin, label)
        in_stem = np.zeros(len(thin), bool) if label is None or stem is None else label == stem
        base = lowest_base(thin, np.where(in_stem, Label.TRUNK, Label.BRANCH)).base
        found = grow_limbs(points[source], base, stem=in_stem)
        moved = points_on_axes(points[source], found)
        return ContractedTree(moved, source, label, details | found.report())
    lambdas = None
    if options.method == "slbc" and label is not None:
        lambdas = np.ones(len(thin))
        for number, weight in (weights or {}).items():
            lambdas[label == number] = weight
    result = contract_points(thin, lambdas, options, callback)
    ratios = [round(value, 6) for value in result.mass_ratio]
    return ContractedTree(
        result.points, source, label, details | {"mass_ratio": ratios, "stop": result.stop}
    )
