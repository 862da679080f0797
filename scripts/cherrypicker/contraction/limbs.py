"""Thick wood, whatever it is called, drawn onto the axes of the circles that fit its surface.

A contraction leaves thick wood as a thin tube: several strands beside one another. The stem is
known by its label; limbs are as thick, and labels may be wrong. So the surface itself is asked:
bands of equal way from the foot, over the surface, are rings where they lie on one limb, however
thick, and a circle fits a ring all around and leaves its middle empty. Two limbs that touch, a
fork or a tuft of twigs fit no circle and stay as they are.
"""

import logging

import numba
import numpy as np
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from cherrypicker.geometry.neighbors import knn_edges, sparse_graph
from cherrypicker.geometry.sampling import voxel_thin

__all__ = ["recentre_limbs"]

logger = logging.getLogger(__name__)

N_NEIGHBORS = 8
REACH_IN_SPACINGS = 3.5
SITE_IN_SPACINGS = 1.5
DENSE_SHARE = 0.6  # a cloud that thins to this share is thinned for the rings
BAND_IN_SPACINGS = 2.5
FEWEST_IN_BAND, FEWEST_ON_RING = 4, 10
CHAIN = 8  # most bands each way that a ring is fitted with
SLAB_IN_RADII = 1.0  # half the length of limb that a ring is fitted with
LEAST_RADIUS = 1.5  # spacings: thinner wood contracts to a line
LEAST_SIZE = 0.7  # mean distance of a band's points from their middle, over the least radius
MOST_SPREAD, CLEAR_SPREAD = 0.25, 0.12  # of the radius: what is rougher is no ring
N_SECTORS, SURE_SECTORS, LEAST_SECTORS = 12, 8, 6  # half a turn will do for a clear circle
OUTER, LEAST_ON = 1.3, 0.7  # share of the points within 1.3 radii that lie on the ring
N_ROUNDS, SETTLED = 8, 0.003
TUKEY = 4.0
RIDGE = 1e-3  # holds the centre of a short arc
HOPELESS_SPREAD = 0.5  # of the radius, after two rounds
MOST_STEP, MOST_ASIDE = 1.3, 0.3  # of the radius, between a ring and the next
LEAST_COSINE = np.cos(np.radians(25.0))
RUN_IN_RADII = 2.0  # shortest limb, from its first ring to its last: those two share no points
RINGS_NEAR = 4  # that may claim a point
CLAIM_IN_RADII = 2.0  # along the limb: over a hole, a whorl, the rim of the foot
ON_RING, MOST_OFF = 3.0, 0.5  # spreads, and radii, that a point on a ring lies from the circle


def recentre_limbs(points, contracted, base, *, spacing, taken):
    """Move the contracted points of thick wood onto the axes of the rings of its surface.

    Parameters
    ----------
    points, contracted : ndarray of shape (n_points, 3), float64
        Surface points before and after the contraction.
    base : ndarray of shape (3,)
        Foot of the stem; z up.
    spacing : float
        Distance between surface points.
    taken : ndarray of shape (n_points,), bool
        Points that lie on an axis already, as those of the stem's tube do.

    Returns
    -------
    contracted : ndarray of shape (n_points, 3), float64
    is_moved : ndarray of shape (n_points,), bool
    """
    sites, member, spacing = _sites(points, spacing)
    edges = knn_edges(sites, N_NEIGHBORS, REACH_IN_SPACINGS * spacing)
    if not len(edges):
        return contracted, np.zeros(len(points), dtype=bool)
    band, n_bands, below, above = _bands(sites, edges, base, BAND_IN_SPACINGS * spacing)
    order = np.argsort(band, kind="stable")
    start = np.searchsorted(band[order], np.arange(n_bands + 1))
    sorted_sites = np.ascontiguousarray(sites[order])
    middle = np.stack([np.bincount(band, column, n_bands) for column in sites.T], axis=1)
    middle /= np.maximum(np.bincount(band, minlength=n_bands), 1)[:, None]
    everywhere = np.ones(n_bands, dtype=bool)
    rings = _rings(sorted_sites, start, below, above, middle, spacing, everywhere)
    # again, with directions from the circles' centres, where a limb may be
    near_rings = _around(rings[2] > 0, below, above)
    rings = _rings(sorted_sites, start, below, above, rings[0], spacing, near_rings)
    centre, along, radius, spread = rings
    centre = _smoothed(centre, along, radius, below, above)
    band = band[member]
    sound = np.flatnonzero(_in_runs(centre, along, radius, below, above))
    if taken.any():  # rings around what has an axis are no limbs'
        sound = sound[cKDTree(points[taken]).query(centre[sound])[0] > radius[sound]]
    if not len(sound):
        return contracted, np.zeros(len(points), dtype=bool)
    rings = tuple(part[sound] for part in (centre, along, radius, spread))
    reach = np.ceil(CLAIM_IN_RADII * rings[2] / (BAND_IN_SPACINGS * spacing)).astype(np.int64)
    keys = _chains(sound, reach + 1, below, above)

    def is_own(ring, band):
        key = ring * n_bands + band
        return keys[np.minimum(np.searchsorted(keys, key), len(keys) - 1)] == key

    rows, places = _claimed(points, contracted, rings, spacing, band, is_own)
    is_free = ~taken[rows]
    moved, on = contracted.copy(), np.zeros(len(points), dtype=bool)
    moved[rows[is_free]] = places[is_free]
    on[rows[is_free]] = True
    logger.info("%d rings of limbs take %d points", len(sound), np.count_nonzero(on))
    return moved, on


