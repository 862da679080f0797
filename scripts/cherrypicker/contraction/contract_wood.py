"""From a labelled cloud to the contracted points of the target tree's wood."""

import logging

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import CLASS_NAMES, Label
from cherrypicker.contraction.contract_points import contract_points, preset_options
from cherrypicker.contraction.on_axes import move_to_axes
from cherrypicker.errors import StageError
from cherrypicker.geometry.sampling import thin_to_limit
from cherrypicker.pointcloud import PointCloud
from cherrypicker.wood.gaps import GAP_M, STEM_GAP_M
from cherrypicker.wood.target_wood import select_target_wood

__all__ = ["class_weights", "contract_wood"]

logger = logging.getLogger(__name__)

FEWEST_WOOD = 50
SELECTION_FACTOR = 2  # the selection may look at this many times the points of the contraction


def class_weights(labels, weights):
    """Lambda of each point's class.

    Parameters
    ----------
    labels : ndarray of shape (n_points,), int
    weights : dict of str to float
        Class name to lambda; classes that are not named weigh 1.

    Returns
    -------
    ndarray of shape (n_points,), float64

    Raises
    ------
    StageError
        If a name is no class or a weight is not positive.
    """
    number = {name: index for index, name in CLASS_NAMES.items()}
    table = np.ones(256)
    for name, weight in weights.items():
        if name not in number:
            raise StageError(
                f"unknown class {name!r} (known: {', '.join(number)})", key="contract.weights"
            )
        if not weight > 0:
            raise StageError(f"the weight of {name} must be positive", key="contract.weights")
        table[number[name]] = weight
    return table[np.asarray(labels, dtype=np.int64)]


def contract_wood(
    cloud,
    *,
    classes=(1, 2),
    weights=None,
    method="slbc",
    options=None,
    voxel_size_m=0.008,
    max_points=100_000,
    target_xy=None,
    region=None,
    gap_m=GAP_M,
    stem_gap_m=STEM_GAP_M,
    min_density=0.05,
):
    """Choose the target's wood, thin it and contract it.

    Parameters
    ----------
    cloud : PointCloud
        With the field ``label``, z up.
    classes : sequence of int, default (1, 2)
        Classes that enter.
    weights : dict of str to float, optional
        Lambda by class name, trunk 10 by default; unnamed classes weigh 1.
    method : {"slbc", "lbc"}
    options : ContractionOptions, optional
    voxel_size_m : float, default 0.008
        Voxel that the wood is thinned to, enlarged until `max_points` are left.
    max_points : int, default 100000
    target_xy : array-like of 2 floats, optional
        Where the target stands; left out, the wood decides.
    region : Footprint, optional
        Of the region of interest (trees from photos). With it, nearness to its middle counts, and
        wood at its border is taken to come from trees outside.
    gap_m, stem_gap_m : float
        See `select_target_wood`.
    min_density : float, default 0.05
        Share of the median number of points around a voxel that it needs to count as wood.

    Returns
    -------
    contracted : PointCloud
        With the fields ``label`` and ``source`` (row in `cloud`).
    report : dict
        ``choice`` is the `Choice` of the target; all else is plain.

    Raises
    ------
    StageError
        If there is too little wood or the contraction fails.
    """
    labels = np.asarray(cloud["label"])
    rows = np.flatnonzero(np.isin(labels, list(classes)))
    names = ", ".join(CLASS_NAMES.get(int(index), str(index)) for index in classes)
    if len(rows) < FEWEST_WOOD:
        raise StageError(
            f"the cloud holds {len(rows)} points of the classes to contract ({names})",
            key="contract.classes, segment",
        )
    options = options or preset_options()
    if options.scheme == "published":
        min_density = 0.0  # the paper knows no such filter
    weight_of = class_weights(np.arange(256), weights if weights is not None else {"trunk": 10.0})
    rows, wood = _target_rows(
        cloud.points,
        labels,
        rows,
        voxel_size_m,
        max_points,
        min_density,
        target_xy=target_xy,
        region=region,
        gap_m=gap_m,
        stem_gap_m=stem_gap_m,
    )
    base = wood.base
    points, source, _, size = thin_to_limit(
        cloud.points[rows], voxel_size_m, max_points, labels[rows]
    )
    source = rows[source]
    label = labels[source]
    logger.info(
        "thinned %s to %s points (voxels of %.1f mm)",
        f"{len(rows):,}",
        f"{len(points):,}",
        1000 * size,
    )
    if options.scheme == "limbs":
        stem = label == Label.TRUNK if method == "slbc" else None
        moved, found = move_to_axes(cloud.points[source], base, stem=stem)
        details = {
            "n_limbs": len(found.limbs),
            "spacing": round(found.spacing, 6),
            "noise": round(found.noise, 6),
            "claimed": round(found.claimed, 4),
        }
    else:
        result = contract_points(points, weight_of[label] if method == "slbc" else None, options)
        moved = result.points
        details = {
            "mass_ratio": [round(value, 6) for value in result.mass_ratio],
            "stop": result.stop,
        }
    contracted = PointCloud(
        moved,
        fields={"label": label.astype(np.uint8), "source": source.astype(np.int32)},
        frame=cloud.frame,
        unit=cloud.unit,
    )
    report = {
        "unit": cloud.unit,
        "base": [round(float(value), 6) for value in base],
        "method": method,
        "voxel_size": float(size),
        "n_contracted": len(points),
        **details,
        "wood": wood.report,
        "choice": wood.choice,
    }
    return contracted, report


def _dense_enough(points, count, size, min_density):
    """Which voxels hold enough points, with their neighbours, to be wood.

    Stray points of a dense reconstruction float alone; the thinnest twig that it shows still has
    a fair share of the points that thick wood has.
    """
    a, b = cKDTree(points).query_pairs(1.8 * size, output_type="ndarray").T
    n = len(points)
    support = count + np.bincount(a, count[b], n) + np.bincount(b, count[a], n)
    keep = support >= min_density * np.median(support)
    logger.info(
        "kept %s of %s voxels of wood (%.1f %%), the rest too thin (under %.1f points around)",
        f"{np.count_nonzero(keep):,}",
        f"{len(keep):,}",
        100 * keep.mean(),
        min_density * np.median(support),
    )
    return keep


def _target_rows(points, labels, rows, size, max_points, min_density, **options):
    """Rows of the cloud that are the target's wood, and the `TargetWood` that they come from."""
    thin, source, member, size = thin_to_limit(points[rows], size, SELECTION_FACTOR * max_points)
    dense = _dense_enough(thin, np.bincount(member), size, min_density)
    rows = rows[dense[member]]
    thin, source, member, _ = thin_to_limit(points[rows], size, SELECTION_FACTOR * max_points)
    ground = points[labels == Label.GROUND]
    wood = select_target_wood(thin, labels[rows][source], ground=ground, **options)
    rows = rows[wood.keep[member]]
    if len(rows) < FEWEST_WOOD:
        raise StageError(
            f"only {len(rows)} wood points belong to the target tree", key="crop.target_xy"
        )
    return rows, wood
