"""Find stems: thin, upright structures that stand on the ground, in a cloud without scale."""

from dataclasses import asdict, dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

# Fractions of the cameras' distance to what they look at. Trees are photographed so that they fill
# the frame: a stem of 4 to 30 cm seen from 2.5 to 5 m lies well inside these.
_CELL = 0.015
_FINE_CELL = 0.006
_LAYER = 0.02
_FOOT_BAND = (0.04, 0.16)
_REACH_UP = 0.5
_MIN_HEIGHT = 0.18
_MAX_RADIUS = 0.09
_MAX_LEAN_DEG = 30.0
_N_SECTORS = 12
_CROWN_SECTORS = 5
# Signs end below; a tree that fills the frame does not.
_CROWN_FROM = 0.38


@dataclass(frozen=True)
class Stem:
    """A stem candidate; lengths in the cloud's unit.

    Attributes
    ----------
    x, y : float
        Foot: its axis extended down to the ground.
    radius : float
        Median distance of the foot's points from its axis.
    height : float
        How high the structure could be followed from layer to layer.
    lean_deg : float
        Angle of its axis to z.
    wobble : float
        Root mean square deviation of the structure from its straight axis.
    n_points : int
        Points of the foot.
    crown_sectors : int
        In how many of 12 directions wood reaches out above: a post or a sign has few, but for one
        that stands within a crown.
    distance : float
        Horizontal distance of the foot to the point that the cameras look at.
    """

    x: float
    y: float
    radius: float
    height: float
    lean_deg: float
    wobble: float
    n_points: int
    crown_sectors: int
    distance: float

    @property
    def has_crown(self):
        """Whether it looks like a tree rather than a bare post."""
        return self.crown_sectors >= _CROWN_SECTORS

    def as_dict(self):
        """Plain dictionary for JSON."""
        return asdict(self)


def find_stems(points, look_at_xy, distance, ground_z=0.0, reach=1.5):
    """Find the stems around the point that the cameras look at, the likeliest target first.

    A stem's cells are occupied in nearly every layer from just above the ground upwards, its
    footprint is small, and it can be followed further up. The target is the nearest to the
    look-at point; a structure with a crown wins over a bare post that stands a little nearer.

    Parameters
    ----------
    points : ndarray of shape (n_points, 3)
        z up, ground at about `ground_z`.
    look_at_xy : array-like of shape (2,)
    distance : float
        Cameras' median distance to the look-at point, the unit of all thresholds.
    ground_z : float or callable, default 0
        Height of the ground, or a function of an (n, 2) array of x, y.
    reach : float, default 1.5
        Search radius in units of `distance`.

    Returns
    -------
    list of Stem
        Empty where nothing stands upright (a statue, say).
    """
    look_at_xy = np.asarray(look_at_xy, float)
    offsets = points[:, :2] - look_at_xy
    near = (np.abs(offsets) < reach * distance).all(axis=1)
    ground = ground_z(points[near, :2]) if callable(ground_z) else ground_z
    local = np.column_stack([offsets[near], points[near, 2] - ground]) / distance
    band = local[(local[:, 2] > 0) & (local[:, 2] < _REACH_UP)]
    if len(band) < 30:
        return []
    stems = []
    for footprint in _footprints(band, reach):
        for center, capture in _split(band, footprint):
            stem = _measure(local, band, center, capture)
            if stem is not None:
                stems.append(stem)
    stems = _rank(_with_crowns(_merge(stems), local))
    return [_in_units(stem, distance, look_at_xy) for stem in stems]


def _footprints(band, reach):
    """Centres of the cells of each small footprint that is filled from the ground upwards."""
    n = int(np.ceil(2 * reach / _CELL))
    first, last = (int(round(value / _LAYER)) for value in _FOOT_BAND)
    layer = (band[:, 2] / _LAYER).astype(int)
    foot = band[(layer >= first) & (layer < last)]
    columns = np.clip(((foot[:, :2] + reach) / _CELL).astype(int), 0, n - 1)
    occupied = np.zeros((n, n, last - first), bool)
    occupied[columns[:, 0], columns[:, 1], (foot[:, 2] / _LAYER).astype(int) - first] = True
    grown = ndimage.binary_dilation(occupied, structure=np.ones((3, 3, 1), bool))
    standing = (grown.mean(axis=2) >= 0.8) & occupied.any(axis=2)
    labels, _ = ndimage.label(standing, structure=np.ones((3, 3), int))
    footprints = []
    for label, (rows, lines) in enumerate(ndimage.find_objects(labels), 1):
        extent = max(rows.stop - rows.start, lines.stop - lines.start) * _CELL
        if extent <= 2.5 * _MAX_RADIUS + 0.05:
            footprints.append((np.argwhere(labels == label) + 0.5) * _CELL - reach)
    return footprints


