"""A tube through points: axis and radius by robust least squares, for wood of any thickness.

A point on a limb's surface, measured with noise of standard deviation s, lies at a distance q from
the axis that has Rice's distribution: for a thick limb the distance to the surface counts, for a
twig thinner than the noise the distance to the axis, and in between the likelihood

    -log p = (q^2 + r^2) / (2 s^2) - log I0(q r / s^2)

says how much of either (Rice, "Mathematical analysis of random noise", 1945). It is minimised over
all nodes of an axis and their radii at once by Newton's steps on a banded system; a limb bends in
proportion to its thickness and its radius changes slowly.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.linalg import solveh_banded
from scipy.spatial import cKDTree
from scipy.special import i0e, i1e

__all__ = ["Seen", "Tube", "fit_tube", "place_on_axis", "resample", "seen_from", "smooth"]

BAND = 11  # nodes of four unknowns, coupled with the next two
BEND = 5.0  # a limb bends no more than in an arc of this many (radii + spacings); a guess
TAPER = 0.03  # change of radius by length, one standard deviation; a guess
GROWTH = 0.01  # the same where it would grow outwards; a guess
INDEPENDENT = 10.0  # points between two nodes that tell as much as more would: bark is no noise
THICK_IN_NOISES = 2.0, 4.0  # from here to there a limb's points are taken to lie on what was seen
HOLD = 1e4  # points: how firmly a node keeps its place along the axis, which nothing else tells
CUTOFF = 4.685  # Tukey's, for 95 % efficiency
MOST_STEP = 0.5  # of the cutoff: a longer step leaves the points that told it
N_ROUNDS = 12
LEAST_RADIUS_SHARE = 0.5  # of the noise: thinner wood does not tell its radius


@dataclass
class Tube:
    """An axis with radii.

    Attributes
    ----------
    nodes : ndarray of shape (n_nodes, 3), float64
        From its start towards its tip.
    radius : ndarray of shape (n_nodes,), float64
    """

    nodes: np.ndarray
    radius: np.ndarray

    @property
    def length(self):
        """Length of the axis."""
        return float(np.linalg.norm(np.diff(self.nodes, axis=0), axis=1).sum())

    @property
    def way(self):
        """Way along the axis from its start to each node, (n_nodes,) float64."""
        return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(self.nodes, axis=0), axis=1)))


def resample(tube, least, in_radii):
    """The same tube with nodes evenly apart: `least`, or `in_radii` local radii where that is more.

    Returns
    -------
    Tube or None
        With at least two nodes; None where all lie in one place.
    """
    way = tube.way
    keep = np.append(True, np.diff(way) > 0)
    way, nodes, radius = way[keep], tube.nodes[keep], tube.radius[keep]
    if len(way) < 2:
        return None
    density = 1.0 / np.maximum(least, in_radii * radius)
    count = np.append(0.0, np.cumsum(np.diff(way) * (density[1:] + density[:-1]) / 2))
    at = np.interp(np.linspace(0.0, count[-1], max(2, round(count[-1]) + 1)), count, way)
    new = np.stack([np.interp(at, way, column) for column in nodes.T], axis=1)
    return Tube(new, np.interp(at, way, radius))


def smooth(tube, step):
    """The same tube with nodes at most `step` apart, on a smooth curve through the old ones."""
    way = tube.way
    at = np.linspace(0.0, way[-1], max(2, int(np.ceil(way[-1] / step)) + 1))
    if len(way) < 3:
        return Tube(
            np.stack([np.interp(at, way, column) for column in tube.nodes.T], axis=1),
            np.interp(at, way, tube.radius),
        )
    nodes = PchipInterpolator(way, tube.nodes)(at)
    return Tube(nodes, np.interp(at, way, tube.radius))


def place_on_axis(points, nodes):
    """The nearest place of an axis for each point.

    Returns
    -------
    segment : ndarray of shape (n_points,), int64
        Segment k lies between the nodes k and k + 1.
    share : ndarray of shape (n_points,), float64
        Way along the segment: below 0 before the first node, above 1 beyond the last.
    """
    start, step = nodes[:-1], np.diff(nodes, axis=0)
    square = np.maximum(np.square(step).sum(axis=1), 1e-18)
    node = cKDTree(nodes).query(points)[1]
    last = len(start) - 1
    best = np.full(len(points), np.inf)
    segment, share = np.zeros(len(points), dtype=np.int64), np.zeros(len(points))
    for k in (np.maximum(node - 1, 0), np.minimum(node, last)):
        offset = points - start[k]
        along = np.einsum("ij,ij->i", offset, step[k]) / square[k]
        inside = np.clip(along, 0.0, 1.0)
        away = np.square(offset - inside[:, None] * step[k]).sum(axis=1)
        beyond = ((k == 0) & (along < 0)) | ((k == last) & (along > 1))
        nearer = away < best
        best[nearer], segment[nearer] = away[nearer], k[nearer]
        share[nearer] = np.where(beyond, along, inside)[nearer]
    return segment, share


@dataclass
class Seen:
    """Points as an axis sees them, each an ndarray of shape (n_points,).

    Attributes
    ----------
    away : float64
        Distance from the axis, or from its straight continuation.
    radius : float64
        Of the tube, at the point's place.
    way : float64
        Along the axis from its start; negative before it.
    beyond : float64
        How far before the start or after the tip.
    """

    away: np.ndarray
    radius: np.ndarray
    way: np.ndarray
    beyond: np.ndarray

    def select(self, keep):
        """Those of the points that `keep` (bool) names."""
        return Seen(self.away[keep], self.radius[keep], self.way[keep], self.beyond[keep])


def seen_from(tube, points):
    """`Seen` of points from a tube."""
    segment, share = place_on_axis(points, tube.nodes)
    inside = np.clip(share, 0.0, 1.0)
    way = tube.way
    length = np.diff(way)
    place = tube.nodes[segment] + share[:, None] * np.diff(tube.nodes, axis=0)[segment]
    return Seen(
        np.linalg.norm(points - place, axis=1),
        tube.radius[segment] + inside * np.diff(tube.radius)[segment],
        way[segment] + share * length[segment],
        np.abs(share - inside) * length[segment],
    )


def fit_tube(points, tube, *, noise, spacing, cutoff, n_rounds=N_ROUNDS):
    """Fit axis and radii to points.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
    tube : Tube
        Where to start.
    noise : float
        Standard deviation of a point in each direction.
    spacing : float
        Between neighbouring points: how far an axis may bend within it.
    cutoff : float
        Distance from the surface from which a point counts no more, at the first round; it falls
        to `CUTOFF` times the noise.
    n_rounds : int

    Returns
    -------
    tube : Tube
    residual : ndarray of shape (n_points,), float64
        Distance of each point from the surface, negative inside.
    """
    nodes, radius = tube.nodes.copy(), tube.radius.copy()
    last = CUTOFF * noise
    for number in range(n_rounds):
        limit = max(last, cutoff * (last / cutoff) ** (number / max(1, n_rounds - 2)))
        step = _newton_step(points, nodes, radius, noise, spacing, limit)
        step *= min(1.0, MOST_STEP * limit / max(np.abs(step).max(), 1e-300))
        nodes += step[:, :3]
        radius = np.maximum(radius + step[:, 3], LEAST_RADIUS_SHARE * noise)
        if np.abs(step).max() < 0.02 * noise and limit == last:
            break
    segment, share = place_on_axis(points, nodes)
    inside = np.clip(share, 0, 1)
    away, _, own = _offsets(points, nodes, radius, segment, inside)
    return Tube(nodes, radius), away - own


def _offsets(points, nodes, radius, segment, share):
    """Distance from the axis, its direction, and the radius there."""
    place = nodes[segment] + share[:, None] * (nodes[segment + 1] - nodes[segment])
    offset = points - place
    away = np.linalg.norm(offset, axis=1)
    own = radius[segment] + share * (radius[segment + 1] - radius[segment])
    return away, offset / np.maximum(away, 1e-12)[:, None], own


def _newton_step(points, nodes, radius, noise, spacing, limit):
    segment, share = place_on_axis(points, nodes)
    inside = np.clip(share, 0.0, 1.0)
    away, out, own = _offsets(points, nodes, radius, segment, inside)
    length = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
    beyond = np.abs(share - inside) * length[segment]
    error = away - own
    robust = np.square(np.maximum(0.0, 1.0 - np.square(error / limit)))
    robust = np.where(beyond > spacing, 0.0, robust)
    told = np.bincount(segment, robust, len(nodes) - 1)
    robust = robust * np.minimum(1.0, INDEPENDENT / np.maximum(told, 1e-9))[segment] / noise**2
    # Rice: first and second derivatives by the distance q and the radius r, times noise^2
    kappa = away * own / noise**2
    ratio, slope = _pull(kappa, own / noise)
    g_out, g_radius = away - own * ratio, own - away * ratio
    h_out = np.clip(1.0 - np.square(own / noise) * slope, 0.1, 1.0)
    h_side = np.clip(1.0 - own * ratio / np.maximum(away, 1e-12), 0.0, 1.0)
    h_radius = np.clip(1.0 - np.square(away / noise) * slope, 0.1, 1.0)
    h_cross = -np.minimum(ratio + kappa * slope, 0.999 * np.sqrt(h_out * h_radius))
    along = np.diff(nodes, axis=0) / np.maximum(length, 1e-12)[:, None]
    axis = along[segment]
    # distance grows with p - c: derivatives by the axis have the opposite sign
    side = np.eye(3) - out[:, :, None] * out[:, None, :] - axis[:, :, None] * axis[:, None, :]
    block = np.zeros((len(points), 4, 4))
    block[:, :3, :3] = h_out[:, None, None] * out[:, :, None] * out[:, None, :]
    block[:, :3, :3] += h_side[:, None, None] * side
    block[:, :3, 3] = block[:, 3, :3] = -h_cross[:, None] * out
    block[:, 3, 3] = h_radius
    force = np.concatenate([-g_out[:, None] * out, g_radius[:, None]], axis=1)
    return _solve(
        nodes, radius, segment, inside, robust[:, None, None] * block, robust[:, None] * force,
        noise, spacing, along,
    )  # fmt: skip


def _pull(kappa, thickness):
    """I1 / I0 of Rice's distribution and its slope, without what pulls an arc into a circle.

    Rice's points lie all around. Those of a limb seen from one side do not, and the density on a
    smaller circle would make up for a worse fit: the term of the density, half the logarithm of
    `kappa` where that is large, is left out for limbs thicker than the noise. For thinner ones it
    stays, else any line of points would do as the flank of a thick limb.
    """
    ratio = i1e(kappa) / i0e(kappa)
    slope = np.where(kappa > 1e-6, 1.0 - ratio / np.maximum(kappa, 1e-6) - ratio**2, 0.5)
    low, high = THICK_IN_NOISES
    seen = np.clip((thickness - low) / (high - low), 0.0, 1.0)
    square = np.square(kappa)
    ratio = ratio + seen * kappa / (2 * (1 + square))
    return ratio, slope + seen * (1 - square) / (2 * np.square(1 + square))


def _solve(nodes, radius, segment, share, block, force, noise, spacing, along):
    """One step of all unknowns from the points' second and first derivatives, with the priors."""
    n = len(nodes)
    one, other = (1.0 - share)[:, None], share[:, None]
    flat = block.reshape(-1, 16)
    parts = (one**2 * flat, other**2 * flat, one * other * flat, one * force, other * force)
    sums = _sums(segment, np.hstack(parts), n - 1)
    first, second, beside = (sums[:, k : k + 16].reshape(-1, 4, 4) for k in (0, 16, 32))
    diagonal, gradient = np.zeros((n, 4, 4)), np.zeros((n, 4))
    diagonal[:-1] += first
    diagonal[1:] += second
    gradient[:-1] += sums[:, 48:52]
    gradient[1:] += sums[:, 52:]
    band = np.zeros((BAND + 1, 4 * n))
    _into_band(band, diagonal, 0)
    _into_band(band, beside, 1)
    step = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
    if n > 2:
        reach = (step[:-1] + step[1:]) / 2
        bend = np.square(BEND * (radius[1:-1] + spacing) / np.square(reach))
        second = nodes[:-2] - 2 * nodes[1:-1] + nodes[2:]
        for a, ca in ((0, 1.0), (1, -2.0), (2, 1.0)):
            gradient[a : n - 2 + a, :3] += (ca * bend)[:, None] * second
            for b, cb in ((0, 1.0), (1, -2.0), (2, 1.0)):
                if b >= a:
                    for c in range(3):
                        columns = 4 * (np.arange(n - 2) + b) + c
                        band[BAND - 4 * (b - a), columns] += ca * cb * bend
    rise = np.diff(radius)
    stiff = 1.0 / np.square(np.where(rise > 0, GROWTH, TAPER) * step)
    gradient[:-1, 3] -= stiff * rise
    gradient[1:, 3] += stiff * rise
    columns = 4 * np.arange(n) + 3
    band[BAND, columns[:-1]] += stiff
    band[BAND, columns[1:]] += stiff
    band[BAND - 4, columns[1:]] -= stiff
    # nodes do not slide along the axis: nothing else would hold them
    tangent = np.vstack([along[:1], along[:-1] + along[1:], along[-1:]])
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1), 1e-12)[:, None]
    hold = HOLD / noise**2
    still = np.zeros((n, 4, 4))
    still[:, :3, :3] = hold * tangent[:, :, None] * tangent[:, None, :]
    still += 1e-3 / noise**2 * np.eye(4)
    _into_band(band, still, 0)
    return solveh_banded(band, -gradient.ravel(), check_finite=False).reshape(n, 4)


def _sums(rows, values, n_rows):
    """Sums of the values (m, k) of each row: (n_rows, k)."""
    order = np.argsort(rows, kind="stable")
    filled, start = np.unique(rows[order], return_index=True)
    sums = np.zeros((n_rows, values.shape[1]))
    if len(filled):
        sums[filled] = np.add.reduceat(values[order], start)
    return sums


def _into_band(band, blocks, offset):
    """Blocks (n, 4, 4) that couple node k with node k + offset into the upper band."""
    a, b = np.nonzero(np.triu(np.ones((4, 4)))) if offset == 0 else np.nonzero(np.ones((4, 4)))
    row = 4 * np.arange(len(blocks))[:, None] + a
    column = 4 * (np.arange(len(blocks))[:, None] + offset) + b
    band[BAND + row - column, column] += blocks[:, a, b]
