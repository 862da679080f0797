"""From a labelled cloud, or from one tree alone, to the contracted points of its wood."""

import logging
from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt

from cherrypicker.classes import CLASS_IDS, Label
from cherrypicker.contraction.contract_points import SkeletonOptions, contract_points
from cherrypicker.errors import StageError
from cherrypicker.geometry.sampling import majority_label, thin_to_limit
from cherrypicker.limbs.growth import grow_limbs
from cherrypicker.limbs.joints import points_on_axes
from cherrypicker.limbs.orchard import Orchard, grow_orchard
from cherrypicker.placement.footprint import Footprint
from cherrypicker.pointcloud import PointCloud
from cherrypicker.wood.target_wood import lowest_base, select_target_wood
from cherrypicker.wood.thinned import FEWEST_WOOD, GrowthOptions, agreed_labels

logger = logging.getLogger(__name__)


def contract_wood(
    cloud: PointCloud,
    chosen: GrowthOptions | None = None,
    *,
    options: SkeletonOptions | None = None,
    target_xy: npt.ArrayLike | None = None,
    region: Footprint | None = None,
    orchard: Orchard | None = None,
) -> tuple[PointCloud, dict]:
    """Choose the target's wood and contract it.

    The cloud has the field ``label``, z up. Place and region are as of
    `cherrypicker.wood.target.choose_target`; wood at the region's border is taken to come from
    trees outside. Without an orchard, the limbs of the cloud's trees, they are grown here.

    The contracted points have the fields ``label`` and ``source`` (row in `cloud`). In the report
    ``choice`` is the `Choice` of the target, ``owner`` the stem of each point of wood and ``limbs``
    the `Limbs` of the contracted points, None where the method is not "limbs"; all else is plain. A
    `StageError` where there is too little wood or the contraction fails.
    """
    chosen = chosen or GrowthOptions()
    options = options or SkeletonOptions()
    labels = np.asarray(cloud["label"])
    if orchard is None:
        orchard = grow_orchard(cloud, chosen, region=region)
    choice, wood = select_target_wood(
        cloud.points, orchard, chosen, target_xy=target_xy, region=region
    )
    stem = choice.target.stem
    is_wood = np.isin(labels, chosen.classes)
    rows = np.flatnonzero(is_wood & (orchard.owner == stem))
    if len(rows) < FEWEST_WOOD:
        raise StageError(
            f"only {len(rows)} wood points belong to the target tree", key="crop.target_xy"
        )
    limbs = None
    if options.method != "limbs":
        points, source, label, details = contract_tree(
            cloud.points[rows],
            labels[rows],
            weights={CLASS_IDS[name]: weight for name, weight in options.weights.items()},
            options=options,
            voxel_size=chosen.voxel_size_m,
            max_points=chosen.max_points,
        )
        assert label is not None  # it was given labels
        source = rows[source]
    else:
        source = orchard.entered[stem]
        source = source[is_wood[source]]
        limbs = orchard.limbs_of(stem, source)
        if limbs is None:
            raise StageError(
                f"{len(rows)} points make no limb", key="contract.classes, contract.voxel_size_m"
            )
        points = points_on_axes(cloud.points[source], limbs.member, limbs.limbs, limbs.spacing)
        label = labels[source]
        details = limbs.report() | {"n_contracted": len(source)}
    contracted = PointCloud(
        points,
        fields={"label": label.astype(np.uint8), "source": source.astype(np.int32)},
        frame=cloud.frame,
        unit=cloud.unit,
    )
    report = {
        "unit": cloud.unit,
        "stem": stem,
        "base": choice.target.base,
        "method": options.method,
        **details,
        "wood": wood,
        "choice": choice,
        "limbs": limbs,
        "owner": orchard.owner,
    }
    return contracted, report


def contract_tree(
    points: np.ndarray,
    labels: np.ndarray | None,
    *,
    weights: Mapping[int, float],
    options: SkeletonOptions,
    stem: int | None = Label.TRUNK,
    voxel_size: float | None = None,
    max_points: int | None = None,
    callback: Callable | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, dict]:
    """Contract all points of one tree; a `StageError` where they cannot be.

    The methods "lbc" and "slbc" run the published iteration on the points, or on the means of their
    voxels, with the class of most points of a voxel. The method "limbs" moves points of the cloud
    itself, one a voxel, to the axes of their limbs, and its classes agree with those around them.

    Points (n_points, 3) are in metres, z up; classes (n_points,) are any integers, or none. Weights
    are the lambdas by class for "slbc", 1 for classes that are not named. The points of the class
    `stem` are one stem, for the limbs; None: no class is. With a voxel size the points are thinned
    to one a voxel, of this edge or as large as leaves `max_points`. The callback is as in
    `contract_points`; limbs do not iterate.

    Returns the contracted points (n, 3), float64; the row of the tree's points that each comes
    from, (n,) int64, increasing; its class, (n,) int64, None without classes; and how it went,
    plain values.
    """
    thin, source, label = points, np.arange(len(points)), labels
    if voxel_size is not None:
        limit = len(points) if max_points is None else max_points
        thin, source, member, voxel_size = thin_to_limit(points, voxel_size, limit)
        label = None if labels is None else majority_label(labels, member, len(thin))
        voxels = f"voxels of {1000 * voxel_size:.1f} mm"
        logger.info(f"thinned {len(points):,} to {len(thin):,} points ({voxels})")
    details: dict = {"voxel_size": voxel_size, "n_contracted": len(thin)}
    if options.method == "limbs":
        label = None if label is None else agreed_labels(thin, label)
        in_stem = np.zeros(len(thin), bool) if label is None or stem is None else label == stem
        base = lowest_base(thin, np.where(in_stem, Label.TRUNK, Label.BRANCH)).base
        found = grow_limbs(points[source], base, stem=in_stem)
        moved = points_on_axes(points[source], found.member, found.limbs, found.spacing)
        return moved, source, label, details | found.report()
    lambdas = None
    if options.method == "slbc" and label is not None:
        lambdas = np.ones(len(thin))
        for number, weight in weights.items():
            lambdas[label == number] = weight
    result = contract_points(thin, lambdas, options, callback)
    ratios = [round(value, 6) for value in result.mass_ratio]
    return result.points, source, label, details | {"mass_ratio": ratios, "stop": result.stop}