def _around(rows, below, above):
    """Bands that have a ring, or one of the next two up or down has one."""
    found = np.append(rows, False)
    for way in (below, above):
        rows = rows | found[way] | found[np.append(way, -1)[way]]
    return rows


def _in_runs(centre, along, radius, below, above):
    """Rings that go on along a limb for `RUN_IN_RADII`: no tuft's chance circles.

    Two rings agree when one is among the next two up or down from the other, and their axes and
    radii are alike. Rings that share points agree by chance as well; ends of a run share none.
    """
    last = len(radius)
    radius, below, above = np.append(radius, 0.0), np.append(below, -1), np.append(above, -1)
    rows = np.arange(last)
    pairs = []
    for way in (below, above):
        next_one = way[:last]
        for other in (next_one, way[next_one]):
            step = centre - centre[np.minimum(other, last - 1)]
            axis = along[np.minimum(other, last - 1)]
            aside = np.linalg.norm(step - (step * axis).sum(axis=1)[:, None] * axis, axis=1)
            thin = np.minimum(radius[:last], radius[other])
            alike = np.maximum(radius[:last], radius[other]) <= MOST_STEP * thin
            straight = np.abs((along * axis).sum(axis=1)) >= LEAST_COSINE
            agree = (thin > 0) & alike & straight & (aside <= MOST_ASIDE * thin)
            pairs.append(np.stack([rows[agree], other[agree]], axis=1))
    pairs = np.vstack(pairs)
    n_runs, run = connected_components(sparse_graph(last, pairs, np.ones(len(pairs))), False)
    low, high = np.full((n_runs, 3), np.inf), np.full((n_runs, 3), -np.inf)
    np.minimum.at(low, run, centre)
    np.maximum.at(high, run, centre)
    length = np.linalg.norm(high - low, axis=1)[run]
    return (radius[:last] > 0) & (length >= RUN_IN_RADII * radius[:last])


def _chains(sound, n_each, below, above):
    """Pairs of ring and band whose points it may claim: its own and `n_each` up and down the limb.

    Returns
    -------
    ndarray of int64, sorted
        Number of the ring among `sound` times the number of bands, plus the band.
    """
    below, above = np.append(below, -1), np.append(above, -1)
    number = np.arange(len(sound)) * (len(below) - 1)
    keys = [number + sound]
    for way in (below, above):
        at = sound
        for step in range(1, n_each.max() + 1):
            at = way[at]
            keys.append((number + at)[(at >= 0) & (step <= n_each)])
    return np.unique(np.concatenate(keys))


def _sites(points, spacing):
    """Fewer points of a dense cloud, the site of each point, and the sites' distance.

    Rings need no more.
    """
    size = SITE_IN_SPACINGS * spacing
    sites, _, member = voxel_thin(points, size)
    if len(sites) > DENSE_SHARE * len(points):
        return points, np.arange(len(points)), spacing
    return sites, member, size


def _claimed(points, contracted, rings, spacing, band, is_own):
    """Which points lie on rings, or have contracted into one, and their places on its axis.

    Side limbs leave through a ring as well, but their bands are none of its limb's: `is_own` tells
    for rings and bands, two (n,) int arrays.
    """
    centre, along, radius, spread = rings
    k = min(RINGS_NEAR, len(centre))
    reach = np.hypot(CLAIM_IN_RADII, 1 + MOST_OFF) * radius.max() + BAND_IN_SPACINGS * spacing
    near = cKDTree(centre).query(points, k=k, distance_upper_bound=reach)[1].reshape(-1, k)
    rows = np.flatnonzero(near[:, 0] < len(centre))
    points, contracted, near, band = points[rows], contracted[rows], near[rows], band[rows]
    near = np.where(near < len(centre), near, near[:, :1])
    moved, best = contracted.copy(), np.full(len(rows), np.inf)
    for ring in near.T:
        offset = points - centre[ring]
        place = np.einsum("ij,ij->i", offset, along[ring])
        foot = centre[ring] + place[:, None] * along[ring]
        away = np.linalg.norm(points - foot, axis=1)
        own = radius[ring]
        slack = np.clip(ON_RING * spread[ring], 0.5 * spacing, MOST_OFF * own)
        on = np.abs(away - own) <= slack
        on |= (away < own) & (np.linalg.norm(contracted - foot, axis=1) < own)
        place = np.abs(place)
        on &= place <= np.maximum(CLAIM_IN_RADII * own, BAND_IN_SPACINGS * spacing)
        on &= (place < best) & is_own(ring, band)
        moved[on] = foot[on]
        best[on] = place[on]
    on = np.isfinite(best)
    return rows[on], moved[on]


