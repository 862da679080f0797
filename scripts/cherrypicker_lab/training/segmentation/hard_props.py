"""Scenes of what the network got wrong: wild and foreign trees, hollow boards, things at the stem.

Trees of other people's skeletons (`grow.elsewhere`) or of our own forms, with shoots, spurs and
drooping limbs; boards and solids of which stereo finds the rim and the print only; things that
lean on the stem, hang on it or are tied to it; painted stems and white rings of any width. All is
drawn from wide ranges. Frame: metres, z up, the target's stem foot at the origin.
"""

import numpy as np

from cherrypicker.classes import Label
from cherrypicker_lab.orchard.grow.dressing import run_wild
from cherrypicker_lab.orchard.grow.elsewhere import tree_from_skeleton
from cherrypicker_lab.orchard.scene.boards import board_turn, marker_image
from cherrypicker_lab.orchard.scene.layout import DICTIONARIES
from cherrypicker_lab.orchard.scene.mesh import turn_about
from cherrypicker_lab.orchard.scene.shapes import bar, plate, tube
from cherrypicker_lab.training.segmentation import random_props as props
from cherrypicker_lab.training.segmentation.props import (
    add_post,
    beside,
    foot_at,
    log_uniform,
    put,
)

HOLLOW_TEXELS = 64  # at least, of the map of what stereo finds
BOARD_KINDS = ("plain", "text", "text", "text", "stripes")  # patterns of signs


def hard_things(rng):
    """Options of `generate_scene` for a scene that `add_hard` fills up."""
    size = {}
    if rng.random() < 0.35:  # a young tree, its stem no thicker than a stake
        height = log_uniform(rng, 0.8, 2.2)
        size = {"height": height, "trunk_radius": height * rng.uniform(0.006, 0.016)}
    return (
        props.random_things(rng)
        | size
        | {
            "post": bool(rng.random() < 0.25),
            "wires": int(rng.integers(1, 5)) if rng.random() < 0.3 else 0,
            "paint": log_uniform(rng, 0.15, 1.3) if rng.random() < 0.3 else 0.0,
        }
    )


