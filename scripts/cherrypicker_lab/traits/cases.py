"""Cases that the intervals of traits are fitted to: found values beside true ones.

A case is one trait of one tree, or of one of its branches: what was found, the truth, the 90 %
interval given, and what its error follows (the terms of `cherrypicker.traits.intervals`).
"""

from pathlib import Path

import numpy as np

from cherrypicker.files import read_json
from cherrypicker.geometry.hulls import hull_of
from cherrypicker.skeleton import axes, read_skeleton, read_skeleton_csv
from cherrypicker.skeleton.axis_radii import typical_scatter
from cherrypicker.traits.branches import axis_shapes, read_branches
from cherrypicker.traits.intervals import branch_terms
from cherrypicker.traits.measure import TraitOptions
from cherrypicker.traits.reports import Reports
from cherrypicker.traits.scaffold import Scaffold
from cherrypicker_lab.evaluation import cameras_beside_truth
from cherrypicker_lab.orchard.truth import TRUNK_HEIGHT_M, width_of_wood
from cherrypicker_lab.traits.pairs import (
    LEAST_DIAMETER_M,
    branch_pair,
    matched_rows,
)

BRANCH_TRAITS = ("base_diameter_m", "insertion_angle_deg")


def scan_cases(source, results, truth):
    """Cases, see `tree_cases`, of a finished scan from photos, ``results/{tree}``.

    The source is the name of the set of scans that it belongs to; the scene's truth has
    ``poses.npz`` and ``skeleton.csv``.
    """
    results, truth = Path(results), Path(truth)
    traits, rows = read_json(results / "traits.json"), read_branches(results / "branches.csv")
    whole = whole_truth(read_skeleton_csv(truth / "skeleton.csv"))
    skeleton, true = scan_and_truth(results, truth)
    error = Reports(scale=read_json(results / "scale.json")).scale_error
    return tree_cases(source, results.name, whole, true, skeleton, traits, rows, error)


def scan_and_truth(results, truth):
    """Skeleton of a finished scan from photos and the true one in its frame, as of `scan_cases`."""
    true = read_skeleton_csv(truth / "skeleton.csv")
    frame = cameras_beside_truth(results, truth)["frame"]
    true.points = (true.points - frame[:3, 3]) @ frame[:3, :3]
    return read_skeleton(results / "skeleton.graphml"), true


def true_scaffold(skeleton):
    """The stem and the limbs of a true skeleton."""
    return Scaffold(skeleton, least=TraitOptions().min_limb_m)


def true_volume(skeleton):
    """Volume of the convex hull of the wood's surface beyond the stem's lowest limb."""
    height, turn = np.radians(np.mgrid[-90:91:30, 0:360:30].reshape(2, -1))
    around = np.column_stack(
        [np.cos(height) * np.cos(turn), np.cos(height) * np.sin(turn), np.sin(height)]
    )
    rows = ~true_scaffold(skeleton).clear_stem()
    if not rows.any():
        return 0.0
    surface = skeleton.points[rows, None] + skeleton.radius[rows, None, None] * around
    return hull_of(surface.reshape(-1, 3)).volume


def whole_truth(skeleton):
    """True traits of a whole tree from its skeleton, whose root is the stem's foot, z up."""
    points, radius, foot = skeleton.points, skeleton.radius, skeleton.points[0, 2]
    own = axes(skeleton)
    stem = own[0].nodes
    up = np.maximum.accumulate(points[stem, 2]) - foot
    return {
        "height_m": float((points[:, 2] + radius).max() - foot),
        "trunk_diameter_m": float(2 * np.interp(TRUNK_HEIGHT_M, up, radius[stem])),
        "crown_width_m": width_of_wood(points, radius),
        "crown_volume_m3": true_volume(skeleton),
        "total_length_m": float(skeleton.edge_length.sum()),
        "n_shoots": len(own) - 1,
        "wood_volume_m3": float(axis_shapes(skeleton, own)["volume_m3"].sum()),
    }


def tree_cases(source, name, whole, truth, skeleton, traits, rows, scale_error=0.0):
    """All cases of a tree.

    `whole` is of `whole_truth`, both skeletons are in one frame, and traits and rows are from
    `measure_traits`, or its files. A case has `source`, `tree`, `trait`, `true`, `found`, `low`,
    `high`, and `terms`: name to what the error follows, `drawn_low` and `drawn_high` among them
    (None where the photos gave the interval of a branch), and `at_least`, where more is known to be
    missing.
    """
    cases = []
    for trait, true in whole.items():
        if f"{trait}_ci90" in traits:
            low, high = traits[f"{trait}_ci90"]
            terms, least = traits["interval_terms"][trait], trait in traits["at_least"]
            cases.append((trait, true, traits[trait], low, high, terms, least))
    typical = typical_scatter(skeleton)
    if typical is None:
        return [_named(source, name, case) for case in cases]
    terms = branch_terms(axis_shapes(skeleton, axes(skeleton)), typical, scale_error)
    for true, found in matched_rows(truth, skeleton, rows):
        for trait in BRANCH_TRAITS:
            if trait == "base_diameter_m" and true[trait] < LEAST_DIAMETER_M:
                continue
            pair = branch_pair(true, found, trait)
            own = {k: float(v[found["branch_id"]]) for k, v in terms[trait].items()}
            if trait == "base_diameter_m" and found["photo_diameter_m"] is not None:
                own = None
            cases.append((trait, *pair.values(), own, False))
    return [_named(source, name, case) for case in cases]


def _named(source, name, case):
    names = ("trait", "true", "found", "low", "high", "terms", "at_least")
    return {"source": source, "tree": name, **dict(zip(names, case, strict=True))}
