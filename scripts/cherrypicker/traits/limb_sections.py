"""How thick limbs are beyond the stem, from the cloud's own points there.

Where limbs leave a stem, the radii of a skeleton's nodes take in the wood of the fork: those of
28 limbs of old generated vases came out 18 % too large by area, sections of the limbs' own points
0.2 % too small (docs/traits.md). So a section is fitted to the points that have the limb's own
skeleton nearest and lie outside the stem's surface; where it is not sure, the nodes farther out
stand in.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.errors import StageError
from cherrypicker.geometry.stem_slabs import cut_slab, section_of, tolerance_of
from cherrypicker.skeleton.axes import Axis
from cherrypicker.traits.scaffold import Limb, StemSurface

_HALF_M = 0.03  # of the slab: 3 cm are surer than 2 (142 against 153 limbs off by a tenth and more)
_CLEAR_M = 0.005  # outside the stem's surface: points nearer may be the stem's bark
_FEWEST = 12  # points of a section
_RADII = (0.4, 1.8)  # of the nodes' radius: the smallest and the largest section looked for (guess)
_ROOM_M = 0.005  # added to the largest
_SURE = 0.05  # standard error, of the radius; 3 to 12 % do as well on generated trees


def limb_of_axis(parents: list[int], limbs: list[int]) -> np.ndarray:
    """The limb that carries each axis, (n_axes,) int64: its own axis's number, -1 for none.

    Parameters
    ----------
    parents : list of int
        Axis that each axis hangs on, -1 for the trunk; parents before children.
    limbs : list of int
        Axes that start limbs.
    """
    carried = np.full(len(parents), -1, dtype=np.int64)
    carried[limbs] = limbs
    for axis, parent in enumerate(parents):
        if parent >= 0 and carried[axis] < 0:
            carried[axis] = carried[parent]
    return carried


def measure_limbs(
    axis_list: list[Axis],
    limbs: list[Limb],
    stem: StemSurface,
    wood: cKDTree,
    axis_of_wood: np.ndarray,
    typical: float | None,
    rng: np.random.Generator,
) -> list[Limb]:
    """Limbs with diameters, errors and scatters from the points around the places of measure.

    Parameters
    ----------
    limbs : list of Limb
        From `find_limbs`.
    wood : cKDTree
        Of the wood points.
    axis_of_wood : ndarray of shape (n_wood,), int64
        Axis that each of them lies nearest to.
    typical : float or None
        Scatter of the points where a limb has none of its own; what limbs have without it.
    """
    carrier = limb_of_axis([axis.parent for axis in axis_list], [limb.axis for limb in limbs])
    found = []
    for limb in limbs:
        reach = np.hypot(_HALF_M, _RADII[1] * limb.beyond)
        rows = np.array(sorted(wood.query_ball_point(limb.place, reach)), dtype=np.int64)
        own = wood.data[rows[carrier[axis_of_wood[rows]] == limb.axis]]
        if len(own):
            own = own[stem.over(own)[0] > _CLEAR_M]
        found.append(_measured(limb, own, rng))
    known = [limb.scatter for limb in found if limb.scatter]
    typical = typical or (float(np.median(known)) if known else 0.0)
    return [replace(limb, scatter=limb.scatter or typical) for limb in found]


def _measured(limb: Limb, own: np.ndarray, rng: np.random.Generator) -> Limb:
    """A limb with the section through its own points (n, 3), or what its nodes farther out say."""
    fallback = replace(limb, diameter=limb.beyond)
    guess = limb.beyond / 2.0
    local, _ = cut_slab(own, limb.place, limb.direction, _HALF_M, _RADII[1] * limb.beyond)
    if len(local) < _FEWEST:
        return fallback
    low, high = _RADII
    try:
        fit = section_of(
            local, tolerance_of(guess), (low * guess, high * guess + _ROOM_M), rng, waves=False
        )
    except StageError:
        return fallback
    is_near = (
        low * guess <= fit.radius <= high * guess + _ROOM_M
    )  # a fit may leave what it began at
    if not is_near or not fit.error < _SURE * fit.radius:
        return fallback
    return replace(limb, diameter=2.0 * fit.radius, error=fit.error, scatter=fit.noise)
