"""From a labelled cloud to the contracted points of the target tree's wood."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from cherrypicker.classes import CLASS_IDS, Label
from cherrypicker.contraction.contract_points import ContractionOptions
from cherrypicker.contraction.contract_tree import agreed_labels, contract_tree
from cherrypicker.errors import StageError
from cherrypicker.placement.footprint import Footprint
from cherrypicker.pointcloud import PointCloud
from cherrypicker.wood.target_wood import select_target_wood
from cherrypicker.wood.thinned import FEWEST_WOOD, WoodChoice, thinned_wood

__all__ = ["WoodOptions", "contract_wood"]

logger = logging.getLogger(__name__)

SELECTION_FACTOR = 2  # the selection may look at this many times the points of the contraction


@dataclass(frozen=True)
class WoodOptions(WoodChoice):
    """Which wood is contracted, and how it weighs; the fields are config keys of ``contract``.

    Classes without a weight weigh 1.
    """

    weights: dict[str, float] = field(default_factory=lambda: {"trunk": 10.0})
    method: str = "slbc"
    max_points: int = 100_000


def contract_wood(
    cloud: PointCloud,
    chosen: WoodOptions | None = None,
    *,
    options: ContractionOptions | None = None,
    target_xy: npt.ArrayLike | None = None,
    region: Footprint | None = None,
) -> tuple[PointCloud, dict]:
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
        ``choice`` is the `Choice` of the target and ``limbs`` the `Limbs` that a graph needs not
        grow again, None where there are none; all else is plain.

    Raises
    ------
    StageError
        If there is too little wood or the contraction fails.
    """
    chosen = chosen or WoodOptions()
    options = options or ContractionOptions()
    weights = _weights_by_id(chosen.weights)
    labels = np.asarray(cloud["label"])
    thin, thin_labels, rows, member = thinned_wood(
        cloud,
        chosen,
        SELECTION_FACTOR * chosen.max_points,
        min_density=0.0 if options.preset == "paper" else None,
    )
    wood = select_target_wood(
        thin,
        agreed_labels(thin, thin_labels),
        ground=cloud.points[labels == Label.GROUND],
        target_xy=target_xy,
        region=region,
        gap_m=chosen.gap_m,
        stem_gap_m=chosen.stem_gap_m,
    )
    rows = rows[wood.keep[member]]
    if len(rows) < FEWEST_WOOD:
        raise StageError(
            f"only {len(rows)} wood points belong to the target tree", key="crop.target_xy"
        )
    base = np.round(wood.base, 6)  # as it is written down: the graph starts from the same
    tree = contract_tree(
        cloud.points[rows],
        labels[rows],
        base,
        weights=weights if chosen.method == "slbc" else None,
        options=options,
        voxel_size=chosen.voxel_size_m,
        max_points=chosen.max_points,
    )
    assert tree.label is not None  # it was given labels
    source = rows[tree.source]
    contracted = PointCloud(
        tree.points,
        fields={"label": tree.label.astype(np.uint8), "source": source.astype(np.int32)},
        frame=cloud.frame,
        unit=cloud.unit,
    )
    report = {
        "unit": cloud.unit,
        "base": base.tolist(),
        "method": chosen.method,
        **tree.details,
        "wood": wood.report,
        "choice": wood.choice,
        # LBC looks at no labels, a graph does
        "limbs": tree.limbs if chosen.method == "slbc" else None,
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