def _split(band, footprint):
    """Centre and capture radius of each structure in a footprint: a stem and its support post.

    Seen from above on a fine grid the two part where a finger's width lies between them.
    """
    center = footprint.mean(axis=0)
    foot = band[(band[:, 2] > _FOOT_BAND[0]) & (band[:, 2] < _FOOT_BAND[1])]
    reach = np.abs(footprint - center).max() + _CELL
    foot = foot[(np.abs(foot[:, :2] - center) < reach).all(axis=1)]
    n = int(np.ceil(2 * reach / _FINE_CELL))
    cells = np.clip(((foot[:, :2] - center + reach) / _FINE_CELL).astype(int), 0, n - 1)
    plan = np.zeros((n, n), bool)
    plan[cells[:, 0], cells[:, 1]] = True
    plan = ndimage.binary_closing(np.pad(plan, 2), structure=np.ones((3, 3)))[2:-2, 2:-2]
    labels, n_labels = ndimage.label(plan, structure=np.ones((3, 3), int))
    n_layers = (_FOOT_BAND[1] - _FOOT_BAND[0]) / _LAYER
    parts = []
    for label in range(1, n_labels + 1):
        own = foot[labels[cells[:, 0], cells[:, 1]] == label]
        if len(np.unique((own[:, 2] / _LAYER).astype(int))) >= 0.6 * n_layers:
            low, high = np.percentile(own[:, :2], [3, 97], axis=0)
            parts.append((0.5 * (low + high), 0.5 * (high - low).max() + _CELL))
    if not parts:
        return [(center, _MAX_RADIUS)]
    return [(middle, min(capture, _MAX_RADIUS)) for middle, capture in parts]


def _measure(local, band, center, capture):
    """The structure at a footprint, in units of the cameras' distance; None if it is no stem."""
    track = _follow(band, center, capture)
    if len(track) < 4 or track[-1, 2] < _MIN_HEIGHT:
        return None
    low = track[track[:, 2] < max(0.25, _MIN_HEIGHT + _LAYER)]
    slope_x, foot_x = np.polyfit(low[:, 2], low[:, 0], 1)
    slope_y, foot_y = np.polyfit(low[:, 2], low[:, 1], 1)
    lean = np.degrees(np.arctan(np.hypot(slope_x, slope_y)))
    if lean > _MAX_LEAN_DEG:
        return None
    axis_x, axis_y = foot_x + slope_x * local[:, 2], foot_y + slope_y * local[:, 2]
    ranges = np.hypot(local[:, 0] - axis_x, local[:, 1] - axis_y)
    in_foot = (local[:, 2] > _FOOT_BAND[0]) & (local[:, 2] < 0.25)
    foot = in_foot & (ranges < capture)
    if not foot.any():
        return None
    radius = float(np.median(ranges[foot]))
    if radius > _MAX_RADIUS or _goes_on_beside(local, ranges, foot_x, foot_y):
        return None
    straight_x = np.polyval(np.polyfit(track[:, 2], track[:, 0], 1), track[:, 2])
    straight_y = np.polyval(np.polyfit(track[:, 2], track[:, 1], 1), track[:, 2])
    wobble = np.hypot(track[:, 0] - straight_x, track[:, 1] - straight_y)
    return Stem(
        x=float(foot_x),
        y=float(foot_y),
        radius=radius,
        height=float(track[-1, 2]),
        lean_deg=float(lean),
        wobble=float(np.sqrt(np.mean(wobble**2))),
        n_points=int(foot.sum()),
        crown_sectors=0,
        distance=float(np.hypot(foot_x, foot_y)),
    )


