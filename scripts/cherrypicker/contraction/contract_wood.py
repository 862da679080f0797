"""From a labelled cloud to the contracted points of the target tree's wood."""

import logging

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import CLASS_NAMES, Label
from cherrypicker.contraction.contract_points import contract_points
from cherrypicker.contraction.limbs import recentre_limbs
from cherrypicker.contraction.stem_gap import fill_stem_gaps
from cherrypicker.contraction.tube import recentre_stem
from cherrypicker.errors import StageError
from cherrypicker.geometry.sampling import median_spacing, thin_to_limit
from cherrypicker.pointcloud import PointCloud
from cherrypicker.wood.gaps import GAP_M, STEM_GAP_M
from cherrypicker.wood.target_wood import select_target_wood

__all__ = ["class_weights", "contract_wood"]

logger = logging.getLogger(__name__)

FEWEST_WOOD = 50
N_VOTES = 9
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
    spacing = max(size, median_spacing(points, cKDTree(points)))  # a coarse scan fills no voxels
    filler = fill_stem_gaps(points, label, base, spacing=spacing, stem_gap_m=stem_gap_m)
    entering = np.vstack([points, filler])
    entering_weight = np.concatenate(
        [weight_of[label], np.full(len(filler), weight_of[Label.TRUNK])]
    )
    result = contract_points(entering, entering_weight if method == "slbc" else None, options)
    moved, n_on_axis, n_on_rings = result.points, 0, 0
    if method == "slbc" and options is not None and options.scheme == "adaptive":
        stem = _mostly_trunk(entering, label, len(filler))
        moved = moved.copy()
        moved[stem], is_moved = recentre_stem(entering[stem], moved[stem], base, spacing=spacing)
        n_on_axis = int(np.count_nonzero(is_moved))
        taken = np.zeros(len(entering), dtype=bool)
        taken[stem] = is_moved
        moved, on_ring = recentre_limbs(entering, moved, base, spacing=spacing, taken=taken)
        n_on_rings = int(np.count_nonzero(on_ring[: len(points)]))
    contracted = PointCloud(
        moved[: len(points)],
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
        "n_filled": len(filler),
        "n_on_stem_axis": n_on_axis,
        "n_on_limb_axes": n_on_rings,
        "mass_ratio": [round(value, 6) for value in result.mass_ratio],
        "stop": result.stop,
        "wood": wood.report,
        "choice": wood.choice,
    }
    return contracted, report


def _mostly_trunk(points, label, n_filled):
    """Points of the stem: most of the points around them are trunk, whatever they are called."""
    is_trunk = np.concatenate([label == Label.TRUNK, np.ones(n_filled, dtype=bool)])
    if not is_trunk.any():
        return is_trunk
    around = cKDTree(points).query(points, k=min(N_VOTES, len(points)))[1]
    return is_trunk[around].mean(axis=1) > 0.5


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
