"""Laplacian-based contraction of a point cloud, plain (LBC) and semantic (S-LBC)."""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from cherrypicker.classes import CLASS_IDS
from cherrypicker.contraction.laplacian_published import (
    cotangent_laplacian,
    semantic_row_weights,
    solve_contraction,
)
from cherrypicker.errors import StageError

logger = logging.getLogger(__name__)

METHODS = ("limbs", "slbc", "lbc")
ATTRACTION_RULES = ("compound", "pc_skeletor", "cao")
# Of W_L by the number of points: pc-skeletor's
AMPLIFICATION_BY_SIZE = ((1e3, 1.0), (1e4, 2.0), (1e6, 5.0), (np.inf, 8.0))
FEWEST_POINTS = 10


@dataclass(frozen=True)
class SkeletonOptions:
    """How wood becomes a skeleton; the fields are config keys of ``skeleton``, described there.

    "limbs" moves every point to the axis of its limb (`cherrypicker.limbs.joints`) and reads
    none of the others; "lbc" is the iteration as published, "slbc" with the weights by class.
    Classes without a weight weigh 1.
    """

    method: str = "limbs"
    weights: dict[str, float] = field(default_factory=lambda: {"trunk": 10.0, "branch": 1.0})
    initial_contraction: float = 1000.0
    initial_attraction: float = 0.5
    attraction_rule: str = "compound"
    amplification: float | None = None
    max_contraction: float = 2048.0
    max_attraction: float = 1024.0
    min_weight: float = 0.1
    termination_ratio: float = 0.003
    max_iterations: int = 20
    n_neighbors: int = 30
    mollify_factor: float = 1e-5

    def __post_init__(self) -> None:
        for name, known in (("method", METHODS), ("attraction_rule", ATTRACTION_RULES)):
            if getattr(self, name) not in known:
                raise StageError(
                    f"unknown {name} {getattr(self, name)!r} (known: {', '.join(known)})",
                    key=f"skeleton.{name}",
                )
        for name, weight in self.weights.items():
            if name not in CLASS_IDS:
                raise StageError(
                    f"unknown class {name!r} (known: {', '.join(CLASS_IDS)})",
                    key="skeleton.weights",
                )
            if not weight > 0:
                raise StageError(f"the weight of {name} must be positive", key="skeleton.weights")


@dataclass
class Contraction:
    """What a contraction leaves."""

    points: np.ndarray  # (n_points, 3) float64: contracted, in the order of the input
    # mean(M) / mean(M_0) after each iteration; before it with the rule "pc_skeletor"
    mass_ratio: list[float]
    stop: str  # why it stopped


def contract_points(
    points: np.ndarray,
    weights: np.ndarray | None,
    options: SkeletonOptions,
    callback: Callable | None = None,
) -> Contraction:
    """Contract a point cloud to its skeleton (paper, Eqs. lbc and S-LBC).

    Each iteration solves [S W_L L; W_H] C' = [0; W_H C], then grows W_L by the amplification,
    W_H point by point by sqrt(M_0 / M), and computes L anew from C'. The paper does not say how
    W_H grows; ``options.attraction_rule`` chooses:

    - "compound": W_H is multiplied by sqrt(M_0 / M) each time, M after the solve.
    - "pc_skeletor": the same with M from before the solve, which also decides when to stop, as in
      the authors' program.
    - "cao": W_H starts from its first value each time (Cao et al., Au et al. 2008).

    The points (n_points, 3) may have any frame; the constants expect metres. Weights (n_points,)
    are the lambdas of the points' classes for S-LBC; without them S = 1: plain LBC. The callback is
    called as ``callback(iteration, mass_ratio, points)`` after each iteration. A `StageError` where
    there are too few points or the first iteration fails.

    Cao et al., Point Cloud Skeletons via Laplacian-Based Contraction, SMI 2010.
    Meyer et al., CherryPicker, CVPR workshops 2023.
    """
    if len(points) < FEWEST_POINTS:
        raise StageError(f"{len(points)} points are too few to contract", key="contract.classes")
    laplacian_of = partial(
        cotangent_laplacian, n_neighbors=options.n_neighbors, mollify_factor=options.mollify_factor
    )
    centre = points.mean(axis=0)  # far-off frames would cost digits in the normal equations
    current = points - centre
    try:
        L, mass = laplacian_of(current)
    except RuntimeError as error:
        raise StageError(
            f"no Laplacian of the cloud ({error})", key="skeleton.n_neighbors"
        ) from error
    first_mass = before = mass
    w_l = options.initial_contraction * np.sqrt(mass.mean())
    w_h = np.full(len(points), options.initial_attraction)
    amplification = options.amplification or next(
        factor for limit, factor in AMPLIFICATION_BY_SIZE if len(points) < limit
    )
    ratios: list[float] = []
    stop = f"{options.max_iterations} iterations"
    for iteration in range(1, options.max_iterations + 1):
        start = time.perf_counter()
        s = 1.0 if weights is None else semantic_row_weights(L, weights)
        try:
            new = solve_contraction(L, w_l * s * np.ones(len(points)), w_h, current)
            if not np.isfinite(new).all():
                raise RuntimeError("the solution is not finite")
            solved = time.perf_counter()
            L, mass = laplacian_of(new)
            if not (np.isfinite(L.data).all() and np.isfinite(mass).all()):
                raise RuntimeError("the Laplacian is not finite")
        except RuntimeError as error:
            if iteration == 1:
                raise StageError(
                    f"the contraction fails at once ({error})", key="contract.voxel_size_m"
                ) from error
            stop = f"the last good iteration, since {error}"
            break
        moved, current = np.linalg.norm(new - current, axis=1), new
        seen = before if options.attraction_rule == "pc_skeletor" else mass
        before = mass
        ratios.append(float(seen.mean() / first_mass.mean()))
        logger.info(
            f"iteration {iteration}: mass ratio {ratios[-1]:.4f}, moved "
            f"{1000 * np.median(moved):.2f} mm (median), solve {solved - start:.1f} s, "
            f"Laplacian {time.perf_counter() - solved:.1f} s"
        )
        if callback is not None:
            callback(iteration, ratios[-1], current + centre)
        if ratios[-1] < options.termination_ratio:
            stop = f"mass ratio below {options.termination_ratio:g}"
            break
        w_l = np.clip(w_l * amplification, options.min_weight, options.max_contraction)
        from_here = options.initial_attraction if options.attraction_rule == "cao" else w_h
        w_h = from_here * np.sqrt(first_mass / np.maximum(seen, np.finfo(float).tiny))
        w_h = np.clip(w_h, options.min_weight, options.max_attraction)
    logger.info("stopped after %d iterations: %s", len(ratios), stop)
    return Contraction(current + centre, ratios, stop)
