"""Which tree of a scan is the target: decided once, after the labels, by the wood itself.

What hangs on each stem is weighed: how much wood there is near where the cameras look, and how
high it rises. A post, a sign or a stake weighs little beside a tree, wherever it stands; a
neighbour weighs as much, but stands off the middle.
"""

import logging
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cherrypicker.errors import StageError
from cherrypicker.placement.footprint import Footprint

logger = logging.getLogger(__name__)

# Wood is weighed by occupied voxels, so that the density of the points does not matter: as wide as
# the points of our stereo lie apart on a twig at most. Half and twice as wide choose the target of
# 16 trees, three scans and three rows by the same margin to 0.001. Where points lie farther apart,
# each would be a voxel: it is never narrower than so many spacings.
MASS_VOXEL_M = 0.02
MASS_VOXEL_IN_SPACINGS = 2.0
# Standard deviation of the weight of wood about what the cameras look at, in radii of the region:
# a neighbour as large as the target counts for 0.14 of it at half the cameras' distance, the
# spacing of a row. Measured on 150 pairs of generated trees (16 trees of 2 to 3 m and three forms,
# aim off by 0.06 radii) at each spacing: the right one of 0.71, 0.95, 0.99 and 1.00 of the pairs
# at 0.2, 0.3, 0.4 and 0.5 radii.
NEAR_SHARE = 0.25
# Below this margin a choice is a close one. Measured on the same pairs: 0.76, 0.45, 0.21 and 0.03
# are flagged at those spacings; of the wrong choices all but 0.01 of the pairs at 0.2 radii.
CLOSE_CALL = 0.5
# Of the target's mass: from here on something else that stands is told as another tree. Half and
# twice as much tell the same of those; a post of 2 cm radius and 1 m height is 0.13 of a tree with
# 11 m of branches (test_target.py)
TREE_SHARE = 0.2
# Heights of the tree by which its foot may be off crop.target_xy (guess: a lean of 14 degrees)
OFF_SHARE = 0.25


@dataclass(frozen=True)
class Candidate:
    """What hangs on one stem."""

    stem: int  # index of the stem
    base: list[float]  # 3 numbers: base of the stem, in the cloud's frame
    mass: int  # occupied voxels of wood
    height: float  # from the base to the top of its wood, in the cloud's unit
    distance: float | None  # horizontal, to what the cameras look at; None without cameras
    score: float  # mass near what the cameras look at, times the height; 1 for the best


@dataclass
class Choice:
    """The target and what it was chosen from."""

    target: Candidate
    source: str  # ``wood``, or ``config`` where ``crop.target_xy`` says so
    candidates: list[Candidate]  # best first; stems without wood are left out
    off: float = 0.0  # horizontal distance of the target's base to ``crop.target_xy``; 0 without

    @property
    def runner_up(self) -> Candidate | None:
        """The best of the others."""
        return next((other for other in self.candidates if other is not self.target), None)

    @property
    def margin(self) -> float | None:
        """By how much the target's score is above the runner-up's, as a share of the target's.

        1 without a runner-up, None where the config decided.
        """
        if self.source == "config":
            return None
        return 1.0 - self.runner_up.score / self.target.score if self.runner_up else 1.0

    @property
    def other_trees(self) -> list[Candidate]:
        """The other candidates that weigh enough to be trees."""
        least = TREE_SHARE * self.target.mass
        return [one for one in self.candidates if one is not self.target and one.mass >= least]


