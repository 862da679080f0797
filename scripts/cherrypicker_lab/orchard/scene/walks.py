"""How people walk around a tree with a camera: walks of hand-held photos that crop the crown.

Rings of photos that frame the whole tree (`cameras.default_rings`) are the kindest case for
stereo. The other walks stand nearer, frame parts of the tree and shake. All keep to what structure
from motion can register: a neighbouring photo within 15.5 degrees or 0.6 m.

Frame: metres, z up, the row along x, the target's stem foot at the origin.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker_lab.orchard.scene.cameras import (
    default_rings,
    look_at,
    numbered_poses,
    ring_poses,
)

WALKS = ("rings", "low_rings", "alleys", "spiral", "half_ring")

REACH_M = (0.7, 2.3)  # heights of a lens from a kneeling photographer to stretched arms (guess)
CLEARANCE_M = 0.45  # nobody holds a lens nearer to wood (guess)
FARTHEST_M = 4.0  # backgrounds start beyond it
# steps towards and away from the stem that are tried where wood is in the way, nearest first
_STEPS = 1.0 + np.array([0.0, -0.04, 0.04, -0.08, 0.08, -0.12, 0.12, -0.16, 0.16, 0.2, 0.25, 0.3])

# shares of the tree's height that a photo is tall at the stem (guesses, so that no ring of
# low_rings and few photos of the other walks hold the whole tree)
LOW_RINGS_SHARE = 0.7
ALLEYS_SHARE = 0.68
SPIRAL_SHARES = (0.9, 0.68)
HALF_RING_SHARE = 0.8
# the lower ring leaves out the crown above this share of the height, the upper all below 1 - it
LOW_RINGS_CUT = 0.62
WIDTH_SHARE = 0.8  # of the crown's width, where the height may be framed in full (guess)
ROOM = 1.15  # along the row one stands at most this share of the way to the next gap (guess)
ALLEY_M = (1.8, 3.0)  # from the stem to the middle of an alley, rows being 4 to 6 m apart
ALLEY_ENDS = 1.6  # where a pass along the alley starts and ends, of the gaps' distance
TURN_TO_TREE = 0.35  # share of the way along the row that the lens does not turn back (guess)
GLANCES = (2, 1)  # times that one looks up and down again along an alley and through the row
SPIRAL_TURNS = 2.0
HALF_RING_ARC_DEG = 190.0


@dataclass(frozen=True)
class TreeSize:
    """What a photographer sees of a tree before the first photo."""

    height: float  # m
    reach: float  # of the crown from the stem, horizontally, m
    gap: float  # from the stem to where one walks through the row, m


@dataclass(frozen=True)
class Hand:
    """Standard deviations of a hand-held camera: place (m), aim (m at the tree), roll (degrees)."""

    place: float
    aim: float
    roll: float


# guesses: a ring is paced out, an alley is walked, a spiral is shot in walking
HANDS = {
    "low_rings": Hand(0.05, 0.05, 1.5),
    "alleys": Hand(0.06, 0.08, 2.5),
    "spiral": Hand(0.08, 0.10, 4.0),
    "half_ring": Hand(0.05, 0.06, 2.0),
}


def tree_size(scene):
    """Size of a scene's target and the nearest gap in its row, see `TreeSize`."""
    nodes = scene.target.skeleton().points
    reach = float(np.quantile(np.hypot(nodes[:, 0], nodes[:, 1]), 0.98))
    stems = np.abs(scene.offsets[1:, 0])
    gap = 0.5 * float(stems.min()) if len(stems) else reach + 0.8
    return TreeSize(max(scene.target.height, 0.8), reach, float(np.clip(gap, 1.0, 2.4)))


def _distance(share, size, camera):
    """Distance from the stem (m) at which a photo holds a share of the tree's height and width."""
    framed = share * camera.focal_px * max(
        size.height / camera.height, WIDTH_SHARE * 2 * size.reach / camera.width
    )  # fmt: skip
    return float(np.clip(framed, max(1.4, size.reach + CLEARANCE_M), FARTHEST_M))


def _at_hand(height):
    return np.clip(height, *REACH_M)


def _around(azimuth, radius, height, size):
    """Places on a ring; towards its neighbours in the row there is less room."""
    room = ROOM * max(size.gap, size.reach + CLEARANCE_M)
    radius = np.minimum(radius, room / np.maximum(np.abs(np.cos(azimuth)), 1e-3))
    height = np.broadcast_to(height, azimuth.shape)
    return np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth), height])


def _on_stem(height):
    return np.column_stack([np.zeros((len(height), 2)), height])


def _low_rings(size, camera, n, _rng):
    """Two rings: one from the ground up to the lower crown, one from there to the top."""
    radius = _distance(LOW_RINGS_SHARE, size, camera)
    half = 0.5 * radius * camera.height / camera.focal_px  # of a photo at the stem, m
    n_low = n // 2
    low = 2 * np.pi * np.arange(n_low) / n_low
    high = 0.5 * np.pi / n_low + 2 * np.pi * np.arange(n - n_low) / (n - n_low)
    aims = LOW_RINGS_CUT * size.height - half, (1 - LOW_RINGS_CUT) * size.height + half
    places = [
        _around(low, radius, _at_hand(0.3 * size.height), size),
        _around(high, 0.97 * radius, _at_hand(0.62 * size.height), size),
    ]
    targets = np.repeat(aims, [n_low, n - n_low])
    return np.concatenate(places), _on_stem(targets)


