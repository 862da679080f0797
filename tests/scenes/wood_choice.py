"""The target's wood from labelled points, in one step."""

from types import SimpleNamespace

from cherrypicker.wood.target_wood import select_target_wood, share_wood


def choose_wood(points, labels, *, ground=None, region=None, target_xy=None, **gaps):
    """Share wood out, and choose the target among the stems."""
    shared = share_wood(points, labels, ground=ground, region=region, **gaps)
    choice, report = select_target_wood(points, shared, region=region, target_xy=target_xy, **gaps)
    stem = choice.target.stem
    keep, base = shared.owner == stem, shared.bases[stem]
    return SimpleNamespace(keep=keep, base=base, choice=choice, report=report)
