"""The target's wood from labelled points, in one step."""

from types import SimpleNamespace

import numpy as np

from cherrypicker.geometry.neighbors import Neighbors
from cherrypicker.wood.target_wood import select_target_wood, share_wood
from cherrypicker.wood.thinned import N_NEIGHBORS, GrowthOptions

NO_GROUND = np.empty((0, 3))


def choose_wood(points, labels, *, ground=NO_GROUND, region=None, target_xy=None, **gaps):
    """Share wood out, and choose the target among the stems."""
    chosen, near = GrowthOptions(**gaps), Neighbors(points, N_NEIGHBORS)
    shared = share_wood(points, labels, chosen, near=near, ground=ground, region=region)
    choice, report = select_target_wood(points, shared, chosen, region=region, target_xy=target_xy)
    stem = choice.target.stem
    keep, base = shared.owner == stem, shared.bases[stem]
    return SimpleNamespace(keep=keep, base=base, choice=choice, report=report)
