"""A tube through points: axis and radius by robust least squares, for wood of any thickness.

Points lie around a limb as Rice says (`cherrypicker.geometry.rice`). Their likelihood is minimised
over all nodes of an axis and their radii at once by Newton's steps on a banded system; a limb bends
in proportion to its thickness and its radius changes slowly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.linalg.lapack import dpbsv

from cherrypicker.compiled import compiled
from cherrypicker.geometry.rice import rice
from cherrypicker.geometry.robust import TUKEY
from cherrypicker.geometry.sections import median

# In spacings: nodes of an axis are this far apart, or a radius where that is more: no limb bends
# faster
STEP = 1.5
ROUGHNESS = 0.25  # of its radius: points this near a surface, and a spacing more, are the limb's
BANDWIDTH = 11  # nodes of four unknowns, coupled with the next two
BEND = 5.0  # a limb bends no more than in an arc of this many (radii + spacings); a guess
TAPER = 0.03  # change of radius by length, one standard deviation; a guess
GROWTH = 0.01  # the same where it would grow outwards; a guess
HOLD = 1e4  # points: how firmly a node keeps its place along the axis, which nothing else tells
MOST_STEP = 0.5  # of the cutoff: a longer step leaves the points that told it
N_ROUNDS = 12
LEAST_STEP = 0.01  # of the spacing: nodes that fall together are taken to be so far apart
LEAST_PIECE = 1e-6  # of an axis: a node nearer to its new end is that end
LEAST_RADIUS_SHARE = 0.5  # of the noise: thinner wood does not tell its radius
# Of its surface, that a tube thicker than its parent has to be covered by its points: thick wood of
# laser scans is covered to 0.5 and more, tubes through two twigs of the paper's trees to 0.45
LEAST_COVER = 1 / 2


@dataclass
class Tube:
    """An axis with radii."""

    nodes: np.ndarray  # (n_nodes, 3) float64: from its start towards its tip
    radius: np.ndarray  # (n_nodes,) float64

    @property
    def length(self) -> float:
        """Length of the axis."""
        return float(_lengths(self.nodes).sum())

    @property
    def way(self) -> np.ndarray:
        """Way along the axis from its start to each node, (n_nodes,) float64."""
        return np.append(0.0, np.cumsum(_lengths(self.nodes)))

    def at(self, places: np.ndarray) -> Tube:
        """The tube through places along its axis, ways from its start, (n,)."""
        way = self.way
        nodes = np.stack([np.interp(places, way, column) for column in self.nodes.T], axis=1)
        return Tube(nodes, np.interp(places, way, self.radius))


@dataclass
class Limb:
    """An axis with radii and the limb that it grows from."""

    tube: Tube  # from where it leaves its parent to its tip
    parent: int  # number of the parent, smaller than its own; -1 for the stem


def claim_radius(radius: np.ndarray, spacing: float) -> np.ndarray:
    """How far from its axis a limb of these radii claims all points, (n,) float64."""
    return (1 + ROUGHNESS) * radius + spacing


def tube_through(rings: list[np.ndarray], height: float) -> Tube:
    """Tube through the middles of a run of rings, points (n, 3) each, of some height.

    A middle is that of as many rings around it as the limb is thick: where points lie far apart for
    its thickness a ring is a patch of the surface.
    """
    place = np.arange(len(rings))
    total = np.array([[*ring.sum(axis=0), len(ring)] for ring in rings])
    total = np.vstack([np.zeros(4), np.cumsum(total, axis=0)])
    radius = np.zeros(len(rings))
    for _ in range(2):  # the first tells how thick it is
        beside = np.minimum((radius / height).astype(int), np.minimum(place, place[::-1]))
        window = total[place + beside + 1] - total[place - beside]
        nodes = window[:, :3] / window[:, 3:]
        away = [np.square(ring - node).sum(axis=1) for ring, node in zip(rings, nodes)]
        radius = np.array([np.sqrt(square.mean()) for square in away])
        radius = np.array([median(radius[max(0, k - 2) : k + 3]) for k in place])
    return Tube(nodes, radius)


def even(tube: Tube, spacing: float) -> Tube:
    """The same tube with nodes evenly apart, by the spacing of its points or by its thickness.

    It has at least two nodes; one whose nodes all lie in one place keeps them.
    """
    if not tube.length:
        return tube
    keep = np.append(True, np.diff(tube.way) > 0)
    tube = Tube(tube.nodes[keep], tube.radius[keep])
    way, density = tube.way, 1.0 / np.maximum(STEP * spacing, tube.radius)
    count = np.append(0.0, np.cumsum(np.diff(way) * (density[1:] + density[:-1]) / 2))
    n_nodes = max(2, round(count[-1]) + 1)
    return tube.at(np.interp(np.linspace(0.0, count[-1], n_nodes), count, way))


def stretch(tube: Tube, start: float, end: float) -> Tube:
    """The tube between two ways along its axis, gone straight on where they lie beyond it."""
    way, least = tube.way, LEAST_PIECE * (end - start)
    inner = way[(way > start + least) & (way < end - least)]
    at = np.concatenate([[start], inner, [end]])
    segment = np.clip(np.searchsorted(way, at) - 1, 0, len(way) - 2)
    step = np.diff(tube.nodes, axis=0)[segment] / np.maximum(np.diff(way), 1e-300)[segment, None]
    nodes = tube.nodes[segment] + (at - way[segment])[:, None] * step
    return Tube(nodes, np.interp(at, way, tube.radius))


def smooth(tube: Tube, step: float) -> Tube:
    """The same tube with nodes at most `step` apart, on a smooth curve through the old ones."""
    way = tube.way
    at = np.linspace(0.0, way[-1], max(2, int(np.ceil(way[-1] / step)) + 1))
    straight = tube.at(at)
    if len(way) < 3:
        return straight
    return Tube(PchipInterpolator(way, tube.nodes)(at), straight.radius)


@compiled
def _square(points: np.ndarray, i: int, nodes: np.ndarray, k: int) -> float:
    """Squared distance of one of some points from one of others."""
    x, y, z = points[i, 0] - nodes[k, 0], points[i, 1] - nodes[k, 1], points[i, 2] - nodes[k, 2]
    return x**2 + y**2 + z**2


@compiled
def _lengths(nodes: np.ndarray) -> np.ndarray:
    """Lengths of the segments between nodes (n, 3), (n - 1,)."""
    found = np.empty(len(nodes) - 1)
    for k in range(len(found)):
        found[k] = np.sqrt(_square(nodes, k, nodes, k + 1))
    return found


@compiled
def place_on_axis(points: np.ndarray, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The nearest place of an axis for each point: its segment and the share along it, (n_points,).

    Segment k lies between the nodes k and k + 1. The share is below 0 before the first node, above
    1 beyond the last.
    """
    segment, share = np.empty(len(points), np.int64), np.empty(len(points))
    node, last = 0, len(nodes) - 2
    # Of eight nodes each, the one in their middle, and how far from it they lie
    middle = np.minimum(np.arange(4, len(nodes) + 4, 8), last + 1)
    wide = np.zeros(len(middle))
    for k in range(len(nodes)):
        wide[k // 8] = max(wide[k // 8], np.sqrt(_square(nodes, middle[k // 8], nodes, k)))
    for i in range(len(points)):
        # The nearest node is no farther than that of the point before
        bound, least = np.sqrt(_square(points, i, nodes, node)), np.inf
        for block in range(len(middle)):
            if _square(points, i, nodes, middle[block]) > 1.001 * (bound + wide[block]) ** 2:
                continue
            for k in range(8 * block, min(8 * block + 8, len(nodes))):
                away = _square(points, i, nodes, k)
                if away < least:
                    node, least = k, away
        least = np.inf
        for k in range(max(node - 1, 0), min(node, last) + 1):
            square = along = 0.0
            for c in range(3):
                step = nodes[k + 1, c] - nodes[k, c]
                square += step * step
                along += (points[i, c] - nodes[k, c]) * step
            along /= max(square, 1e-18)
            inside = min(max(along, 0.0), 1.0)
            away = 0.0
            for c in range(3):
                step = nodes[k + 1, c] - nodes[k, c]
                away += (points[i, c] - nodes[k, c] - inside * step) ** 2
            if away < least:
                least, segment[i], share[i] = away, k, inside
                if (k == 0 and along < 0.0) or (k == last and along > 1.0):
                    share[i] = along
    return segment, share


class Seen(NamedTuple):
    """Points as an axis sees them, (n_points,) float64 each."""

    away: np.ndarray  # distance from the axis, or from its straight continuation
    radius: np.ndarray  # of the tube, at the point's place
    way: np.ndarray  # along the axis from its start; negative before it
    beyond: np.ndarray  # how far before the start or after the tip


def seen_from(tube: Tube, points: np.ndarray) -> Seen:
    """`Seen` of points from a tube."""
    return Seen(*_seen_from(points, tube.nodes, tube.radius))


@compiled
def _seen_from(points: np.ndarray, nodes: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """The fields of `Seen`, (4, n_points)."""
    seen = np.empty((4, len(points)))
    segment, share = place_on_axis(points, nodes)
    way = np.append(0.0, np.cumsum(_lengths(nodes)))
    for i in range(len(points)):
        k, inside, square = segment[i], min(max(share[i], 0.0), 1.0), 0.0
        for c in range(3):
            place = nodes[k, c] + share[i] * (nodes[k + 1, c] - nodes[k, c])
            square += (points[i, c] - place) ** 2
        length = way[k + 1] - way[k]
        seen[0, i] = np.sqrt(square)
        seen[1, i] = radius[k] + inside * (radius[k + 1] - radius[k])
        seen[2, i] = way[k] + share[i] * length
        seen[3, i] = abs(share[i] - inside) * length
    return seen


def fit_tube(
    points: np.ndarray,
    tube: Tube,
    noise: float,
    spacing: float,
    cutoff: float,
    enough: float = np.inf,
    widest: float = np.inf,
) -> tuple[Tube, np.ndarray]:
    """Fit axis and radii to points (n_points, 3), from a tube to start with.

    With the tube comes the distance of each point from its surface, (n_points,), negative inside.
    The noise is the standard deviation of a point in each direction. The spacing, between
    neighbouring points, says how far an axis may bend within it. Farther from the surface than the
    cutoff a point counts no more, at the first round; it falls to Tukey's cutoff of the noise.
    Of points between two nodes `enough` tell as much as more would. No radius is beyond `widest`.
    """
    points = np.ascontiguousarray(points)
    nodes, radius = tube.nodes.copy(), tube.radius.copy()
    least, last = LEAST_RADIUS_SHARE * noise, TUKEY * noise
    for number in range(N_ROUNDS):
        limit = max(last, cutoff * (last / cutoff) ** (number / (N_ROUNDS - 2)))
        scales = noise, spacing, limit, enough
        band, gradient = _equations(points, nodes, radius, scales)
        _, step, info = dpbsv(band.T, gradient, overwrite_ab=1, overwrite_b=1)
        if info:
            raise np.linalg.LinAlgError("the equations of a limb's fit have no solution")
        moved = _move(nodes, radius, step, MOST_STEP * limit, least, max(widest, least))
        if moved < 0.02 * noise and limit == last:
            break
    return Tube(nodes, radius), _offsets(points, nodes, radius)[0]


def covered(points: np.ndarray, tube: Tube, spacing: float, cutoff: float) -> float:
    """Share of a tube's surface on which points (n_points, 3) lie, in cells as wide as the spacing.

    Those farther from it than the cutoff do not count.
    """
    off, _, _, out, _, _ = _offsets(points, tube.nodes, tube.radius)
    on_surface = (points - off[:, None] * out)[np.abs(off) < cutoff]
    cells = np.unique(np.floor(on_surface / spacing), axis=0)
    surface = np.pi * ((tube.radius[1:] + tube.radius[:-1]) * _lengths(tube.nodes)).sum()
    return len(cells) * spacing**2 / surface


@compiled
def _equations(points: np.ndarray, nodes: np.ndarray, radius: np.ndarray, scales: tuple) -> tuple:
    """The equations of a step: their band, its columns in rows, and right side.

    Scales: noise, spacing, limit, enough.
    """
    length = np.maximum(_lengths(nodes), LEAST_STEP * scales[1])
    along = (nodes[1:] - nodes[:-1]) / np.maximum(length, 1e-12).reshape(-1, 1)
    # Derivatives of points and priors by nodes and radii, (n_nodes, 4)
    band, gradient = np.zeros((4 * len(nodes), BANDWIDTH + 1)), np.zeros((len(nodes), 4))
    axis = nodes, radius, length, along
    _add_points(band.T, gradient, points, axis, scales)
    _add_priors(band.T, gradient, axis, scales)
    return band, -gradient.ravel()


@compiled
def _move(
    nodes: np.ndarray, radius: np.ndarray, by: np.ndarray, most: float, least: float, widest: float
) -> float:
    """Go a step, shortened to at most so far, in place; how far the farthest went."""
    step = (by * min(1.0, most / max(np.abs(by).max(), 1e-300))).reshape(-1, 4)
    nodes += step[:, :3]
    radius[:] = np.minimum(np.maximum(radius + step[:, 3], least), widest)
    return float(np.abs(step).max())


@compiled
def _offsets(points: np.ndarray, nodes: np.ndarray, radius: np.ndarray) -> tuple:
    """How points (n, 3) stand to an axis that ends at its ends.

    Distance from its surface and from itself, radius there, the way out (n, 3), segment, and share
    along it as of `place_on_axis`.
    """
    n = len(points)
    off, away, own, out = np.empty(n), np.empty(n), np.empty(n), np.empty((n, 3))
    segment, share = place_on_axis(points, nodes)
    for i in range(n):
        k, inside = segment[i], min(max(share[i], 0.0), 1.0)
        square = 0.0
        for c in range(3):
            out[i, c] = points[i, c] - (nodes[k, c] + inside * (nodes[k + 1, c] - nodes[k, c]))
            square += out[i, c] * out[i, c]
        away[i] = np.sqrt(square)
        for c in range(3):
            out[i, c] /= max(away[i], 1e-12)
        own[i] = radius[k] + inside * (radius[k + 1] - radius[k])
        off[i] = away[i] - own[i]
    return off, away, own, out, segment, share


@compiled
def _add_points(
    band: np.ndarray, gradient: np.ndarray, points: np.ndarray, axis: tuple, scales: tuple
) -> None:
    """The derivatives of `rice` by nodes and radii, times noise^2, into the equations."""
    nodes, radius, length, along = axis
    noise, spacing, limit, enough = scales
    off, away, own, out, segment, share = _offsets(points, nodes, radius)
    weight, told = np.zeros(len(points)), np.zeros(len(length))
    for i in range(len(points)):
        inside = min(max(share[i], 0.0), 1.0)
        if abs(share[i] - inside) * length[segment[i]] <= spacing:
            weight[i] = max(0.0, 1.0 - (off[i] / limit) ** 2) ** 2
            told[segment[i]] += weight[i]
    block, force, aside = np.empty((4, 4)), np.empty(4), np.empty(3)
    for i in range(len(points)):
        if weight[i] == 0.0:
            continue
        k = segment[i]
        robust = weight[i] * (min(1.0, enough / max(told[k], 1e-9)) / noise**2)
        by_away, by_radius, h_out, h_side, h_radius, h_cross = rice(away[i], own[i], noise, 0.0)
        for a in range(3):  # across the axis and the way out; shorter where these are not across
            b, c = (a + 1) % 3, (a + 2) % 3
            aside[a] = along[k, b] * out[i, c] - along[k, c] * out[i, b]
        # distance grows with p - c: derivatives by the axis have the opposite sign
        for a in range(3):
            for b in range(3):
                block[a, b] = h_out * out[i, a] * out[i, b] + h_side * aside[a] * aside[b]
            block[a, 3] = block[3, a] = -h_cross * out[i, a]
            force[a] = -by_away * out[i, a]
        block[3, 3] = h_radius
        force[3] = by_radius
        two = min(max(share[i], 0.0), 1.0)
        one = 1.0 - two
        for a in range(4):
            gradient[k, a] += robust * one * force[a]
            gradient[k + 1, a] += robust * two * force[a]
            for b in range(4):
                value = robust * block[a, b]
                if b >= a:
                    band[BANDWIDTH + a - b, 4 * k + b] += one * one * value
                    band[BANDWIDTH + a - b, 4 * k + 4 + b] += two * two * value
                band[BANDWIDTH + a - b - 4, 4 * k + 4 + b] += one * two * value


@compiled
def _add_priors(band: np.ndarray, gradient: np.ndarray, axis: tuple, scales: tuple) -> None:
    """Bends, tapers, and nodes that do not slide along the axis: nothing else would hold them."""
    nodes, radius, length, along = axis
    noise, spacing, n = scales[0], scales[1], len(nodes)
    turn = np.empty(3)
    for k in range(n - 2):
        turn[0], turn[2] = 1 / length[k], 1 / length[k + 1]
        turn[1] = -turn[0] - turn[2]
        reach = (length[k] + length[k + 1]) / 2
        bend = (BEND * (radius[k + 1] + spacing) / reach) ** 2
        for c in range(3):
            change = 0.0
            for a in range(3):
                change += turn[a] * nodes[k + a, c]
            for a in range(3):
                gradient[k + a, c] += turn[a] * bend * change
                for b in range(a, 3):
                    band[BANDWIDTH - 4 * (b - a), 4 * (k + b) + c] += turn[a] * turn[b] * bend
    for k in range(n - 1):
        rise = radius[k + 1] - radius[k]
        stiff = 1.0 / ((GROWTH if rise > 0 else TAPER) * length[k]) ** 2
        gradient[k, 3] -= stiff * rise
        gradient[k + 1, 3] += stiff * rise
        band[BANDWIDTH, 4 * k + 3] += stiff
        band[BANDWIDTH, 4 * k + 7] += stiff
        band[BANDWIDTH - 4, 4 * k + 7] -= stiff
    for k in range(n):
        tangent = along[max(k - 1, 0)] + along[min(k, n - 2)]
        tangent /= max(np.sqrt(np.square(tangent).sum()), 1e-12)
        for b in range(4):
            band[BANDWIDTH, 4 * k + b] += 1e-3 / noise**2
        for b in range(3):
            for a in range(b + 1):
                band[BANDWIDTH + a - b, 4 * k + b] += HOLD / noise**2 * tangent[a] * tangent[b]