def _bands(points, edges, base, height):
    """Bands of equal way from the foot: the band of each point, and the next ones of each.

    Returns
    -------
    band : ndarray of shape (n_points,), int64
    n_bands : int
    below, above : ndarray of shape (n_bands,), int64
        Band that most edges lead to from each, towards the foot and away from it, or -1.
    """
    n = len(points)
    length = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    graph = sparse_graph(n, edges, length)
    _, piece = connected_components(graph, directed=False)
    away = np.linalg.norm(points - base, axis=1)
    nearest = np.lexsort((away, piece))
    first = nearest[np.concatenate([[True], np.diff(piece[nearest]) != 0])]
    # from all around the foot: from a single point the first bands would be skewed
    foot = (points[:, 2] <= max(base[2], points[:, 2].min() + height)) & (
        piece == piece[np.argmin(away)]
    )
    sources = np.unique(np.concatenate([first, np.flatnonzero(foot)]))
    way = dijkstra(graph, directed=False, indices=sources, min_only=True)
    level = (way / height).astype(np.int64)
    same = level[edges[:, 0]] == level[edges[:, 1]]
    n_bands, band = connected_components(sparse_graph(n, edges[same], np.ones(same.sum())), False)
    band = band.astype(np.int64)
    across = edges[~same]
    up = level[across[:, 1]] > level[across[:, 0]]
    low = np.where(up, across[:, 0], across[:, 1])
    high = np.where(up, across[:, 1], across[:, 0])
    key, count = np.unique(band[low] * n_bands + band[high], return_counts=True)
    low, high = np.divmod(key, n_bands)
    below, above = np.full(n_bands, -1), np.full(n_bands, -1)
    by_count = np.argsort(count, kind="stable")
    below[high[by_count]] = low[by_count]
    above[low[by_count]] = high[by_count]
    return band, int(n_bands), below, above


@numba.njit(cache=True)
def _rings(points, start, below, above, middle, spacing, asked):
    """Circle of each band: a point on its axis, the axis, radius (0 for none) and spread."""
    n_bands = len(start) - 1
    centre, along = middle.copy(), np.zeros((n_bands, 3))
    radius, spread = np.zeros(n_bands), np.zeros(n_bands)
    chain = np.empty(2 * CHAIN + 1, dtype=np.int64)
    for band in range(n_bands):
        if not asked[band] or start[band + 1] - start[band] < FEWEST_IN_BAND:
            continue
        size = _size(points[start[band] : start[band + 1]], middle[band])
        if size < LEAST_SIZE * LEAST_RADIUS * spacing:
            continue
        reach = max(SLAB_IN_RADII * size, 1.5 * BAND_IN_SPACINGS * spacing)
        n_each = min(CHAIN, int(np.ceil(1.5 * reach / (BAND_IN_SPACINGS * spacing))))
        n, axis = _chain_of(band, n_each, below, above, middle, chain)
        if not axis.any():
            continue
        u = np.zeros(3)
        u[np.argmin(np.abs(axis))] = 1.0
        u -= (u * axis).sum() * axis
        u /= np.sqrt((u**2).sum())
        v = np.cross(axis, u)
        x, y = _slab(points, start, chain[:n], middle[band], axis, u, v, reach)
        if len(x) < FEWEST_ON_RING:
            continue
        cx, cy, r, s = _circle(x, y)
        if _is_ring(x, y, cx, cy, r, s, spacing):
            centre[band] = middle[band] + cx * u + cy * v
            along[band], radius[band], spread[band] = axis, r, s
    return centre, along, radius, spread


@numba.njit(cache=True)
def _size(points, middle):
    total = 0.0
    for row in range(len(points)):
        x, y, z = points[row] - middle
        total += np.sqrt(x * x + y * y + z * z)
    return total / len(points)


@numba.njit(cache=True)
def _chain_of(band, n_each, below, above, middle, chain):
    """A band and the next ones down and up the limb: their number and the limb's direction."""
    low, high, n = band, band, 1
    chain[0] = band
    for _ in range(n_each):
        if below[low] >= 0:
            low = below[low]
            chain[n] = low
            n += 1
        if above[high] >= 0:
            high = above[high]
            chain[n] = high
            n += 1
    axis = middle[high] - middle[low]
    norm = np.sqrt((axis**2).sum())
    return n, axis / norm if norm > 0 else np.zeros(3)


