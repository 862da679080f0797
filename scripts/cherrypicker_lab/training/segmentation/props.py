"""Scenes of things that pass for one another: what the network confuses, often enough to learn it.

A small sign beside a standing marker, its stake beside the stem; posts thick and plain, close to a
stem or free; white rings high and low on stems of any tree in the row. Frame: metres, z up, the
target's stem foot at the origin.
"""

import numpy as np

from cherrypicker.classes import Label
from cherrypicker_lab.orchard.scene.boards import board_on_post, checker_cube, marker_object
from cherrypicker_lab.orchard.scene.layout import DICTIONARIES
from cherrypicker_lab.orchard.scene.mesh import SceneObject, cylinder, ring

# forms to train on; those of the held-out measures (whip, fir, larch, pine) are none of them
FORMS = ("leader", "spindle", "vase", "cherry_leader", "cherry_spindle", "cherry_vase")
POST_TONES = ((0.36, 0.29, 0.20), (0.30, 0.27, 0.24), (0.42, 0.36, 0.24), (0.40, 0.40, 0.39))
MIN_GAP_M = 0.02  # between a post's surface and the stem's


def log_uniform(rng, low, high):
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def put(scene, name, label, mesh, look, radius=0.05):
    scene.objects.append(SceneObject(name, int(label), mesh, look, radius=radius))


def foot_at(scene, xy):
    return np.append(xy, scene.ground_height(np.asarray(xy)[None])[0])


def marker_spec(rng, low, high, poses):
    return {
        "dictionary": str(rng.choice(DICTIONARIES)),
        "id": int(rng.integers(0, 50)),
        "side_m": float(rng.uniform(low, high)),
        "pose": str(rng.choice(poses)),
    }


def common_things(rng):
    """Options of `generate_scene`: what stands about the tree, rare classes often enough."""
    n_markers = int(rng.choice([0, 1, 2, 3], p=[0.1, 0.4, 0.3, 0.2]))
    return {
        "markers": [marker_spec(rng, 0.08, 0.30, ["lying", "standing"]) for _ in range(n_markers)],
        "sign": bool(rng.random() < 0.75),
        "cube": bool(rng.random() < 0.45),
        "ring": bool(rng.random() < 0.5),
    }


def confusable_things(rng):
    """Options of `generate_scene` for a scene that `add_confusable` fills up."""
    markers = [
        marker_spec(rng, 0.08, 0.25, ["lying", "standing", "standing", "post"])
        for _ in range(int(rng.integers(0, 3)))
    ]
    return {
        "markers": markers,
        "sign": False,
        "cube": bool(rng.random() < 0.4),
        "ring": False,
        "post": bool(rng.random() < 0.25),
        "paint": float(rng.uniform(0.2, 0.8)) if rng.random() < 0.15 else 0.0,
        "stubs": int(rng.integers(0, 5)),
        "spurs": float(rng.uniform(2, 12)) if rng.random() < 0.4 else 0.0,
        "density": float(rng.uniform(0.6, 1.1)),
    }


def beside(rng, taken, low, high, gap=0.22):
    """A place at a distance of `low` to `high` from the stem, off the places taken so far."""
    for _ in range(50):
        azimuth = rng.uniform(-np.pi, np.pi)
        xy = rng.uniform(low, high) * np.array([np.cos(azimuth), np.sin(azimuth)])
        if all(np.linalg.norm(xy - other) > gap for other in taken):
            break
    taken.append(xy)
    return xy, azimuth


def _pair(rng, scene, taken):
    """A sign of a marker's size and, as often as not, a standing marker beside it."""
    xy, azimuth = beside(rng, taken, 0.3, 1.3)
    z = scene.ground_height(xy[None])[0]
    spec = {"xy": xy, "width": log_uniform(rng, 0.10, 0.42), "top": log_uniform(rng, 0.22, 1.0)}
    seed = int(rng.integers(1 << 30))
    scene.objects.extend(board_on_post(rng, seed, spec, azimuth, z))
    if rng.random() < 0.5:
        return
    turn = rng.choice([-1, 1]) * rng.uniform(0.35, 0.8)
    place = np.linalg.norm(xy) * np.array([np.cos(azimuth + turn), np.sin(azimuth + turn)])
    marker = marker_spec(rng, 0.08, 0.25, ["standing", "standing", "lying"])
    marker |= {"azimuth": azimuth + turn + np.pi + rng.normal() * 0.4, "tilt": rng.uniform(0, 0.25)}
    made, _ = marker_object(marker, place, scene.ground_height(place[None])[0], seed)
    taken.append(place)
    scene.objects.extend(made)


def add_post(rng, scene, taken):
    """A post of 1.5 to 8 cm radius: at the stem, or free of it."""
    radius = log_uniform(rng, 0.015, 0.08)
    near = float(scene.target.axes[0].reach.max()) + radius + MIN_GAP_M
    reach = near + (0.15 if rng.random() < 0.6 else 1.0)
    xy, _ = beside(rng, taken, near, reach, gap=radius + 0.1)
    z = scene.ground_height(xy[None])[0]
    height = rng.uniform(0.5, 2.8)
    top = xy + rng.normal(size=2) * 0.015 * height
    mesh = cylinder((*xy, z - 0.05), (*top, z + height), radius, rows=60)
    tone = np.array(POST_TONES[rng.integers(len(POST_TONES))]) * rng.uniform(0.6, 1.3)
    kind = "wood" if rng.random() < 0.6 else "plain"
    look = {"kind": kind, "seed": int(rng.integers(1 << 30)), "color": tuple(tone.clip(0, 0.9))}
    put(scene, "support_post", Label.SUPPORT_POST, mesh, look)


def _ring(rng, scene, number):
    """A white sleeve of 2 to 8 cm around the stem of one of the row's trees."""
    stem, width = scene.trees[number].axes[0], rng.uniform(0.02, 0.08)
    middle = rng.uniform(0.10, max(min(0.9, 0.6 * stem.arclength[-1]), 0.12))
    points, reach = stem.at(middle + width * np.linspace(-0.5, 0.5, 7))
    sleeve = ring(points + scene.offsets[number], reach + rng.uniform(0.001, 0.008))
    tone = rng.uniform(0.45, 0.72) * np.array([1.0, 1.0, rng.uniform(0.85, 1.0)])
    look = {"kind": "plain", "seed": int(rng.integers(1 << 30)), "color": tuple(tone)}
    put(scene, "ring", Label.CALIBRATION_UNIT, sleeve, look)


def add_confusable(scene, rng):
    """Set signs with markers beside them, posts, rings and cubes into a scene, in place.

    The scene is of `confusable_things`.
    """
    taken = [np.mean(marker["corners"], axis=0)[:2] for marker in scene.markers]
    for _ in range(int(rng.choice([0, 1, 2], p=[0.1, 0.6, 0.3]))):
        _pair(rng, scene, taken)
    for _ in range(int(rng.choice([0, 1, 2], p=[0.35, 0.45, 0.2]))):
        add_post(rng, scene, taken)
    if rng.random() < 0.3:
        xy, _ = beside(rng, taken, 0.35, 1.1)
        scene.objects.append(
            checker_cube(rng, int(rng.integers(1 << 30)), xy, scene.ground_height(xy[None])[0])
        )
    for number in range(len(scene.trees)):
        if rng.random() < (0.75 if number == 0 else 0.25):
            _ring(rng, scene, number)