def choose_target(
    points: np.ndarray,
    bases: Sequence[np.ndarray] | np.ndarray,
    owner: np.ndarray,
    *,
    spacing: float = 0.0,
    region: Footprint | None = None,
    target_xy: ArrayLike | None = None,
) -> Choice:
    """Choose the target among the trees of a cloud.

    Each point of wood (n_points, 3), z up, hangs on the stem that is its owner (n_points,), any
    other number for none; a stem's base is (3,). The spacing is the median distance of neighbouring
    points. In the region the cameras look; without one nearness does not count.

    `target_xy` (2,) is the config's word: the stem nearest to this place is the target. Of stems
    that are as near to within a voxel of the weighing (2 cm, or two spacings) the one that scores
    best: who points at a tree does not mean the splinter beside its foot.

    A `StageError` where no wood hangs on any stem, or `target_xy` lies outside the region or the
    cloud.
    """
    voxel = max(MASS_VOXEL_M, MASS_VOXEL_IN_SPACINGS * spacing)
    found = [
        _weigh(points[owner == stem], stem, base, voxel, region)
        for stem, base in enumerate(bases)
        if (owner == stem).any()
    ]
    if not found:
        raise StageError("no wood hangs on a stem", key="segment")
    best = max(one.score for one in found) or 1.0
    found = [replace(one, score=one.score / best) for one in found]
    found.sort(key=lambda one: (-one.score, one.stem))
    if target_xy is None:
        choice = Choice(found[0], "wood", found)
    else:
        place = np.asarray(target_xy, dtype=np.float64)
        if place.shape != (2,) or not np.isfinite(place).all():
            raise StageError(f"{target_xy!r} is no pair of numbers", key="crop.target_xy")
        around = region or Footprint.of_box(points[:, :2])
        if around.inward(place[None])[0] < 0:
            where = "region of interest" if region else "wood"
            cause = f"the point ({place[0]:.3g}, {place[1]:.3g}) lies outside the {where}"
            raise StageError(cause, key="crop.target_xy")
        apart = [float(np.hypot(*(np.array(one.base[:2]) - place))) for one in found]
        # Best first: of stems as near as one another, by what the cloud tells, the best
        nearest = int(np.argmax(np.array(apart) <= min(apart) + voxel))
        choice = Choice(found[nearest], "config", found, apart[nearest])
    for one in choice.candidates:
        which, (x, y) = "target" if one is choice.target else "other", one.base[:2]
        size = f"{one.mass:,} voxels of wood, {one.height:.2f} high"
        logger.info(f"{which} at ({x:.2f}, {y:.2f}): {size}, score {one.score:.3f}")
    return choice


def _weigh(
    own: np.ndarray, stem: int, base: ArrayLike, voxel: float, region: Footprint | None
) -> Candidate:
    """A stem's wood as a candidate; its score in voxels times height."""
    base = np.asarray(base, dtype=np.float64)
    distance = None if region is None else float(region.from_center(base[None, :2])[0])
    _, first = np.unique(np.floor(own / voxel).astype(np.int64), axis=0, return_index=True)
    height = max(float(own[:, 2].max() - base[2]), voxel)
    weight = np.ones(len(first))
    if region is not None:
        off = region.from_center(own[first, :2]) / (NEAR_SHARE * region.radius)
        weight = np.exp(-0.5 * off**2)
    score = float(weight.sum()) * height
    return Candidate(stem, base.tolist(), len(first), height, distance, score)


def target_report(
    choice: Choice, *, region: Footprint | None = None, factor: float = 1.0, **scan: Any
) -> dict:
    """Content of target.json, each candidate with the ``crop_target_xy`` that would choose it.

    Choice and region are in the frame of segmented.ply; the factor is the length of the unit of
    ``crop.target_xy`` (the aligned frame; a ready cloud's own) in that. What else of the scan
    stands in the file: ``unit``, ``scale_mode``, ``camera_distance``, ``loose`` (wood near the
    target that hangs on no stem), ``neighbours_xy`` (stems whose wood was taken out of the cloud
    before).
    """

    def shown(one: Candidate) -> dict:
        place = [round(value / factor, 4) for value in one.base[:2]]
        content = asdict(one) | {"crop_target_xy": place, "is_target": one is choice.target}
        del content["stem"]
        return content

    runner_up = choice.runner_up
    warnings = []
    if runner_up is not None and choice.margin is not None and choice.margin < CLOSE_CALL:
        warnings.append(
            f"target_close: another tree scores {100 * runner_up.score:.0f} % of the target; "
            f"crop.target_xy: {shown(runner_up)['crop_target_xy']} takes that one"
        )
    if choice.off > OFF_SHARE * choice.target.height:
        warnings.append(
            f"target_far: the stem nearest to crop.target_xy stands {choice.off:.2f} from it; see "
            "the candidates in target.json"
        )
    for warning in warnings:
        logger.warning("%s", warning)
    return {
        "target_xy": choice.target.base[:2],
        "source": choice.source,
        "region": None if region is None else region.as_dict(),
        "unit": scan.get("unit", "m"),
        "factor": factor,
        "scale_mode": scan.get("scale_mode"),
        "camera_distance": scan.get("camera_distance"),
        "candidates": [shown(one) for one in choice.candidates],
        "runner_up": None if runner_up is None else shown(runner_up),
        "margin": choice.margin,
        "other_stems_xy": [one.base[:2] for one in choice.other_trees],
        "neighbours_xy": scan.get("neighbours_xy", []),
        "loose": scan.get("loose", []),
        "warnings": warnings,
    }