@numba.njit(cache=True)
def _slab(points, start, bands, middle, axis, u, v, reach):
    """Points of bands within `reach` of a plane across the limb, in that plane."""
    total = 0
    for band in bands:
        total += start[band + 1] - start[band]
    x, y, n = np.empty(total), np.empty(total), 0
    for band in bands:
        for row in range(start[band], start[band + 1]):
            a = points[row, 0] - middle[0]
            b = points[row, 1] - middle[1]
            c = points[row, 2] - middle[2]
            if abs(a * axis[0] + b * axis[1] + c * axis[2]) <= reach:
                x[n] = a * u[0] + b * u[1] + c * u[2]
                y[n] = a * v[0] + b * v[1] + c * v[2]
                n += 1
    return x[:n], y[:n]


@numba.njit(cache=True)
def _circle(x, y):
    """Robust circle (Gauss-Newton with Tukey's weights): centre, radius, spread."""
    n = len(x)
    cx, cy = np.median(x), np.median(y)
    away, off = np.empty(n), np.empty(n)
    for row in range(n):
        away[row] = np.sqrt((x[row] - cx) ** 2 + (y[row] - cy) ** 2)
    r, s = np.median(away), 0.0
    for turn in range(N_ROUNDS):
        for row in range(n):
            away[row] = max(np.sqrt((x[row] - cx) ** 2 + (y[row] - cy) ** 2), 1e-9)
            off[row] = abs(away[row] - r)
        s = max(1.4826 * np.median(off), 1e-6)
        if turn > 1 and s > HOPELESS_SPREAD * r:
            break
        aa = ab = bb = ac = bc = cc = ga = gb = gc = 0.0
        for row in range(n):
            w = 1 - (off[row] / (TUKEY * s)) ** 2
            if w <= 0:
                continue
            w *= w
            a, b, residual = (x[row] - cx) / away[row], (y[row] - cy) / away[row], away[row] - r
            aa, ab, bb = aa + w * a * a, ab + w * a * b, bb + w * b * b
            ac, bc, cc = ac + w * a, bc + w * b, cc + w
            ga, gb, gc = ga + w * a * residual, gb + w * b * residual, gc + w * residual
        aa, bb = aa + RIDGE * cc, bb + RIDGE * cc
        # the radius eliminated, two unknowns are left
        p, q, o = aa - ac * ac / cc, bb - bc * bc / cc, ab - ac * bc / cc
        u, v = ga - ac * gc / cc, gb - bc * gc / cc
        determinant = p * q - o * o
        if determinant <= 0:
            break
        dx, dy = (u * q - v * o) / determinant, (v * p - u * o) / determinant
        dr = (gc - ac * dx - bc * dy) / cc
        limit = 0.5 * r
        cx += min(max(dx, -limit), limit)
        cy += min(max(dy, -limit), limit)
        r = max(r + min(max(dr, -limit), limit), 1e-6)
        if abs(dx) + abs(dy) + abs(dr) < SETTLED * r:
            break
    return cx, cy, r, s


@numba.njit(cache=True)
def _is_ring(x, y, cx, cy, r, s, spacing):
    """Whether points go around a circle, near to it, and leave its middle empty."""
    if r < LEAST_RADIUS * spacing or s > MOST_SPREAD * r:
        return False
    filled = np.zeros(N_SECTORS, dtype=np.int64)
    n_on = n_near = 0
    width = max(3 * s, 0.2 * r)
    for row in range(len(x)):
        a, b = x[row] - cx, y[row] - cy
        away = np.sqrt(a * a + b * b)
        if away <= OUTER * r:
            n_near += 1
        if abs(away - r) <= width:
            n_on += 1
            filled[int((np.arctan2(b, a) / (2 * np.pi) + 0.5) * N_SECTORS) % N_SECTORS] = 1
    wanted = LEAST_SECTORS if s < CLEAR_SPREAD * r else SURE_SECTORS
    return n_on >= FEWEST_ON_RING and n_on >= LEAST_ON * n_near and filled.sum() >= wanted


def _smoothed(centre, along, radius, below, above):
    """Centres moved across the axis to the mean of their own and both neighbours' axes."""
    total, weight = centre.copy(), np.ones(len(centre))
    for other in (below, above):
        sound = (other >= 0) & (radius > 0)
        sound[sound] = radius[other[sound]] > 0
        rows = np.flatnonzero(sound)
        near = other[rows]
        # the neighbour's axis where it passes this band
        step = np.einsum("ij,ij->i", centre[rows] - centre[near], along[near])
        total[rows] += centre[near] + step[:, None] * along[near]
        weight[rows] += 1
    return total / weight[:, None]