def _alleys(size, camera, n, _rng):
    """Along the alley on one side, through the row, back along the other side, through again."""
    away = float(np.clip(_distance(ALLEYS_SHARE, size, camera), *ALLEY_M))
    end, gap = min(ALLEY_ENDS * size.gap, FARTHEST_M - 0.8), size.gap
    passes = np.array([
        [[-end, away], [end, away]], [[gap, away], [gap, -away]],
        [[end, -away], [-end, -away]], [[-gap, -away], [-gap, away]],
    ])  # fmt: skip
    length = np.linalg.norm(passes[:, 1] - passes[:, 0], axis=1)
    shares = np.floor(n * length / length.sum()).astype(int)
    shares[: n - shares.sum()] += 1
    places, targets = [], []
    for number, ((start, stop), count) in enumerate(zip(passes, shares)):
        t = (np.arange(count) + 0.5) / count
        xy = start + t[:, None] * (stop - start)
        glance = np.sin(2 * np.pi * GLANCES[number % 2] * t + number)
        half = 0.5 * np.linalg.norm(xy, axis=1) * camera.height / camera.focal_px
        swing = np.maximum(0.5 * size.height - half, 0.12 * size.height)
        aim = 0.5 * size.height + swing * glance
        held = np.full(count, _at_hand((0.5, 0.62, 0.42, 0.55)[number] * size.height))
        places.append(np.column_stack([xy, np.minimum(held, 1.8)]))
        along = TURN_TO_TREE * xy[:, 0] if number % 2 == 0 else np.zeros(count)
        targets.append(np.column_stack([along, np.zeros(count), aim]))
    return np.concatenate(places), np.concatenate(targets)


def _spiral(size, camera, n, rng):
    """Around the tree twice, coming nearer, the camera rising and looking further up."""
    t = np.linspace(0.0, 1.0, n)
    azimuth = rng.uniform(0, 2 * np.pi) + 2 * np.pi * SPIRAL_TURNS * t
    first, last = (_distance(share, size, camera) for share in SPIRAL_SHARES)
    height = _at_hand((0.25 + 0.5 * t) * size.height)
    aim = (0.32 + 0.4 * t) * size.height
    return _around(azimuth, first + (last - first) * t, height, size), _on_stem(aim)


def _half_ring(size, camera, n, rng):
    """Half a ring from the alley on one side, low and then, going back, high."""
    radius = _distance(HALF_RING_SHARE, size, camera)
    middle = rng.choice([-1, 1]) * np.pi / 2
    half = np.radians(HALF_RING_ARC_DEG) / 2
    n_low = n // 2
    low = middle + np.linspace(-half, half, n_low)
    high = middle + np.linspace(half, -half, n - n_low)
    places = [
        _around(low, radius, _at_hand(0.35 * size.height), size),
        _around(high, 0.95 * radius, _at_hand(0.65 * size.height), size),
    ]
    targets = size.height * np.repeat([0.37, 0.66], [n_low, n - n_low])
    return np.concatenate(places), _on_stem(targets)


PATHS = {
    "low_rings": _low_rings, "alleys": _alleys, "spiral": _spiral, "half_ring": _half_ring,
}  # fmt: skip


def _clear_of(place, wood):
    """The nearest place on the line to the stem (3,) that keeps the lens off the wood."""
    tried = place * np.column_stack([_STEPS, _STEPS, np.ones_like(_STEPS)])
    free = wood.query(tried)[0]
    return tried[int(np.argmax(free > CLEARANCE_M))] if (free > CLEARANCE_M).any() else (
        tried[int(np.argmax(free))]
    )  # fmt: skip


def walk_poses(scene, camera, walk="rings", n_photos=48):
    """`Poses` of the photos of a walk around a scene's target, in shooting order, m.

    The walk is one of `WALKS`: "rings" (three that frame the whole tree), "low_rings" (two near
    ones, neither of which frames the whole tree), "alleys" (along the alleys on both sides of the
    row, and through the row beside the tree), "spiral" (two turns that rise and come nearer) or
    "half_ring" (from one side only, low and high). From 44 photos on, neighbouring ones are at most
    15.5 degrees or 0.6 m apart. Raises a ValueError if there is no such walk.
    """
    if walk not in WALKS:
        raise ValueError(f"walk must be one of {', '.join(WALKS)}, got {walk!r}")
    if walk == "rings":
        return ring_poses(
            default_rings(scene, camera, n_photos), camera, seed=scene.seed,
            ground=scene.ground_height, obstacles=scene.obstacles(),
        )  # fmt: skip
    rng = np.random.default_rng([int(scene.seed), 63])
    places, targets = PATHS[walk](tree_size(scene), camera, n_photos, rng)
    hand = HANDS[walk]
    places = places + rng.normal(size=places.shape) * hand.place * [1.0, 1.0, 0.7]
    targets = targets + rng.normal(size=targets.shape) * hand.aim
    roll = np.radians(rng.normal(size=len(places)) * hand.roll)
    places[:, 2] += scene.ground_height(places[:, :2])
    wood = cKDTree(np.concatenate([scene.target.skeleton().points, scene.obstacles()]))
    places = np.array([_clear_of(place, wood) for place in places])
    return numbered_poses([look_at(*at) for at in zip(places, targets, roll)], camera)


def preset_poses(preset, scene):
    """Poses of the photos of a scene of one of `presets.PRESETS`: of its walk, or of its own rings.

    The preset has a `camera`, and either `rings` or `walk` and `n_photos`.
    """
    if "walk" in preset:
        return walk_poses(scene, preset["camera"], preset["walk"], preset["n_photos"])
    return ring_poses(
        preset["rings"], preset["camera"], seed=scene.seed, ground=scene.ground_height,
        obstacles=scene.obstacles(),
    )  # fmt: skip
