"""From a labelled cloud to the contracted points of the target tree's wood."""

import logging
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import CLASS_IDS, CLASS_NAMES, WOOD, Label
from cherrypicker.contraction.contract_points import ContractionOptions, contract_points
from cherrypicker.contraction.on_axes import move_to_axes
from cherrypicker.errors import StageError
from cherrypicker.geometry.sampling import majority_label, thin_to_limit
from cherrypicker.pointcloud import PointCloud
from cherrypicker.wood.gaps import GAP_M, STEM_GAP_M
from cherrypicker.wood.target_wood import select_target_wood

__all__ = ["WoodOptions", "class_weights", "contract_wood"]

logger = logging.getLogger(__name__)

FEWEST_WOOD = 50
N_AROUND = 13  # a point and twelve neighbours, whose most frequent class is its own (guess)
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
    table = np.ones(256)
    for name, weight in weights.items():
        if name not in CLASS_IDS:
            raise StageError(
                f"unknown class {name!r} (known: {', '.join(CLASS_IDS)})", key="contract.weights"
            )
        if not weight > 0:
            raise StageError(f"the weight of {name} must be positive", key="contract.weights")
        table[CLASS_IDS[name]] = weight
    return table[np.asarray(labels, dtype=np.int64)]


@dataclass(frozen=True)
class WoodOptions:
    """Which wood is contracted, and how it weighs; the fields are config keys of ``contract``.

    Classes without a weight weigh 1.
    """

    classes: tuple[int, ...] = WOOD
    weights: dict[str, float] = field(default_factory=lambda: {"trunk": 10.0})
    method: str = "slbc"
    voxel_size_m: float = 0.005
    max_points: int = 100_000
    gap_m: float = GAP_M
    stem_gap_m: float = STEM_GAP_M
    min_density: float = 0.05


def contract_wood(cloud, chosen=None, *, options=None, target_xy=None, region=None):
    """Choose the target's wood, thin it and contract it.

    Parameters
    ----------
    cloud : PointCloud
        With the field ``label``, z up.
    chosen : WoodOptions, optional
    options : ContractionOptions, optional
    target_xy : array-like of 2 floats, optional
        Where the target stands; left out, the wood decides.
    region : Footprint, optional
        Of the region of interest (trees from photos). With it, nearness to its middle counts, and
        wood at its border is taken to come from trees outside.

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
    chosen = chosen or WoodOptions()
    labels = np.asarray(cloud["label"])
    rows = np.flatnonzero(np.isin(labels, list(chosen.classes)))
    names = ", ".join(CLASS_NAMES.get(int(index), str(index)) for index in chosen.classes)
    if len(rows) < FEWEST_WOOD:
        raise StageError(
            f"the cloud holds {len(rows)} points of the classes to contract ({names})",
            key="contract.classes, segment",
        )
    options = options or ContractionOptions()
    if options.preset == "paper":
        chosen = replace(chosen, min_density=0.0)  # the paper knows no such filter
    weight_of = class_weights(np.arange(256), chosen.weights)
    rows, wood = _target_rows(
        cloud.points,
        labels,
        rows,
        chosen.voxel_size_m,
        chosen.max_points,
        chosen.min_density,
        target_xy=target_xy,
        region=region,
        gap_m=chosen.gap_m,
        stem_gap_m=chosen.stem_gap_m,
    )
    base = wood.base
    points, source, member, size = thin_to_limit(
        cloud.points[rows], chosen.voxel_size_m, chosen.max_points
    )
    label = _agreed(points, labels[rows], member)
    source = rows[source]
    logger.info(
        "thinned %s to %s points (voxels of %.1f mm)",
        f"{len(rows):,}",
        f"{len(points):,}",
        1000 * size,
    )
    if options.preset == "default":
        stem = label == Label.TRUNK if chosen.method == "slbc" else None
        moved, found = move_to_axes(cloud.points[source], base, stem=stem)
        details = {
            "n_limbs": len(found.limbs),
            "spacing": round(found.spacing, 6),
            "noise": round(found.noise, 6),
            "claimed": round(found.claimed, 4),
        }
    else:
        result = contract_points(
            points, weight_of[label] if chosen.method == "slbc" else None, options
        )
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
        "method": chosen.method,
        "voxel_size": float(size),
        "n_contracted": len(points),
        **details,
        "wood": wood.report,
        "choice": wood.choice,
    }
    return contracted, report


def _agreed(thin, labels, member):
    """Class of each thinned point: that of most points of its voxel, then of most around it.

    A class is a class of a place: a lone label of the stem far out would let the wood there be
    taken for a piece of the stem.
    """
    label = majority_label(labels, member, len(thin))
    around = cKDTree(thin).query(thin, k=min(N_AROUND, len(thin)))[1].reshape(len(thin), -1)
    return majority_label(
        label[around].ravel(), np.repeat(np.arange(len(thin)), around.shape[1]), len(thin)
    )


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
    thin, _, member, size = thin_to_limit(points[rows], size, SELECTION_FACTOR * max_points)
    dense = _dense_enough(thin, np.bincount(member), size, min_density)
    rows = rows[dense[member]]
    thin, _, member, _ = thin_to_limit(points[rows], size, SELECTION_FACTOR * max_points)
    ground = points[labels == Label.GROUND]
    label = _agreed(thin, labels[rows], member)
    wood = select_target_wood(thin, label, ground=ground, **options)
    rows = rows[wood.keep[member]]
    if len(rows) < FEWEST_WOOD:
        raise StageError(
            f"only {len(rows)} wood points belong to the target tree", key="crop.target_xy"
        )
    return rows, wood
