"""Find stems: thin, upright structures that stand on the ground, in a cloud without scale."""

from dataclasses import asdict, dataclass

import numpy as np
from scipy import ndimage

# Fractions of the cameras' distance to what they look at. Trees are photographed so that they fill
# the frame: a stem of 4 to 30 cm seen from 2.5 to 5 m lies well inside these.
_CELL = 0.015
_LAYER = 0.02
_FOOT_BAND = (0.04, 0.16)
_REACH_UP = 0.5
_MIN_HEIGHT = 0.18
_MAX_RADIUS = 0.09
_MAX_LEAN_DEG = 30.0


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
    n_points : int
        Points of the foot.
    wood_above : int
        Occupied voxels above, within a quarter of the cameras' distance: a post has few.
    distance : float
        Horizontal distance of the foot to the point that the cameras look at.
    """

    x: float
    y: float
    radius: float
    height: float
    lean_deg: float
    n_points: int
    wood_above: int
    distance: float

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
    occupancy = _occupancy(band, reach)
    footprints = _footprints(occupancy)
    stems = []
    for label, (rows, columns) in enumerate(ndimage.find_objects(footprints), 1):
        extent = max(rows.stop - rows.start, columns.stop - columns.start) * _CELL
        if extent > 2.5 * _MAX_RADIUS + 0.05:
            continue
        cells = np.argwhere(footprints == label) if extent > 0 else np.empty((0, 2))
        center = (cells.mean(axis=0) + 0.5) * _CELL - reach
        stem = _measure(local, band, center, distance, look_at_xy)
        if stem is not None:
            stems.append(stem)
    return _rank(_merge(stems, distance), distance)


def _occupancy(band, reach):
    """Boolean grid of shape (n, n, n_layers) over x, y and the layers above the ground."""
    n = int(np.ceil(2 * reach / _CELL))
    n_layers = int(np.ceil(_REACH_UP / _LAYER))
    index = np.column_stack(
        [
            np.clip(((band[:, :2] + reach) / _CELL).astype(int), 0, n - 1),
            np.clip((band[:, 2] / _LAYER).astype(int), 0, n_layers - 1),
        ]
    )
    occupancy = np.zeros((n, n, n_layers), bool)
    occupancy[tuple(index.T)] = True
    return occupancy


def _footprints(occupancy):
    """Labelled cells whose surroundings are filled in nearly all layers of the foot band."""
    first, last = (int(round(value / _LAYER)) for value in _FOOT_BAND)
    foot = occupancy[:, :, first:last]
    grown = ndimage.binary_dilation(foot, structure=np.ones((3, 3, 1), bool))
    filled = grown.mean(axis=2) >= 0.8
    standing = filled & foot.any(axis=2)
    labels, _ = ndimage.label(standing, structure=np.ones((3, 3), int))
    return labels


def _measure(local, band, center, distance, look_at_xy):
    """Axis, radius and height of the structure at a footprint, or None if it is no stem."""
    track = _follow(band, center)
    if len(track) < 4 or track[-1, 2] < _MIN_HEIGHT:
        return None
    low = track[track[:, 2] < max(0.25, _MIN_HEIGHT + _LAYER)]
    slope_x, foot_x = np.polyfit(low[:, 2], low[:, 0], 1)
    slope_y, foot_y = np.polyfit(low[:, 2], low[:, 1], 1)
    lean = np.degrees(np.arctan(np.hypot(slope_x, slope_y)))
    if lean > _MAX_LEAN_DEG:
        return None
    ranges = np.hypot(
        local[:, 0] - foot_x - slope_x * local[:, 2], local[:, 1] - foot_y - slope_y * local[:, 2]
    )
    foot = (ranges < 1.5 * _MAX_RADIUS) & (local[:, 2] > _FOOT_BAND[0]) & (local[:, 2] < 0.25)
    radius = float(np.median(ranges[foot]))
    # What goes on to more than one side is a hedge, a wall, a statue or tall grass, not a stem; a
    # neighbouring post stands on one side only.
    low = (local[:, 2] > _FOOT_BAND[0]) & (local[:, 2] < _FOOT_BAND[1])
    inside = _n_voxels(local[low & (ranges < 1.5 * _MAX_RADIUS)])
    ring = local[low & (ranges >= 1.5 * _MAX_RADIUS) & (ranges < 3 * _MAX_RADIUS)]
    azimuth = np.arctan2(ring[:, 1] - foot_y, ring[:, 0] - foot_x)
    sector = np.floor((azimuth + np.pi) / (2 * np.pi) * 8).astype(int) % 8
    counts = np.array([_n_voxels(ring[sector == k]) for k in range(8)])
    beside = counts.sum() - (counts + np.roll(counts, -1)).max()
    if radius > _MAX_RADIUS or beside > 0.4 * inside:
        return None
    above = local[(ranges < 0.25) & (local[:, 2] > 0.25)]
    wood = _n_voxels(above, 0.03)
    x, y = np.array([foot_x, foot_y]) * distance + look_at_xy
    return Stem(
        x=float(x),
        y=float(y),
        radius=radius * distance,
        height=float(track[-1, 2]) * distance,
        lean_deg=float(lean),
        n_points=int(foot.sum()),
        wood_above=int(wood),
        distance=float(np.hypot(foot_x, foot_y) * distance),
    )


def _n_voxels(points, size=_CELL):
    """Number of occupied voxels."""
    return len(np.unique(np.floor(points / size).astype(int), axis=0)) if len(points) else 0


def _follow(band, center, max_gap=2):
    """Centres (x, y, z) of the structure in each layer, followed upwards from its foot."""
    track, gap = [], 0
    position, velocity = np.array(center), np.zeros(2)
    for layer in range(int(round(_FOOT_BAND[0] / _LAYER)), int(round(_REACH_UP / _LAYER))):
        z = (layer + 0.5) * _LAYER
        rows = band[np.abs(band[:, 2] - z) < _LAYER / 2, :2]
        predicted = position + velocity
        close = rows[np.hypot(*(rows - predicted).T) < _MAX_RADIUS]
        if len(close) < 2:
            gap += 1
            if gap > max_gap:
                break
            continue
        gap = 0
        # Midway between the extremes: a side seen by more cameras must not pull the centre over.
        low, high = np.percentile(close, [5, 95], axis=0)
        new_position = 0.5 * (low + high)
        if track:
            velocity = 0.7 * velocity + 0.3 * np.clip(new_position - position, -_LAYER, _LAYER)
        position = new_position
        track.append([*position, z])
    return np.array(track).reshape(-1, 3)


def _merge(stems, distance):
    """Keep the best supported of candidates that stand within two stem widths of each other."""
    kept = []
    for stem in sorted(stems, key=lambda s: (-s.n_points, s.distance)):
        gaps = [np.hypot(stem.x - other.x, stem.y - other.y) for other in kept]
        widths = [max(2 * (stem.radius + other.radius), 0.04 * distance) for other in kept]
        if all(gap > width for gap, width in zip(gaps, widths)):
            kept.append(stem)
    return kept


def _rank(stems, distance):
    """Order by distance to the look-at point; a crown is worth 0.15 of the cameras' distance."""
    most = max((stem.wood_above for stem in stems), default=0)

    def cost(stem):
        crown = min(1.0, stem.wood_above / (0.3 * most)) if most else 0.0
        return stem.distance / distance - 0.15 * crown

    return sorted(stems, key=cost)
