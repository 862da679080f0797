"""From a labelled cloud to the contracted points of the target tree's wood."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from cherrypicker.contraction.contract_points import SkeletonOptions
from cherrypicker.contraction.contract_tree import contract_tree
from cherrypicker.contraction.on_axes import points_on_axes
from cherrypicker.errors import StageError
from cherrypicker.limbs.orchard import GrowthOptions, Orchard, grow_orchard
from cherrypicker.placement.footprint import Footprint
from cherrypicker.pointcloud import PointCloud
from cherrypicker.wood.target_wood import select_target_wood
from cherrypicker.wood.thinned import FEWEST_WOOD

__all__ = ["contract_wood"]


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

    Parameters
    ----------
    cloud : PointCloud
        With the field ``label``, z up.
    chosen : GrowthOptions, optional
    options : SkeletonOptions, optional
    target_xy : array-like of 2 floats, optional
        Where the target stands; left out, the wood decides.
    region : Footprint, optional
        Of the region of interest (trees from photos). With it, nearness to its middle counts, and
        wood at its border is taken to come from trees outside.
    orchard : Orchard, optional
        The limbs of the cloud's trees; left out, they are grown here.

    Returns
    -------
    contracted : PointCloud
        With the fields ``label`` and ``source`` (row in `cloud`).
    report : dict
        ``choice`` is the `Choice` of the target, ``owner`` the stem of each point of wood and
        ``limbs`` the `Limbs` of the contracted points, None where the method is not "limbs"; all
        else is plain.

    Raises
    ------
    StageError
        If there is too little wood or the contraction fails.
    """
    chosen = chosen or GrowthOptions()
    options = options or SkeletonOptions()
    labels = np.asarray(cloud["label"])
    if orchard is None:
        orchard = grow_orchard(cloud, chosen, region=region)
    choice, wood = select_target_wood(
        cloud.points,
        orchard,
        target_xy=target_xy,
        region=region,
        gap_m=chosen.gap_m,
        stem_gap_m=chosen.stem_gap_m,
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
            weights=options.lambdas,
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
        points, label = points_on_axes(cloud.points[source], limbs), labels[source]
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
