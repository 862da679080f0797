"""The target's wood from labelled points, in one step."""

from types import SimpleNamespace

from cherrypicker.wood.target_wood import select_target_wood, share_wood
from cherrypicker.wood.thinned import GrowthOptions


def choose_wood(points, labels, *, ground=None, region=None, target_xy=None, **gaps):
    """Share wood out, and choose the target among the stems."""
    chosen = GrowthOptions(**gaps)
    shared = share_wood(points, labels, chosen, ground=ground, region=region)
    choice, report = select_target_wood(points, shared, chosen, region=region, target_xy=target_xy)
    stem = choice.target.stem
    keep, base = shared.owner == stem, shared.bases[stem]
    return SimpleNamespace(keep=keep, base=base, choice=choice, report=report)
