"""Proposed cuts against the truth: generated trees, known truly and as cameras see them.

What is cut on a seen skeleton is carried to the true one: true wood goes where the seen node that
lies nearest to it went. What is cut on a true skeleton is measured anew.
"""

from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.files import read_json
from cherrypicker.formats.measured import MeasuredTree
from cherrypicker.pruning.made import made_cuts
from cherrypicker.pruning.plan import propose_cuts
from cherrypicker.pruning.standing import StandingTree
from cherrypicker.pruning.target import OWN, PruningOptions, read_presets, resolve_target
from cherrypicker.series.compare import compare_scans
from cherrypicker.skeleton import axes
from cherrypicker.traits.branches import read_branches
from cherrypicker.traits.intervals import Z90
from cherrypicker.traits.limb_table import limb_of_axis
from cherrypicker.traits.measure import TraitOptions, measure_traits
from cherrypicker.traits.reports import Reports
from cherrypicker.traits.table import LIMB_COLUMNS
from cherrypicker_lab.orchard.truth import tree_traits
from cherrypicker_lab.series.judge import numbers_of
from cherrypicker_lab.series.pairs import as_scan, make_date, see_date
from cherrypicker_lab.traits.cases import scan_and_truth, whole_truth
from cherrypicker_lab.traits.pairs import make_tree, skeleton_of
from cherrypicker_lab.traits.table import true_scaffold

LEAST_OVER = 1.1  # of the ratio over the level of severity that is asked for
# Shares of what the tree has that the whole target asks for
SHARES = {"height_m": 0.9, "row_width_m": 0.8, "length_m_per_cm2": 0.6}
N_BY_HAND, OF_THICKEST = 3, 6  # limbs that are cut by hand, and of how many
FOOT_M = 0.03
N_UNASKED, N_MISSED, LEAST_MISSED_M = 3, 5, 0.25  # of a tree that is scanned twice


class Case:
    """A tree that was measured, with its truth.

    Parameters
    ----------
    skeleton, true : Skeleton
        As it is known, and as it is; one and the same, or in one frame.
    found : tuple of dict
        Traits and tables, as of `measure_traits`.
    stem : float
        True diameter of the stem.
    """

    def __init__(self, skeleton, true, found, stem):
        self.skeleton, self.true, self.is_true = skeleton, true, skeleton is true
        self.axis_list = axes(skeleton)
        self.traits, self.tables = found
        places = cKDTree(skeleton.points)
        _, self.nearest = places.query(true.points)
        scaffold = true_scaffold(true)
        self.limbs = sorted(scaffold.limbs, key=lambda limb: -limb.diameter)
        self.true_stem = np.concatenate([scaffold.axes[axis].nodes for axis in scaffold.stem])
        _, self.beside = places.query([clear_of_stem(scaffold, limb) for limb in self.limbs])
        area = self.traits["limb_area_cm2"] / self.traits["limb_trunk_ratio"]
        # Of a true skeleton the stem is the one that was measured: the limbs alone are in question
        self.stem = np.sqrt(area / np.pi * 4e-4) if self.is_true else stem

    def standing(self, stub=0.0):
        """The tree before any cut."""
        tree = MeasuredTree("tree", self.skeleton, self.axis_list)
        rows = self.tables["branches"], self.tables["limbs"]
        return StandingTree(tree, *rows, self.traits, stub=stub)

    def ratio_of(self, limbs):
        """Ratio of true limbs to the stem."""
        return float(sum(limb.diameter**2 for limb in limbs) / self.stem**2)

    def truth_after(self, standing, height):
        """The true tree after the cuts of a standing one, its leader up to a height.

        The foot of a tree that was measured lies up to `FOOT_M` off the true one.
        """
        stands = standing.stands[self.nearest]
        limbs = [x for x, at in zip(self.limbs, self.beside, strict=True) if standing.stands[at]]
        if self.is_true:
            limbs = true_scaffold(self.true.select(stands)).limbs
        up = self.true.points[:, 2] - self.true.points[0, 2]
        return {
            "limb_trunk_ratio": self.ratio_of(limbs),
            "height_m": float(up[stands].max()),
            "length_m": float(self.true.edge_length[stands].sum()),
            "leader_stands": bool(
                stands[self.true_stem[up[self.true_stem] < height - FOOT_M]].all()
            ),
        }


