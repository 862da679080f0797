"""Whether points tell a limb from noise of its parent and from a bump of its surface.

Two models of the same points are compared by the Bayesian information criterion (Schwarz,
"Estimating the dimension of a model", Annals of Statistics 1978). Points of a cloud from photos err
together with those around them, and so do all where a tube does not follow the wood, so that many
say no more than few: their number is divided by the design effect that the residuals on the limbs
show, as that of a sample that is drawn in clusters.

A tube bends to whatever point comes next, and fits a handful of stray points without an error. But
strays lie to all sides of one another, and a limb leads on: where it ends and strays follow is a
change point (Page, "Continuous inspection schemes", Biometrika 1954).
"""

import numpy as np

from cherrypicker.geometry.neighbors import Neighbors
from cherrypicker.limbs.tubes import Tube, seen_from

N_TUBE = 6  # numbers that a limb adds to its parent: its place there, heading, length and radius
N_BUMP = 4  # those of a bump: its place there, extent and height
# Neighbours over which errors are added up: on foreign_a's limbs they correlate by 0.65, 0.23, 0.13
# and 0.07 with those of the 1st, 11th, 20th and 39th
N_TOGETHER = 40


def design_effect(points: np.ndarray, residual: np.ndarray) -> float:
    """How many points tell as much as one whose error is its own.

    They lie on one limb, (n_points, 3), `residual` (n_points,) off its surface without outliers. 1
    where the errors are independent or there are too few points to tell.
    """
    if len(points) <= N_TOGETHER:
        return 1.0
    off = residual - residual.mean()
    around = Neighbors(points, N_TOGETHER - 1).index
    together = float((off * off[around].sum(axis=1)).sum() / np.square(off).sum())
    return max(together, 1.0)


def told_until(
    points: np.ndarray,
    tube: Tube,
    parent: Tube,
    weight: np.ndarray,
    noise: float,
    effect: float,
    reach: float,
    n_rival: int = N_BUMP,
    beside: np.ndarray | float = np.inf,
    *,
    from_photos: bool = False,
) -> float:
    """How far points (n_points, 3) tell a tube from noise of other wood and a bump of its parent.

    The points of a bump (a knob, a patch of bark, a section that is no circle) lie a height off the
    parent's surface, with a scatter of their own; those of a limb lead away from it, and lie on the
    tube with one of theirs. Neither scatters less than the noise. A bump is no higher than it is
    wide, nor than its parent is thick. Of a cloud `from_photos` wrong depths make strands beside
    the parent as well, which only its thickness bounds. The tube is asked up to where stray points
    take over.

    Returns the way along the tube up to which it is told: infinite for all of it, 0 for nothing.
    Each point tells as much as `weight` (n_points,) of one of the parent, and errs by the noise in
    each direction, one standard deviation; the effect is as of `design_effect`. Points farther
    apart than the reach along the tube have air between them; one that lies farther off the tube is
    a stray, and how far tells nothing. What the tube is told from has `n_rival` numbers, 0 where
    that is noise: it is taken to fit as well as a bump would, and has none. Other wood is the
    parent, or what lies nearer: ``beside``, (n_points,), are the distances from its surface.
    """
    if not weight.any():  # no point is nearest to it
        return 0.0
    on_parent, on_tube = seen_from(parent, points), seen_from(tube, points)
    order = np.argsort(on_tube.way)
    way = on_tube.way[order]
    ends = np.flatnonzero(np.append(np.diff(way) > reach, True))
    last = _last_of_limb(points[order], way, noise + on_tube.radius[order], ends, reach)
    own = order[: ends[last] + 1]
    told = max(weight[own].sum(), np.finfo(float).tiny)

    def mean(values: np.ndarray) -> float:
        return float((weight * values)[own].sum() / told)

    off_parent, off = (
        np.hypot(one.away - one.radius, one.beyond) / noise for one in (on_parent, on_tube)
    )
    off_parent = np.minimum(off_parent, np.where(off > reach / noise, reach, beside) / noise)
    off = np.minimum(off, reach / noise)
    widest = mean(on_parent.radius)
    if not from_photos:
        widest = min(widest, mean(on_tube.away))
    height = min(mean(off_parent), 2 * widest / noise)
    bump = mean((off_parent - height) ** 2)
    gain = told * np.log(max(bump, 1.0) / max(mean(off**2), 1.0))
    price = effect * np.log(max(told / effect, np.e))
    if gain <= (N_TUBE - n_rival) * price:
        return 0.0
    return np.inf if last == len(ends) - 1 else float(way[ends[last]])


def _last_of_limb(
    points: np.ndarray, way: np.ndarray, place: np.ndarray, ends: np.ndarray, reach: float
) -> int:
    """Number of the last piece before stray points take over, of all where none do.

    Between strays all headings are alike likely, so that half of 1 less the cosine of a turn is
    uniform in 0 to 1. That a limb turns by little or much is alike likely on any scale: the density
    falls as one over it, and is even below what the points can tell. The turns are those between
    stretches of a reach and over the air between pieces.

    Whether another stray follows within a reach is a chance of which nothing is known: it is
    uniform, and a piece has s points with a probability of 1 / (s (s + 1)). Of a limb, which other
    wood hides by little or much, the pieces have any number up to all, alike likely on any scale.
    That strays take over somewhere costs one number more than that they do not.

    Points (n, 3), their ways (n,) and how exactly each tells its place (n,) are in the order of
    their ways, the pieces' last ones are numbered by ``ends`` (n_pieces,).
    """
    if len(ends) == 1:
        return 0
    is_last = np.append(np.diff(way // reach) > 0, True)
    is_last[ends] = True
    last = np.flatnonzero(is_last)
    starts, size = np.append(0, last[:-1] + 1), np.diff(last, prepend=-1)
    place = np.add.reduceat(place, starts) / size
    step = np.diff(np.add.reduceat(points, starts) / size[:, None], axis=0)
    length = np.maximum(np.linalg.norm(step, axis=1), place[1:] * np.finfo(float).eps)
    turn = (1 - (step[1:] * step[:-1]).sum(axis=1) / (length[1:] * length[:-1])) / 2
    ahead = length[1:] / length[:-1]
    told = place[2:] * np.sqrt(1 + (1 + ahead) ** 2 + ahead**2) / length[1:]
    told = np.minimum(np.square(told) / 4, 1.0)  # of a small angle, as above
    likelier = np.zeros(len(last))
    likelier[2:] = np.cumsum(-np.log(np.maximum(turn, told)) - np.log(1 - np.log(told)))
    likelier = likelier[np.searchsorted(last, ends)]
    scales = np.log(len(way)) + np.euler_gamma  # the sum of 1 / s
    likelier[1:] += np.cumsum(np.log((np.diff(ends) + 1) / scales))
    is_cut = likelier.max() - likelier[-1] > np.log(len(ends))
    return int(likelier.argmax()) if is_cut else len(ends) - 1