def _with_crowns(stems, local):
    """Count the directions in which wood reaches out above each stem.

    What is nearer to another stem is that one's wood: a sign under a crown has none of its own.
    """
    if not stems:
        return []
    above = local[local[:, 2] > _CROWN_FROM]
    feet = np.array([[stem.x, stem.y] for stem in stems])
    gaps, owners = cKDTree(feet).query(above[:, :2])
    result = []
    for index, stem in enumerate(stems):
        own = above[(owners == index) & (gaps > 0.04) & (gaps < 0.25)]
        sectors = _sectors(own, stem.x, stem.y, _N_SECTORS)
        reached = sum(_n_voxels(own[sectors == k], 0.02) >= 4 for k in range(_N_SECTORS))
        result.append(replace(stem, crown_sectors=int(reached)))
    return result


def _goes_on_beside(local, ranges, foot_x, foot_y):
    """Whether a footprint is part of a hedge, a wall, a statue or tall grass.

    These go on to more than one side; a neighbouring post stands on one side only.
    """
    low = (local[:, 2] > _FOOT_BAND[0]) & (local[:, 2] < _FOOT_BAND[1])
    inside = _n_voxels(local[low & (ranges < 1.5 * _MAX_RADIUS)])
    ring = local[low & (ranges >= 1.5 * _MAX_RADIUS) & (ranges < 3 * _MAX_RADIUS)]
    sectors = _sectors(ring, foot_x, foot_y, 8)
    counts = np.array([_n_voxels(ring[sectors == k]) for k in range(8)])
    beside = counts.sum() - (counts + np.roll(counts, -1)).max()
    return beside > 0.4 * inside


def _sectors(points, x, y, n):
    """Index of the direction, one of n, in which each point lies from x, y."""
    azimuth = np.arctan2(points[:, 1] - y, points[:, 0] - x)
    return np.floor((azimuth + np.pi) / (2 * np.pi) * n).astype(int) % n


def _n_voxels(points, size=_CELL):
    """Number of occupied voxels."""
    return len(np.unique(np.floor(points / size).astype(int), axis=0)) if len(points) else 0


def _follow(band, center, capture, max_gap=2):
    """Centres (x, y, z) of the structure in each layer, followed upwards from its foot."""
    track, gap = [], 0
    position, velocity = np.array(center), np.zeros(2)
    layers = np.floor(band[:, 2] / _LAYER).astype(int)
    for layer in range(int(round(_FOOT_BAND[0] / _LAYER)), int(round(_REACH_UP / _LAYER))):
        rows = band[layers == layer, :2]
        close = rows[np.hypot(*(rows - position - velocity).T) < capture]
        if len(close) < 2:
            gap += 1
            if gap > max_gap:
                break
            continue
        gap = 0
        # Midway between the extremes: a side seen by more cameras must not pull the centre over.
        new_position = np.percentile(close, [5, 95], axis=0).mean(axis=0)
        if track:
            velocity = 0.7 * velocity + 0.3 * np.clip(new_position - position, -_LAYER, _LAYER)
        position = new_position
        track.append([*position, (layer + 0.5) * _LAYER])
    return np.array(track).reshape(-1, 3)


def _merge(stems):
    """Keep the best supported of candidates that overlap."""
    kept = []
    for stem in sorted(stems, key=lambda s: (-s.n_points, s.distance)):
        if all(
            np.hypot(stem.x - other.x, stem.y - other.y)
            > max(1.3 * (stem.radius + other.radius), 0.03)
            for other in kept
        ):
            kept.append(stem)
    return kept


def _rank(stems):
    """Order by distance to the look-at point, trees before posts that are a little nearer."""

    def cost(stem):
        crown = min(1.0, stem.crown_sectors / _CROWN_SECTORS)
        # A post is straighter and more upright than any stem.
        like_post = np.exp(-((stem.wobble / 0.004) ** 2) - (stem.lean_deg / 2) ** 2)
        return stem.distance - 0.15 * crown + 0.06 * like_post

    return sorted(stems, key=cost)


def _in_units(stem, distance, look_at_xy):
    """A stem measured in camera distances about the look-at point, in the cloud's own frame."""
    lengths = {
        name: getattr(stem, name) * distance for name in ("radius", "height", "wobble", "distance")
    }
    position = {
        "x": float(stem.x * distance + look_at_xy[0]),
        "y": float(stem.y * distance + look_at_xy[1]),
    }
    return replace(stem, **lengths, **position)
