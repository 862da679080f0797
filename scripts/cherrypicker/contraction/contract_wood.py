"""From a labelled cloud to the contracted points of the target tree's wood."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from cherrypicker.classes import CLASS_IDS, CLASS_NAMES, WOOD, Label
from cherrypicker.contraction.contract_points import ContractionOptions
from cherrypicker.contraction.contract_tree import agreed_labels, contract_tree
from cherrypicker.errors import StageError
from cherrypicker.geometry.sampling import majority_label, thin_to_limit
from cherrypicker.placement.footprint import Footprint
from cherrypicker.pointcloud import PointCloud
from cherrypicker.wood.density import dense_enough
from cherrypicker.wood.gaps import GAP_M, STEM_GAP_M
from cherrypicker.wood.target_wood import TargetWood, select_target_wood

__all__ = ["WoodOptions", "contract_wood"]

logger = logging.getLogger(__name__)

FEWEST_WOOD = 50
SELECTION_FACTOR = 2  # the selection may look at this many times the points of the contraction


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
    labels = np.asarray(cloud["label"])
    rows = np.flatnonzero(np.isin(labels, list(chosen.classes)))
    names = ", ".join(CLASS_NAMES.get(int(index), str(index)) for index in chosen.classes)
    if len(rows) < FEWEST_WOOD:
        raise StageError(
            f"the cloud holds {len(rows)} points of the classes to contract ({names})",
            key="contract.classes, segment",
        )
    options = options or ContractionOptions()
    weights = _weights_by_id(chosen.weights)
    min_density = 0.0 if options.preset == "paper" else chosen.min_density
    rows, wood = _target_rows(
        cloud.points,
        labels,
        rows,
        chosen.voxel_size_m,
        chosen.max_points,
        min_density,
        target_xy=target_xy,
        region=region,
        gap_m=chosen.gap_m,
        stem_gap_m=chosen.stem_gap_m,
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


def _target_rows(
    points: np.ndarray,
    labels: np.ndarray,
    rows: np.ndarray,
    size: float,
    max_points: int,
    min_density: float,
    **options: Any,
) -> tuple[np.ndarray, TargetWood]:
    """Rows of the cloud that are the target's wood, and the `TargetWood` that they come from."""
    most = SELECTION_FACTOR * max_points
    thin, _, member, used = thin_to_limit(points[rows], size, most)
    if min_density > 0:
        dense = dense_enough(thin, np.bincount(member), used, min_density)
        rows = rows[dense[member]]
        thin, _, member, _ = thin_to_limit(points[rows], used, most)
    ground = points[labels == Label.GROUND]
    label = agreed_labels(thin, majority_label(labels[rows], member, len(thin)))
    wood = select_target_wood(thin, label, ground=ground, **options)
    rows = rows[wood.keep[member]]
    if len(rows) < FEWEST_WOOD:
        raise StageError(
            f"only {len(rows)} wood points belong to the target tree", key="crop.target_xy"
        )
    return rows, wood