def _hollow(rng, scene, first):
    """Let stereo find only edges and rims of what was put since object `first`."""
    for thing in scene.objects[first:]:
        if thing.material["kind"] == "image":
            image = np.asarray(thing.material["image"])
            fine = np.ones((-(-HOLLOW_TEXELS // min(image.shape[:2])),) * 2 + (1,))
            found = props.found_at_edges(rng, np.kron(image, fine))
            thing.material = thing.material | {"found": found}


def _print(rng, label):
    """A look of a sign, a marker or a calibration unit."""
    if label == Label.MARKER:
        margin = 0.5 * int(rng.integers(1, 7))
        image = marker_image(str(rng.choice(DICTIONARIES)), int(rng.integers(50)), margin)[0]
        return {"kind": "image", "image": image}
    kinds = BOARD_KINDS if label == Label.SIGN else ("stripes", "checker", "checker", "dots")
    return props.printed(rng, kinds)


def _at_stem(rng, scene, height):
    """Azimuth around the target's stem, the way out, and the stem's middle and reach at a height.

    The stem stands at the origin; the height is cut where it ends.
    """
    stem, azimuth = scene.target.axes[0], rng.uniform(-np.pi, np.pi)
    middle, reach = props.along_stem(stem, scene.offsets[0], height, 0.0, 1)
    return azimuth, np.array([np.cos(azimuth), np.sin(azimuth), 0.0]), middle[0], reach[0]


def _board_at_stem(rng, scene, taken):
    """A sign or marker that leans on the stem, or stands before it on a stake."""
    label = Label.MARKER if rng.random() < 0.45 else Label.SIGN
    name = "marker" if label == Label.MARKER else "sign"
    width = log_uniform(rng, 0.08, 0.35 if label == Label.MARKER else 0.7)
    height = width if label == Label.MARKER else width * log_uniform(rng, 0.5, 2.0)
    corners = 4 if label == Label.MARKER else int(rng.choice([4, 4, 4, 5, 8, 24]))
    thick = log_uniform(rng, 0.002, 0.03)
    mesh = plate(width, height, thick, corners)
    slope, lift = rng.uniform(0.05, 0.8), 0.0
    stands = rng.random() < 0.5
    if stands:
        slope, lift = rng.normal() * 0.15, log_uniform(rng, 0.02, 0.9)
    azimuth, out, middle, reach = _at_stem(rng, scene, lift + height * np.cos(slope))
    gap = rng.uniform(0.0, 0.12) if stands else 0.0
    away = reach + thick + gap + 0.5 * height * abs(np.sin(slope))
    centre = middle * [1, 1, 0] + away * out
    taken.append(centre[:2])
    foot = foot_at(scene, centre[:2])
    centre[2] = foot[2] + lift + 0.5 * height * np.cos(slope) + 0.005
    turn = board_turn(azimuth + np.pi + rng.normal() * (0.5 if stands else 0.1), np.pi / 2 - slope)
    put(scene, name, label, mesh.moved(centre, turn), _print(rng, label))
    if stands:
        wide = log_uniform(rng, 0.008, 0.04)
        below = foot - [0, 0, 0.05] - 0.5 * (thick + wide) * out * [1, 1, 0]
        stake = bar(
            below, centre - 0.5 * (thick + wide) * out, wide, sides=int(rng.choice([4, 12]))
        )
        put(scene, f"{name}_post", label, stake, props.simple(rng))


def _solid_at_stem(rng, scene, taken):
    """A cube, cone or ball with a print, upright or tipped, that touches the stem's foot."""
    size = log_uniform(rng, 0.06, 0.35)
    _, out, middle, reach = _at_stem(rng, scene, 0.5 * size)
    tip = rng.uniform(0.0, 0.6) if rng.random() < 0.5 else 0.0
    mesh = props.solid(rng, size)
    c, s = np.cos(tip), np.sin(tip)
    mesh = mesh.moved(np.zeros(3), np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]))
    mesh = mesh.moved(np.zeros(3), turn_about(rng.uniform(-np.pi, np.pi)))
    inward = -(mesh.vertices @ out).min()
    at = (middle * [1, 1, 0] + (reach + inward + rng.uniform(0, 0.02)) * out)[:2]
    taken.append(at)
    at = foot_at(scene, at) - [0, 0, mesh.vertices[:, 2].min() - 0.003]
    look = _print(rng, Label.CALIBRATION_UNIT)
    put(scene, "target", Label.CALIBRATION_UNIT, mesh.moved(at), look)


def _tag(rng, scene, taken):
    """A tag, small sign or marker that hangs on the stem or on a limb by a string."""
    label = Label.MARKER if rng.random() < 0.25 else Label.SIGN
    width = log_uniform(rng, 0.025, 0.14)
    height = width * (1.0 if label == Label.MARKER else log_uniform(rng, 0.5, 2.5))
    axes = [a for a in scene.target.axes if a.order <= 2 and a.radii.max() > 0.004]
    axis = axes[0] if rng.random() < 0.35 else axes[rng.integers(len(axes))]
    node = int(rng.integers(len(axis.points)))
    angle = rng.uniform(-np.pi, np.pi)
    out = np.array([np.cos(angle), np.sin(angle), 0.0])
    on_bark = axis.points[node] + scene.offsets[0]
    string = rng.uniform(0.0, 0.08)
    upright = abs(axis.tangents[node, 2]) > 0.7
    on_bark = on_bark + (axis.reach[node] + 0.004) * (out if upright else np.array([0, 0, -1.0]))
    centre = on_bark - [0, 0, string + 0.5 * height]
    name = "marker" if label == Label.MARKER else "sign"
    mesh = plate(width, height, log_uniform(rng, 0.001, 0.005), int(rng.choice([4, 4, 4, 24])))
    turn = board_turn(angle + np.pi + 0.4 * rng.normal(), np.pi / 2 + 0.15 * rng.normal())
    put(scene, name, label, mesh.moved(centre, turn), _print(rng, label))
    if string > 0.01:
        line = bar(on_bark, centre + [0, 0, 0.5 * height], 0.002, sides=6)
        put(scene, f"{name}_string", label, line, props.simple(rng), radius=0.001)


def _stake(rng, scene, taken):
    """A stake or a thin cane at the stem or up to a limb, tied to it as often as not."""
    thin = rng.random() < 0.4
    radius = log_uniform(rng, 0.004, 0.010) if thin else log_uniform(rng, 0.008, 0.05)
    height = rng.uniform(0.4, 2.6)
    azimuth, out, middle, reach = _at_stem(rng, scene, 0.3)
    gap = max(rng.uniform(-0.004, 0.04), 0.0)
    foot = foot_at(scene, (middle + (reach + radius + gap) * out)[:2])
    stem = scene.target.axes[0]
    tall = min(height, float(stem.points[:, 2].max()))
    above, reach_above = props.along_stem(stem, scene.offsets[0], tall, 0.0, 1)
    top = above[0] + (reach_above[0] + radius + gap) * out
    top = foot + (top - foot) * height / max(top[2] - foot[2], 0.1)
    if thin and rng.random() < 0.6:  # a cane to a limb
        axes = [a for a in scene.target.axes if a.order in (1, 2)]
        axis = axes[rng.integers(len(axes))] if axes else stem
        node = int(rng.integers(len(axis.points)))
        top = axis.points[node] + scene.offsets[0] + (axis.reach[node] + radius) * out
        top = top + [0, 0, rng.uniform(0.0, 0.3)]
        foot = foot_at(scene, beside(rng, taken, 0.05, 0.7, gap=0.05)[0])
    elif rng.random() < 0.3:  # it leans across
        top = top + np.append(rng.normal(size=2) * 0.12, 0.0)
    mesh = bar(foot - [0, 0, 0.05], top, 2 * radius, sides=12 if thin else int(rng.choice([4, 12])))
    look = props.simple(rng)
    put(scene, "support_post", Label.SUPPORT_POST, mesh, look, radius=radius)
    if rng.random() < 0.6:
        for level in rng.uniform(0.15, 0.95, int(rng.integers(1, 4))):
            _tie(rng, scene, foot + level * (top - foot), radius)


def _tie(rng, scene, place, radius):
    """A band around a stake and the stem where they are near each other."""
    stem = scene.target.axes[0]
    node = np.abs(stem.points[:, 2] + scene.offsets[0, 2] - place[2]).argmin()
    other = stem.points[node] + scene.offsets[0]
    apart = (other - place) * [1, 1, 0]
    if np.linalg.norm(apart) > stem.reach[node] + radius + 0.08:
        return
    across = apart / max(np.linalg.norm(apart), 1e-6)
    angle = np.linspace(0, 2 * np.pi, 25)
    half = 0.5 * (np.linalg.norm(apart) + stem.reach[node] + radius) + 0.004
    middle = place + 0.5 * (stem.reach[node] - radius) * across + 0.5 * apart
    aside = np.cross(across, [0, 0, 1.0]) * (max(stem.reach[node], radius) + 0.004)
    loop = middle + half * np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * aside
    band = tube(loop, log_uniform(rng, 0.002, 0.012))
    look = props.simple(rng) | {"kind": "plain"}
    put(scene, "tie", Label.SUPPORT_POST, band, look, radius=0.01)


def _guy(rng, scene, taken):
    """A wire from the stem down to a peg, or on to somewhere beside the tree."""
    _, out, middle, _ = _at_stem(rng, scene, rng.uniform(0.5, 2.2))
    end = middle + rng.uniform(0.5, 2.5) * out
    end[2] = foot_at(scene, end[:2])[2] if rng.random() < 0.5 else middle[2] + rng.normal() * 0.1
    radius = log_uniform(rng, 0.001, 0.004)
    wire = bar(middle, end, 2 * radius, sides=6)
    put(scene, "wire", Label.SUPPORT_POST, wire, props.simple(rng), radius=radius)


def _white_ring(rng, scene, number):
    """A white sleeve of 2 to 12 cm, anywhere on a stem above its paint."""
    tree, width = scene.trees[number], log_uniform(rng, 0.02, 0.12)
    stem = tree.axes[0]
    low = 0.02 + tree.paint_m + 0.5 * width
    high = 0.9 * stem.arclength[-1]
    if high <= low + 0.05:
        return
    middle = rng.uniform(low, high)
    tone = rng.uniform(0.42, 0.78) * np.array([1.0, 1.0, rng.uniform(0.85, 1.0)])
    props.sleeve(rng, scene, number, middle, width, tone)


def add_hard(scene, rng, skeletons=()):
    """Make a scene's trees wild or foreign and set things at and around them, in place.

    The scene is of `hard_things`. The skeletons are files of trees from elsewhere to put in the
    place of the scene's own, see `cherrypicker_lab.orchard.grow.elsewhere`.
    """
    for number, own in enumerate(scene.trees):
        if len(skeletons):
            tree = tree_from_skeleton(skeletons[rng.integers(len(skeletons))], rng)
            tree.paint_m, tree.relief = own.paint_m, own.relief
            scene.trees[number] = tree
        run_wild(rng, scene.trees[number], twigs=bool(len(skeletons)))
    first = len(scene.objects) if rng.random() < 0.3 else 0  # the generator's own are hollow too
    taken = [np.mean(marker["corners"], axis=0)[:2] for marker in scene.markers]
    makers = ((_board_at_stem, 0.6), (_solid_at_stem, 0.3), (_tag, 0.8), (_stake, 0.7),
              (_guy, 0.15), (props.board, 0.7), (props.calibration_unit, 0.4),
              (props.stray, 0.3), (add_post, 0.4))  # fmt: skip
    for make, mean in makers:
        for _ in range(min(rng.poisson(mean), 3)):
            make(rng, scene, taken)
    if rng.random() < 0.7:
        _hollow(rng, scene, first)
    for number in range(len(scene.trees)):
        for make, mean in ((_white_ring, 0.6), (props.patch, 0.3), (props.ivy, 0.08)):
            for _ in range(min(rng.poisson(mean), 3)):
                make(rng, scene, number)
    if rng.random() < 0.5:
        props.floor(rng, scene, taken)
