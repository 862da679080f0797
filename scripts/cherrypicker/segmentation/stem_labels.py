"""Share the wood of a cloud out to trunk and branch along traced stems."""

import logging

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import Label, wood_mask
from cherrypicker.segmentation.stem_axis import trace_stems
from cherrypicker.segmentation.white_rings import ring_points

logger = logging.getLogger(__name__)

STEP_M = 0.005  # axes are sampled at this distance
INSIDE = 1.08  # up to this share of its radius a point is inside the stem
INSIDE_M = 0.0015
REACH_M = 0.03  # loose points this far off the stem's surface can still be its own
END_CAP = 0.6  # a trunk that ends at a fork is closed by a dome of this share of its radius
REACHES = 0.03  # how near a wood point lies to the thinned wood of the tree it belongs to


def relabel_wood(points, labels, frame, model=None, colors=None):
    """Decide between trunk and branch by the course of the stems.

    Every stem that stands in the cloud is trunk from the ground to where the rule of the labels
    ends it; other wood is branch. Where the geometry cannot be trusted the labels stay.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
        In the cloud's frame.
    labels : ndarray of shape (n_points,), uint8
    frame : cherrypicker.segmentation.spheres.TreeFrame
    model : cherrypicker.segmentation.stem_axis.StemModel, optional
    colors : ndarray of shape (n_points, 3), optional
        In [0, 1]; white rings on the stems become calibration unit.

    Returns
    -------
    ndarray of shape (n_points,), uint8
        A copy; only what was trunk or branch differs.
    """
    result = labels.copy()
    rows = np.flatnonzero(wood_mask(labels))
    wood = frame.apply(points[rows])
    ground = frame.apply(points[labels == Label.GROUND])
    stems, thin = trace_stems(wood, ground[:: max(1, len(ground) // 50_000)], model)
    if not any(stem.is_sound for stem in stems):
        logger.warning("no stem could be traced; trunk and branch stay as the network has them")
        return result
    owner = np.full(len(thin), -1)
    for index, stem in enumerate(stems):
        owner[stem.rows] = index
    distance, nearest = cKDTree(thin).query(wood, workers=1)
    owner = np.where(distance <= REACHES, owner[nearest], -1)
    result[rows[owner < 0]] = Label.BRANCH  # nothing connects it to a stem
    for index, stem in enumerate(stems):
        own = np.flatnonzero(owner == index)
        if stem.is_sound:
            is_trunk = on_stem(wood[own], stem)
            result[rows[own]] = np.where(is_trunk, Label.TRUNK, Label.BRANCH)
            if colors is not None:
                on = rows[own[is_trunk]]
                # in true metres: a tall tree's ring is shrunk with it
                places, radius = _dense(stem.points / frame.scale, stem.radius / frame.scale)
                is_ring = ring_points(wood[own[is_trunk]] / frame.scale, colors[on], places, radius)
                result[on[is_ring]] = Label.CALIBRATION_UNIT
        _log_stem(stem, len(own))
    changed = np.count_nonzero(result[rows] != labels[rows])
    logger.info("the stems' course changed %.1f %% of the wood", 100 * changed / len(rows))
    return result


def on_stem(points, stem):
    """Which points lie on the surface of a stem rather than of the branches on it.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3), float64
        Wood in the frame of the stem.
    stem : cherrypicker.segmentation.stem_axis.StemAxis

    Returns
    -------
    ndarray of shape (n_points,), bool
    """
    places, radius = _dense(stem.points, stem.radius)
    distance, nearest = cKDTree(places).query(points, workers=1)
    off = distance - radius[nearest]  # from the stem's surface, outwards
    inside = distance <= INSIDE * radius[nearest] + INSIDE_M
    branch_off = _off_branches(points, stem, places, radius)
    is_trunk = inside | ((off <= REACH_M) & (off < branch_off))
    if stem.ends_at_fork and len(places) > 1:
        heading = places[-1] - places[max(0, len(places) - 1 - int(np.ceil(radius[-1] / STEP_M)))]
        heading /= np.linalg.norm(heading)
        beyond = (points - places[-1]) @ heading
        is_trunk &= (nearest < len(places) - 1) | (beyond <= END_CAP * radius[-1])
    return is_trunk


def _dense(points, radius):
    """An axis sampled every `STEP_M`, down to the ground below its first node."""
    position = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.append(np.arange(0.0, position[-1], STEP_M), position[-1])
    places = np.stack([np.interp(at, position, column) for column in points.T], axis=1)
    foot = places[0] - np.outer(np.arange(20, 0, -1) * STEP_M, [0.0, 0.0, 1.0])
    thick = np.interp(at, position, radius)
    return np.vstack([foot, places]), np.concatenate([np.full(20, thick[0]), thick])


def _off_branches(points, stem, places, radius):
    """Distance of points from the surface of the nearest branch, (n_points,)."""
    skeleton = stem.branches
    nodes = np.flatnonzero(stem.is_branch & (np.arange(len(skeleton)) > 0))
    if not len(nodes):
        return np.full(len(points), np.inf)
    below = skeleton.points[skeleton.parent[nodes]]
    n_steps = max(1, int(np.ceil(np.quantile(skeleton.edge_length[nodes], 0.9) / STEP_M)))
    share = (np.arange(n_steps) / n_steps)[:, None, None]
    sampled = (skeleton.points[nodes] * (1 - share) + below * share).reshape(-1, 3)
    thick = np.tile(skeleton.radius[nodes], n_steps)
    to_axis, nearest = cKDTree(places).query(sampled, workers=1)
    outside = to_axis > radius[nearest]
    if not outside.any():
        return np.full(len(points), np.inf)
    distance, nearest = cKDTree(sampled[outside]).query(points, workers=1)
    return distance - thick[outside][nearest]


def _log_stem(stem, n_points):
    logger.info(
        "stem at (%.2f, %.2f): %.2f m up to %s, radius %.1f to %.1f mm, %s wood points%s",
        *stem.points[0, :2],
        np.linalg.norm(np.diff(stem.points, axis=0), axis=1).sum(),
        "a fork" if stem.ends_at_fork else "its tip",
        1000 * stem.radius[0],
        1000 * stem.radius[-1],
        f"{n_points:,}",
        "" if stem.is_sound else "; not clear enough, the network's labels stay",
    )
