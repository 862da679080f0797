"""The limbs of a tree joined to one rooted tree of nodes, and their points moved to its axes."""

import numpy as np

from cherrypicker.limbs.tubes import Limb, Tube, seen_from, smooth
from cherrypicker.skeleton.model import rooted_order

HEADING = 6.0  # in spacings: length of a limb's start that tells where it comes from,
HEADING_IN_RADII = 3.0  # or this many of its radii, where that is more
NEARNESS = 0.3  # of a place's distance from the limb's start, beside that from its continuation
# In spacings, or the parent's radius where that is more: limbs that meet it this near to each other
# share a node
SAME_PLACE = 1.5
PLACES = 8  # between two nodes of a fitted axis, where a meeting place is looked for


def join_limbs(
    limbs: list[Limb], spacing: float, step: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Join limbs where the straight continuation of each comes nearest to its parent.

    The limbs, parents before children, were made from points a spacing apart; no edge along an axis
    is longer than `step`. Points (n_nodes, 3), parents (n_nodes,) and radii (n_nodes,) are as in
    `Skeleton`; with them comes the limb of each node, (n_nodes,) int64.
    """
    tubes = [smooth(limb.tube, step) for limb in limbs]
    joint = _meeting_places(limbs, tubes, spacing)
    places = [np.arange(len(tube.nodes), dtype=float) for tube in tubes]
    for number, at in joint.items():
        up = limbs[number].parent
        places[up] = np.union1d(places[up], at)
    start = np.concatenate([[0], np.cumsum([len(at) for at in places])])
    nodes = np.vstack(
        [_at(np.column_stack([tube.nodes, tube.radius]), at) for tube, at in zip(tubes, places)]
    )
    owner = np.repeat(np.arange(len(limbs)), np.diff(start))
    inner = np.setdiff1d(np.arange(len(nodes) - 1), start[1:-1] - 1)
    edges = [np.stack([inner, inner + 1], axis=1)]
    for number, at in joint.items():
        up = limbs[number].parent
        edges.append(np.array([[start[up] + np.searchsorted(places[up], at), start[number]]]))
    order, parent = rooted_order(len(nodes), np.vstack(edges), 0)
    return nodes[order, :3], parent, nodes[order, 3], owner[order]


def points_on_axes(
    points: np.ndarray, member: np.ndarray, limbs: list[Limb], spacing: float
) -> np.ndarray:
    """Each point (n_points, 3) at the nearest place of the axis of its limb, `member` (n_points,).

    Where a limb runs inside its parent it has no surface: the points of a piece as long as that,
    where it comes out, spread over both. Limbs and spacing are as in `join_limbs`.
    """
    moved = np.empty((len(points), 3))
    tubes = [limb.tube for limb in limbs]
    met = _meeting_places(limbs, tubes, spacing)
    for number, tube in enumerate(tubes):
        rows = np.flatnonzero(member == number)
        whole = tube
        if number in met:
            meeting = _at(tubes[limbs[number].parent].nodes, np.array([met[number]]))
            radius = np.append(tube.radius[0], tube.radius)
            whole = Tube(np.vstack([meeting, tube.nodes]), radius)
        hidden = whole.length - tube.length
        piece = min(hidden, tube.length)
        way = seen_from(tube, points[rows]).way
        way = np.interp(way, [0.0, piece, tube.length], [0.0, piece + hidden, whole.length])
        moved[rows] = whole.at(way).nodes
    return moved


def _meeting_places(limbs: list[Limb], tubes: list[Tube], spacing: float) -> dict[int, float]:
    """Place of each limb but the stem along its parent's axis in `tubes`, in nodes.

    Those along one parent that are one place are brought together.
    """
    children: dict[int, list[int]] = {}
    for number, limb in enumerate(limbs[1:], start=1):
        children.setdefault(limb.parent, []).append(number)
    found: dict[int, float] = {}
    for up, numbers in children.items():
        parent, own = tubes[up], {n: limbs[n].tube for n in numbers}
        at = {n: _meeting_place(own[n], parent, heading_of(own[n], spacing)) for n in own}
        numbers.sort(key=at.__getitem__)
        places, nodes = np.array([at[n] for n in numbers]), np.arange(len(parent.nodes))
        along = np.interp(places, nodes, parent.way)
        reach = np.maximum(SAME_PLACE * spacing, np.interp(places, nodes, parent.radius))
        group: list[int] = []
        for k in range(len(numbers)):
            if group and along[k] - along[group[0]] > reach[group[0]]:
                group = []
            group.append(k)
            middle = round(float(np.mean(places[group])) * PLACES) / PLACES
            found |= {numbers[member]: middle for member in group}
    return found


def _at(values: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Values at places between nodes."""
    k = np.minimum(places.astype(int), len(values) - 2)
    share = (places - k)[:, None]
    return values[k] * (1 - share) + values[k + 1] * share


def _meeting_place(tube: Tube, parent: Tube, heading: np.ndarray) -> float:
    """Place along the parent, in nodes, where a limb's straight continuation comes nearest."""
    at = np.linspace(0, len(parent.nodes) - 1, PLACES * (len(parent.nodes) - 1) + 1)
    offset = _at(parent.nodes, at) - tube.nodes[0]
    distance = np.linalg.norm(offset, axis=1)
    back = np.maximum(-(offset @ heading), 0.0)
    aside = np.linalg.norm(offset + back[:, None] * heading, axis=1)
    return float(at[np.argmin(aside + NEARNESS * distance)])


def heading_of(tube: Tube, spacing: float) -> np.ndarray:
    """Unit vector along which a limb starts."""
    reach = max(HEADING * spacing, HEADING_IN_RADII * float(np.median(tube.radius[:5])))
    first = tube.nodes[np.linalg.norm(tube.nodes - tube.nodes[0], axis=1) <= reach]
    first = first if len(first) > 1 else tube.nodes[:2]
    heading = np.linalg.svd(first - first.mean(axis=0), full_matrices=False)[2][0]
    return heading if heading @ (tube.nodes[1] - tube.nodes[0]) > 0 else -heading


def back_to(parent: Tube, tube: Tube, spacing: float) -> Tube:
    """A limb with its straight continuation back to where that comes nearest to its parent.

    It has one node more, unless it starts there, within a spacing of its points, already.
    """
    heading = heading_of(tube, spacing)
    meeting = _at(parent.nodes, np.array([_meeting_place(tube, parent, heading)]))[0]
    back = float((tube.nodes[0] - meeting) @ heading)
    if back <= spacing:
        return tube
    start = tube.nodes[0] - back * heading
    return Tube(np.vstack([start, tube.nodes]), np.append(tube.radius[0], tube.radius))