def measure_pruning(seed, n_points, *, bearing=False):
    """Prune a tree by proposal and by hand, known truly and as seen.

    Parameters
    ----------
    seed, n_points, bearing
        As of `cherrypicker_lab.traits.pairs.make_tree`.

    Returns
    -------
    dict
        ``seed``, ``habit`` and ``rows``: of each skeleton (``true``, ``seen``) and target, what was
        told and what is true.
    """
    tree, cloud = make_tree(seed, n_points, bearing=bearing)
    true = tree.skeleton()
    seen, target = skeleton_of(cloud)
    reports = Reports(target=target)
    stem = tree_traits(tree)["trunk_diameter_m"]
    cases = {
        name: Case(skeleton, true, measure_traits(skeleton, cloud, reports=reports), stem)
        for name, skeleton in (("true", true), ("seen", seen))
    }
    before = cases["true"].standing().told()
    severity = next_level(before["limb_trunk_ratio"])
    whole = {name: share * before[name] for name, share in SHARES.items()} | {"crossing": 0}
    asked = {
        "severity": severity,
        "whole": PruningOptions(severity.preset, severity.target | whole),
        "tall_spindle_axe": PruningOptions("tall_spindle_axe", whole),
    }
    chosen = by_hand(cases["true"], seed)
    rows = [
        {"skeleton": name, "target": words} | judge(case, options)
        for name, case in cases.items()
        for words, options in asked.items()
    ]
    rows += [{"skeleton": name} | cut_by_hand(case, chosen) for name, case in cases.items()]
    return {"seed": seed, "habit": tree.habit, "rows": rows}


def measure_scan(results, truth, seed=0):
    """Cut by hand a tree that was scanned from photos, as of `cut_by_hand`.

    Parameters
    ----------
    results, truth : path-like
        ``results/{tree}``, and the scene's truth with ``poses.npz`` and ``skeleton.csv``.
    """
    results, truth = Path(results), Path(truth)
    skeleton, true = scan_and_truth(results, truth)
    tables = {
        "branches": read_branches(results / "branches.csv"),
        "limbs": read_branches(results / "limbs.csv", LIMB_COLUMNS),
    }
    found = read_json(results / "traits.json"), tables
    case = Case(skeleton, true, found, whole_truth(true)["trunk_diameter_m"])
    before = case.ratio_of(case.limbs)
    rows = [{"true_before": before} | cut_by_hand(case, by_hand(case, seed))]
    return {"tree": results.name, "rows": rows}


