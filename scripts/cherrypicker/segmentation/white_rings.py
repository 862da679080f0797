"""White rings around stems, told by how bright the stem's darker sides are along it.

A calibration ring is two voxels of the network wide and as round as the stem, so that it passes
for wood. Seen along the stem it is plain: over a few centimetres even the darker sides are brighter
than the bark below and above. Paint reaches the ground and lichen is on one side.
"""

import warnings

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.spatial import cKDTree
from scipy.stats import binned_statistic_2d

from cherrypicker.limbs.tubes import Tube

STEP_M = 0.01
N_SIDES = 8
DARKER_SIDES = 0.25  # quantile over the sides: lichen is on one
REACH_STEPS = 20  # bark this far below and above is what a step is compared with
WIDEST_STEPS = 12  # what is wider is paint
CONTRAST = 1.15  # of a side to its own bark: the sun is on one
MAX_SATURATION = 0.3  # white is no red tape
MAX_OFF_M = 0.012  # of a ring's points from the stem's surface: a sleeve is that thick


def ring_points(points: np.ndarray, colors: np.ndarray, stem: Tube) -> np.ndarray:
    """Which points (n, 3) of a stem, metres, z up, are of white rings, (n,) bool.

    Colours (n, 3) are in [0, 1]; the stem's tube begins at its foot.
    """
    # A step would else end where a node happens to lie
    fine = np.arange(0.0, max(stem.way[-1], STEP_M / 4), STEP_M / 4)
    axis, result = stem.at(fine), np.zeros(len(points), bool)
    nearest = cKDTree(axis.nodes).query(points)[1]
    offset, own = points - axis.nodes[nearest], axis.radius[nearest]
    is_on = np.abs(np.linalg.norm(offset, axis=1) - own) < MAX_OFF_M
    on = np.flatnonzero(is_on & (own >= MAX_OFF_M))  # thinner stems show no sides
    step = (fine[nearest[on]] / STEP_M).astype(int)
    n_steps = int(step.max(initial=-1)) + 1
    if n_steps < 3:
        return result
    turn, brightness = np.arctan2(*offset[on, :2].T), colors[on].mean(axis=1)
    bins = [np.arange(n_steps + 1), np.linspace(-np.pi, np.pi, N_SIDES + 1)]
    sides = binned_statistic_2d(step, turn, brightness, "median", bins).statistic
    around = np.pad(sides, ((REACH_STEPS, REACH_STEPS), (0, 0)), constant_values=np.nan)
    window = sliding_window_view(around, 2 * REACH_STEPS + 1, axis=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # sides that no step around shows
        bark = np.nanmedian(window, axis=-1)  # of each side around each step
        contrast = np.nanquantile(sides / bark, DARKER_SIDES, axis=1)
    seen = np.isfinite(sides).sum(axis=1) >= N_SIDES // 2  # or a step is not judged
    bright = seen & (contrast >= CONTRAST)
    is_bark = seen & ~bright
    for first, past in np.flatnonzero(np.diff(bright, prepend=False, append=False)).reshape(-1, 2):
        has_bark = [is_bark[max(0, first - REACH_STEPS) : first], is_bark[past:][:REACH_STEPS]]
        if past - first <= WIDEST_STEPS and all(each.any() for each in has_bark):
            rows = on[(step >= first) & (step < past)]
            middle = np.median(colors[rows], axis=0)
            result[rows] = np.ptp(middle) <= MAX_SATURATION * middle.max()
    return result
