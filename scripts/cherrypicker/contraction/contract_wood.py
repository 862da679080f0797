"""From a labelled cloud to the contracted points of the target tree's wood."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from cherrypicker.classes import CLASS_IDS
from cherrypicker.contraction.contract_points import ContractionOptions
from cherrypicker.contraction.contract_tree import contract_tree
from cherrypicker.contraction.on_axes import points_on_axes
from cherrypicker.errors import StageError
from cherrypicker.limbs.orchard import GrowthOptions, Orchard, grow_orchard
from cherrypicker.placement.footprint import Footprint
from cherrypicker.pointcloud import PointCloud
from cherrypicker.wood.target_wood import select_target_wood
from cherrypicker.wood.thinned import FEWEST_WOOD

__all__ = ["WoodOptions", "contract_wood"]


@dataclass(frozen=True)
class WoodOptions(GrowthOptions):
    """Which wood is contracted, and how it weighs; the fields are config keys of ``contract``.

    Classes without a weight weigh 1.
    """

    weights: dict[str, float] = field(default_factory=lambda: {"trunk": 10.0})
    method: str = "slbc"


def contract_wood(
    cloud: PointCloud,
    chosen: WoodOptions | None = None,
    *,
    options: ContractionOptions | None = None,
    target_xy: npt.ArrayLike | None = None,
    region: Footprint | None = None,
    orchard: Orchard | None = None,
) -> tuple[PointCloud, dict]:
    """Choose the target's wood and contract it.

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
    orchard : Orchard, optional
        The limbs of the cloud's trees; left out, they are grown here.

    Returns
    -------
    contracted : PointCloud
        With the fields ``label`` and ``source`` (row in `cloud`).
    report : dict
        ``choice`` is the `Choice` of the target and ``limbs`` the `Limbs` of the contracted points,
        None with the preset "paper"; all else is plain.

    Raises
    ------
    StageError
        If there is too little wood or the contraction fails.
    """
    chosen = chosen or WoodOptions()
    options = options or ContractionOptions()
    weights = _weights_by_id(chosen.weights)
    labels = np.asarray(cloud["label"])
    if orchard is None:
        least = 0.0 if options.preset == "paper" else chosen.min_density
        orchard = grow_orchard(cloud, replace(chosen, min_density=least), region=region)
    wood = select_target_wood(
        cloud.points,
        orchard,
        target_xy=target_xy,
        region=region,
        gap_m=chosen.gap_m,
        stem_gap_m=chosen.stem_gap_m,
    )
    stem = wood.choice.target.stem
    is_wood = np.isin(labels, chosen.classes)
    rows = np.flatnonzero(is_wood & wood.keep)
    if len(rows) < FEWEST_WOOD:
        raise StageError(
            f"only {len(rows)} wood points belong to the target tree", key="crop.target_xy"
        )
    if options.preset == "paper":
        tree = contract_tree(
            cloud.points[rows],
            labels[rows],
            wood.base,
            weights=weights if chosen.method == "slbc" else None,
            options=options,
            voxel_size=chosen.voxel_size_m,
            max_points=chosen.max_points,
        )
        assert tree.label is not None  # it was given labels
        source, points, label, limbs = rows[tree.source], tree.points, tree.label, None
        details = tree.details
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
        "base": wood.base.tolist(),
        "method": chosen.method,
        **details,
        "wood": wood.report,
        "choice": wood.choice,
        "limbs": limbs,
    }
    return contracted, report


def _weights_by_id(weights: Mapping[str, float]) -> dict[int, float]:
    """Lambda by class id from lambda by class name."""
    for name, weight in weights.items():
        if name not in CLASS_IDS:
            raise StageError(
                f"unknown class {name!r} (known: {', '.join(CLASS_IDS)})", key="contract.weights"
            )
        if not weight > 0:
            raise StageError(f"the weight of {name} must be positive", key="contract.weights")
    return {CLASS_IDS[name]: weight for name, weight in weights.items()}
