"""Limbs that were cut where branches touch, joined again.

The shortest way to the foot leads over whatever wood touches. Where two branches cross, the outer
part of the one is grown as a side limb of the other, and its inner part ends there; where they
touch twice, ways from both sides meet in the middle of a branch. Wood does neither: what goes on in
line with an end is the same limb, of which the pieces are told apart by no more than a contact.
"""

import logging
from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.limbs.joints import heading_of
from cherrypicker.limbs.tubes import Limb, Tube, claim_radius, even, place_on_axis, seen_from

logger = logging.getLogger(__name__)

# Cosine of the largest angle between two pieces and the line that joins them. 0.8 and 0.95 find
# tips as well, to 0.01 of F1, on six trees of the paper's set and a scan from photos (2026-11-25)
IN_LINE = 0.9


def join_at_contacts(limbs: list[Limb], spacing: float) -> list[Limb]:
    """Join each end with what goes on in line beyond the wood that it touches.

    The limbs come, and come back, with parents before children, the stem first. Each pair is joined
    that is most in line. `spacing` is that of the points that they were made from.
    """
    n_before = len(limbs)
    while pairs := list(_pairs(limbs, spacing)):
        _, inner, outer, is_turned = max(pairs, key=lambda pair: pair[0])
        one, two = limbs[inner].tube, limbs[outer].tube
        nodes, radius = two.nodes[1:], two.radius[1:]  # it starts within the wood that is crossed
        if is_turned:
            nodes, radius = two.nodes[::-1], two.radius[::-1]
        whole = Tube(np.vstack([one.nodes, nodes]), np.append(one.radius, radius))
        tubes = [limb.tube for limb in limbs]
        tubes[inner] = even(whole, spacing)
        number, kept = {-1: -1}, list[Limb]()
        waiting = [k for k in range(len(limbs)) if k != outer]
        for old in waiting:
            parent = inner if limbs[old].parent == outer else limbs[old].parent
            if parent in number:
                number[old] = len(kept)
                kept.append(Limb(tubes[old], number[parent]))
            else:  # what grew from the outer follows the inner, which comes later
                waiting.append(old)
        limbs = kept
    logger.info("%d limbs joined at contacts", n_before - len(limbs))
    return limbs


def _pairs(limbs: list[Limb], spacing: float) -> Iterator[tuple[float, int, int, bool]]:
    """How much in line two limbs are, which they are, and whether the outer is turned round.

    The inner goes on in the outer from its start on; or in the turned outer, which is shorter, from
    its tip on.
    """
    tips = np.array([limb.tube.nodes[-1] for limb in limbs])
    turned = [Tube(limb.tube.nodes[::-1], limb.tube.radius[::-1]) for limb in limbs]
    back = np.array([heading_of(tube, spacing) for tube in turned])
    tree = cKDTree(tips)

    def in_line(inner: int, outer: Tube, heading: np.ndarray) -> float:
        between = outer.nodes[1] - turned[inner].nodes[1]
        between /= max(np.linalg.norm(between), 1e-12)
        return float(min(-back[inner] @ heading, -back[inner] @ between, heading @ between))

    for outer, limb in enumerate(limbs[1:], start=1):
        start, heading = limb.tube.nodes[:1], heading_of(limb.tube, spacing)
        touched = limbs[limb.parent].tube
        segment = place_on_axis(start, touched.nodes)[0][0]
        along = touched.nodes[segment + 1] - touched.nodes[segment]
        cosine = min(float(abs(along @ heading) / np.linalg.norm(along)), IN_LINE)
        # With the sine of the angle at which it crosses, at least that of what is in line
        ends = [
            (limb.tube, heading, seen_from(touched, start).radius, float(np.sqrt(1 - cosine**2))),
            (turned[outer], back[outer], limb.tube.radius[-1:], 1.0),
        ]
        for is_turned, (tube, heading, radius, slant) in enumerate(ends):
            # A contact swallows so much of either piece
            reach = 2 * (float(claim_radius(radius, spacing)[0]) + spacing) / slant
            for inner in sorted(tree.query_ball_point(tube.nodes[0], reach)):
                if inner in (0, outer, limb.parent) or _hangs_on(limbs, inner, outer):
                    continue
                if is_turned and (
                    limbs[inner].tube.length < limb.tube.length
                    or limbs[inner].parent == limb.parent  # no wood is an arch
                    or _hangs_on(limbs, outer, inner)
                ):
                    continue
                alike = in_line(inner, tube, heading)
                if alike > IN_LINE:
                    yield alike, inner, outer, bool(is_turned)


def _hangs_on(limbs: list[Limb], limb: int, other: int) -> bool:
    """Whether a limb grows from another, at however many removes."""
    while limb > other:
        limb = limbs[limb].parent
    return limb == other