def by_hand(case, seed):
    """Ranks of the true limbs that are cut by hand: half of them at most."""
    n_limbs = len(case.limbs)
    drawn = np.random.default_rng([seed, 36]).permutation(min(OF_THICKEST, n_limbs))
    return sorted(drawn[: min(N_BY_HAND, n_limbs // 2)].tolist())


def clear_of_stem(scaffold, limb):
    """Where a limb is so far from the stem that it is one, (3,)."""
    points = scaffold.skeleton.points[scaffold.axes[limb.axis].nodes]
    return points[np.argmax(scaffold.over(points)[0] >= TraitOptions().min_limb_m)]


def next_level(ratio):
    """The mildest of the published severities that such a tree is over, or a tenth less."""
    targets = {name: each["target"] for name, each in read_presets().items()}
    levels = {n: t["limb_trunk_ratio"] for n, t in targets.items() if n.startswith("ltr_")}
    under = [name for name, level in levels.items() if LEAST_OVER * level < ratio]
    if not under:
        return PruningOptions(OWN, {"limb_trunk_ratio": ratio / LEAST_OVER})
    return PruningOptions(max(under, key=levels.get))


def judge(case, options):
    """A proposal, and what becomes of the true tree by it."""
    target = resolve_target(options, len(case.tables["limbs"]), "m")
    standing = case.standing(target.stub)
    summary, rows = propose_cuts(standing, target)
    height = target.limits.get("height_m", np.inf)
    below = standing.stem & (standing.height < height)
    after = summary["after"]
    true = case.truth_after(standing, height)
    limit = target.limits.get("limb_trunk_ratio")
    most = np.inf if limit is None else limit + Z90 * (after["limb_trunk_ratio_se"] or 0.0)
    return {
        "n_cuts": len(rows),
        "reasons": sorted(" ".join(row["reasons"] for row in rows).split()),
        "not_reached": [each["name"] for each in summary["targets"] if not each["is_reached"]],
        "leader_stands": bool(standing.stands[below].all()),
        "limit": limit,
        "before": summary["before"],
        "after": after,
        "true_after": true,
        "is_reached_in_truth": bool(true["limb_trunk_ratio"] <= most),
    }


def cut_by_hand(case, ranks):
    """Cut some of the true limbs, by their rank, as the skeleton tells it and as it is."""
    standing = case.standing()
    starts = [row["branch_id"] for row in case.tables["limbs"]]
    carried = limb_of_axis(case.axis_list, starts)
    limbs = carried[standing.owner[case.beside[ranks]]]
    for limb in limbs[limbs >= 0]:
        standing.cut(standing.base[limb])
    left = [limb for rank, limb in enumerate(case.limbs) if rank not in ranks]
    return {
        "target": "by hand",
        "n_cuts": len(ranks),
        "before": case.standing().told(),
        "after": standing.told(),
        "true_after": {"limb_trunk_ratio": case.ratio_of(left)},
    }


def measure_made(seed, n_points):
    """Scan a tree before and after a pruning; some true cuts were proposed, and others that not.

    Parameters
    ----------
    seed, n_points
        As of `cherrypicker_lab.series.pairs.make_date` and `see_date`.

    Returns
    -------
    dict
        ``seed``; of ``made``, ``missed`` and ``unasked`` cuts how many there are, are told, and are
        told rightly.
    """
    seen, dates = {}, {}
    for kind in ("first", "pruned"):
        scene, dates[kind] = make_date(seed, kind)
        cloud, frame = see_date(scene, seed, kind, n_points, "seen")
        seen[kind] = as_scan(kind, cloud, frame)
    (step,) = compare_scans([seen["first"], seen["pruned"]]).steps
    wood, rng = step.earlier.wood, np.random.default_rng([seed, 37])
    cuts = [cut["place"] for cut in dates["pruned"].cuts]
    _, samples = cKDTree(wood.points).query(cuts)
    made = rng.permutation(samples)[N_UNASKED:]
    number = numbers_of(wood, dates["first"], np.eye(4))
    is_gone = (number >= 0) & ~np.isin(number, dates["pruned"].node_numbers)
    length = np.bincount(wood.axis, wood.length)
    whole = (np.bincount(wood.axis, is_gone) == 0) & (length >= LEAST_MISSED_M)
    whole &= ~np.isin(np.arange(len(whole)), [0, *wood.axis[samples]])
    missed = rng.permutation(np.flatnonzero(whole))[:N_MISSED]
    rows = [{"branch_id": wood.axis[at], "along_m": wood.along[at]} for at in made]
    rows += [{"branch_id": axis, "along_m": 0.0} for axis in missed]
    told = made_cuts(step, [row | {"cut": i} for i, row in enumerate(rows)])
    n_right = sum(cut < len(made) for cut in told["made_cuts"])
    n_missed = len(told["missed_cuts"])
    return {
        "seed": seed,
        "made": [len(made), len(told["made_cuts"]), n_right],
        "missed": [len(missed), n_missed, n_missed - (len(made) - n_right)],
        "unasked": [N_UNASKED, told["n_more_cuts"]],
    }
