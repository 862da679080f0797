"""Scenes of things drawn at random: the world is larger than our own orchard.

Boards of any size, outline, print, tilt and stand; cubes, balls, cones and striped poles; roofs and
sheds of any kind; what belongs to no class, as ladders, crates, people's legs and corners of houses
(`NO_WOOD`); stems with rings, moss, ivy, wounds, in grass and stones. A generator a kind of thing,
its ranges wide: they are guesses of what stands in orchards, none is fitted to a scene. Frame:
metres, z up, the target's stem foot at the origin.
"""

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.ndimage import maximum_filter, minimum_filter

from cherrypicker.classes import Label
from cherrypicker_lab.orchard.scene.appearance import encode_srgb
from cherrypicker_lab.orchard.scene.boards import board_turn, marker_image
from cherrypicker_lab.orchard.scene.ground import GROUNDS
from cherrypicker_lab.orchard.scene.layout import DICTIONARIES
from cherrypicker_lab.orchard.scene.mesh import box, join, ring, turn_about
from cherrypicker_lab.orchard.scene.noise import fbm
from cherrypicker_lab.orchard.scene.shapes import (
    bar,
    blades,
    plate,
    sheet,
    tube,
    turned,
)
from cherrypicker_lab.orchard.scene.structures import NETS
from cherrypicker_lab.training.segmentation.props import (
    add_post,
    beside,
    foot_at,
    log_uniform,
    marker_spec,
    put,
)

NO_WOOD = 254  # things of no class: the loss asks of the network only that it calls them no wood
PATTERNS = ("plain", "stripes", "checker", "dots", "text", "photo")
TEXELS = 96


def random_things(rng):
    """Options of `generate_scene` for a scene that `add_random` fills up."""
    return {
        "markers": [
            marker_spec(rng, 0.06, 0.35, ["lying", "standing", "post"])
            for _ in range(int(rng.integers(0, 3)))
        ],
        "sign": False,
        "cube": False,
        "ring": False,
        "roof": False,
        "post": bool(rng.random() < 0.2),
        "wires": int(rng.integers(1, 5)) if rng.random() < 0.25 else 0,
        "net": str(rng.choice(NETS)) if rng.random() < 0.1 else None,
        "paint": float(rng.uniform(0.1, 1.0)) if rng.random() < 0.25 else 0.0,
        "stubs": int(rng.integers(0, 5)),
        "spurs": float(rng.uniform(2, 12)) if rng.random() < 0.4 else 0.0,
        "relief": float(rng.uniform(0.0, 1.2)),
        "ground": str(rng.choice(list(GROUNDS))),
        "density": float(rng.uniform(0.6, 1.1)),
    }


# Looks


def _color(rng):
    """Linear RGB: grey from black to white as often as a colour of any hue."""
    tone = log_uniform(rng, 0.02, 0.75)
    if rng.random() < 0.5:
        return np.clip(tone * (1.0 + rng.normal(size=3) * 0.06), 0.01, 0.85)
    hue = 0.5 + 0.5 * np.cos(2 * np.pi * (rng.random() + np.array([0.0, 1 / 3, 2 / 3])))
    share = rng.uniform(0.2, 1.0)
    return np.clip(1.3 * tone * (share * hue**1.5 + (1 - share)), 0.01, 0.85)


def _text(rng, size):
    """Where lines of letters of random sizes stand, bool (size, size)."""
    page = Image.new("L", (size, size), 0)
    draw, y = ImageDraw.Draw(page), int(rng.integers(2, size // 4))
    while y < size - 10:
        height = int(rng.integers(8, size // 2))
        letters = "".join(chr(rng.integers(48, 91)) for _ in range(rng.integers(1, 14)))
        draw.text((int(rng.integers(2, 20)), y), letters, fill=255,
                  font=ImageFont.load_default(height))  # fmt: skip
        y += int(height * rng.uniform(1.0, 1.6))
        if rng.random() < 0.3:
            break
    return np.asarray(page) > 127


def _image(rng, kind):
    """Two or more colours in a pattern of `PATTERNS`, perhaps framed; linear albedo."""
    v, u = np.mgrid[0:TEXELS, 0:TEXELS] / TEXELS
    n = rng.uniform(2, 9)
    way = rng.choice([0.0, 0.5 * np.pi, rng.uniform(0, np.pi)])
    first, second = _color(rng), _color(rng)
    if kind == "photo":
        at = np.stack([u, v, np.zeros_like(u)], -1).reshape(-1, 3) * log_uniform(rng, 2, 20)
        mix = [fbm(at, octaves=4, gain=0.7, seed=int(rng.integers(1 << 30))) for _ in range(3)]
        image = (np.stack(mix, -1) * (first + second)).reshape(TEXELS, TEXELS, 3)
    else:
        marked = {
            "plain": np.zeros_like(u, bool),
            "stripes": np.sin(2 * np.pi * n * (u * np.cos(way) + v * np.sin(way))) > 0,
            "checker": (np.floor(u * round(n)) + np.floor(v * round(n))) % 2 > 0,
            "dots": np.hypot(u * n % 1 - 0.5, v * n % 1 - 0.5) < rng.uniform(0.15, 0.45),
            "text": _text(rng, TEXELS),
        }[kind]
        image = np.where(marked[..., None], second, first)
    if rng.random() < 0.4:
        rim = np.minimum(np.minimum(u, 1 - u), np.minimum(v, 1 - v))
        low = rng.uniform(0, 0.06)
        framed = (rim > low) & (rim < low + rng.uniform(0.02, 0.1))
        image = np.where(framed[..., None], _color(rng), image)
    return np.clip(image, 0.01, 0.85)


def found_at_edges(rng, image):
    """Share of points that stereo finds at each texel: letters, edges and the rim of what is plain.

    A window without contrast matches nothing.
    """
    window = int(rng.integers(2, 12))
    framed = np.pad(encode_srgb(image).mean(axis=2), 1, constant_values=-1.0)
    contrast = maximum_filter(framed, window) - minimum_filter(framed, window)
    return np.where(contrast[1:-1, 1:-1] > 0.1, 1.0, rng.uniform(0.0, 0.15))


def printed(rng, kinds=PATTERNS):
    image = _image(rng, str(rng.choice(kinds)))
    # on half of all things grain and dirt suffice
    found = np.ones(image.shape[:2]) if rng.random() < 0.5 else found_at_edges(rng, image)
    return {"kind": "image", "image": image, "found": found}


def simple(rng):
    """Weathered wood, or one colour with dirt."""
    kind, tone = ("wood", "plain")[rng.integers(2)], _color(rng)
    return {"kind": kind, "seed": int(rng.integers(1 << 30)), "color": tuple(tone)}


# Boards: signs and markers


def _on_bark(rng, scene):
    """A place on the target's bark and the way out of it."""
    axis = scene.target.axes[0] if rng.random() < 0.6 else rng.choice(scene.target.axes)
    node = int(rng.integers(len(axis.points)))
    angle = rng.uniform(-np.pi, np.pi)
    out = np.array([np.cos(angle), np.sin(angle), 0.0])
    return axis.points[node] + scene.offsets[0] + (axis.reach[node] + 0.008) * out, angle


def board(rng, scene, taken):
    """A sign, or a marker in a frame of its own, on posts, lying, leaning, or tied to the tree."""
    is_marker = rng.random() < 0.3
    label, name = (Label.MARKER, "marker") if is_marker else (Label.SIGN, "sign")
    width = log_uniform(rng, 0.06, 0.35 if is_marker else 1.1)
    height = width if is_marker else width * log_uniform(rng, 0.4, 2.0)
    corners = 4 if is_marker else int(rng.choice([3, 4, 4, 4, 4, 5, 8, 24]))
    kinds = ("plain", "text", "text", "text", "photo", "stripes")
    look = printed(rng, kinds)
    if is_marker:
        book = str(rng.choice(DICTIONARIES))
        margin = 0.5 * int(rng.integers(1, 7))
        image = marker_image(book, int(rng.integers(0, 50)), margin)[0]
        look = {"kind": "image", "image": image}
    mesh = plate(width, height, log_uniform(rng, 0.002, 0.04), corners)
    mount = "post" if is_marker else str(rng.choice(["post", "posts", "leans", "tied"]))
    mount = "leans" if is_marker and rng.random() < 0.4 else mount
    if mount == "tied":
        width = log_uniform(rng, 0.04, 0.25)
        mesh = plate(width, width * rng.uniform(0.5, 1.5), 0.002, corners)
        centre, outwards = _on_bark(rng, scene)
        turn = board_turn(outwards + np.pi, np.pi / 2)
        put(scene, name, label, mesh.moved(centre, turn), look)
        return
    xy, azimuth = beside(rng, taken, 0.3, 2.6, gap=0.25 + 0.4 * width)
    foot = foot_at(scene, xy)
    azimuth += np.pi + rng.normal() * 0.8
    if mount == "leans":
        slope = rng.uniform(0.0, 1.3)
        centre = foot + [0, 0, 0.5 * height * np.sin(slope) + 0.02]
        put(scene, name, label, mesh.moved(centre, board_turn(azimuth, slope)), look)
        return
    turn = board_turn(azimuth, np.pi / 2 - rng.normal() * 0.25)
    centre = foot + [0, 0, 0.5 * height + log_uniform(rng, 0.03, 1.4)]
    put(scene, name, label, mesh.moved(centre, turn), look)
    look, thick = simple(rng), log_uniform(rng, 0.008, 0.08)
    rise = rng.choice([0.0, rng.uniform(0.0, 0.7)]) * height
    for aside in [-0.4, 0.4] if mount == "posts" else [0.0]:
        behind = centre + turn @ [aside * width, 0.0, -0.5 * thick - 0.03]
        post = bar([*behind[:2], foot[2] - 0.05], behind + [0, 0, rise], thick,
                   sides=int(rng.choice([4, 12])))  # fmt: skip
        put(scene, f"{name}_post", label, post, look)


# Solids: calibration units, and others of no class


def solid(rng, size):
    """A cube or box, ball, cone or prism of about a size (m), standing on z = 0."""
    kind = rng.choice(["box", "ball", "cone", "prism"])
    if kind == "box":
        edges = size * np.array([1.0, 1.0, 1.0] if rng.random() < 0.6 else rng.uniform(0.4, 1.6, 3))
        return box(edges).moved((0, 0, edges[2] / 2), turn_about(rng.uniform(0, np.pi)))
    if kind == "ball":
        t = np.linspace(0, np.pi, 17)
        return turned(0.5 * size * np.sin(t), 0.5 * size * (1 - np.cos(t)))
    radius, height = 0.5 * size * rng.uniform(0.6, 1.2), size * log_uniform(rng, 0.5, 2.5)
    top = radius * (rng.uniform(0.0, 0.3) if kind == "cone" else rng.uniform(0.7, 1.1))
    sides = int(rng.choice([3, 4, 6, 24, 24]))
    return turned([0, radius, top, 0], [0, 0, height, height], sides)


def calibration_unit(rng, scene, taken):
    """A solid with a print on the ground or a stake, or a striped pole."""
    xy, _ = beside(rng, taken, 0.3, 2.0)
    foot, size = foot_at(scene, xy), log_uniform(rng, 0.06, 0.4)
    look = printed(rng, ("stripes", "checker", "checker", "dots", "plain"))
    label = Label.CALIBRATION_UNIT
    if rng.random() < 0.2:
        n, wide = rng.integers(3, 12), log_uniform(rng, 0.015, 0.06)
        bands = np.where(np.arange(2 * n) % 2, 1, 0)[:, None, None]
        look = {"kind": "image", "image": np.where(bands, _color(rng), _color(rng))}
        pole = turned([0, 0.5, 0.5, 0], [0, 0, 1, 1], 12)
        pole.vertices = pole.vertices * [wide, wide, rng.uniform(0.4, 2.4)]
        put(scene, "target", label, pole.moved(foot), look)
        return
    lift = rng.uniform(0.2, 1.5) if rng.random() < 0.3 else 0.004
    put(scene, "target", label, solid(rng, size).moved(foot + [0, 0, lift]), look)
    if lift > 0.1:
        wide = log_uniform(rng, 0.01, 0.05)
        stake = bar(foot - [0, 0, 0.05], foot + [0, 0, lift], wide, sides=12)
        put(scene, "target_stake", label, stake, simple(rng))


def _bars(rng, kind):
    """Bars of a ladder, a crate, a trestle or tools that lean together, on z = 0."""
    wide, thick = rng.uniform(0.25, 0.6), log_uniform(rng, 0.015, 0.05)
    made = []
    if kind == "ladder":
        length, lean = rng.uniform(1.5, 4.0), rng.uniform(0.1, 0.5)
        way = np.array([0, np.sin(lean), np.cos(lean)])
        aside = np.array([wide / 2, 0, 0])
        made += [bar(s * aside, length * way + s * aside * rng.uniform(0.6, 1), thick)
                 for s in (-1, 1)]  # fmt: skip
        steps = np.arange(0.25, length, rng.uniform(0.22, 0.35))
        made += [bar(s * way - 0.9 * aside, s * way + 0.9 * aside, 0.8 * thick, sides=8)
                 for s in steps]  # fmt: skip
    elif kind == "crate":
        size = rng.uniform([0.3, 0.25, 0.15], [1.2, 1.0, 0.8])
        rows = np.linspace(0.04, size[2], int(rng.integers(2, 7)))
        x, y = size[:2] / 2
        for start, stop in (((-x, -y), (x, -y)), ((-x, y), (x, y)), ((-x, -y), (-x, y)),
                            ((x, -y), (x, y))):  # fmt: skip
            made += [bar([*start, z], [*stop, z], 0.012, size[2] / len(rows) * 0.8) for z in rows]
    else:
        for _ in range(int(rng.integers(2, 6))):
            top = np.append(rng.normal(size=2) * 0.1, rng.uniform(0.6, 1.8))
            made.append(bar(np.append(rng.normal(size=2) * 0.4, 0), top, thick, sides=8))
    return join(made)


def _leg_pair(rng):
    """The legs of somebody who stands there, and as often as not the body above."""
    stride, hip = rng.uniform(0.1, 0.5), rng.uniform(0.7, 0.95)
    made = []
    for side in (-1, 1):
        joints = np.array([[0.09 * side, 0, hip], [0.1 * side, rng.uniform(-0.1, 0.15), hip / 2],
                           [0.1 * side, side * stride / 2, 0.05]])  # fmt: skip
        t = np.linspace(0, 2, 13)
        points = np.stack([np.interp(t, [0, 1, 2], joints[:, i]) for i in range(3)], axis=1)
        made.append(tube(points, np.interp(t, [0, 2], [0.085, 0.055]), 12))
        toe = joints[2] + [0, 0.18, -0.01]
        made.append(bar(joints[2] - [0, 0.08, 0.01], toe, 0.09))
    if rng.random() < 0.5:
        levels = hip + np.array([-0.1, 0, 0.5, 0.6, 0.75, 0.8])
        made.append(turned([0, 0.18, 0.22, 0.08, 0.1, 0], levels, 16))
    return join(made)


def stray(rng, scene, taken):
    """A thing of no class: a ladder, a crate, tools, legs, a bucket or bag, a house's corner."""
    kind = str(rng.choice(["ladder", "crate", "tools", "legs", "solid", "solid", "house"]))
    low, high = (1.6, 4.0) if kind == "house" else (0.5, 2.6)
    xy, azimuth = beside(rng, taken, low, high, gap=0.5)
    foot, turn = foot_at(scene, xy), turn_about(rng.uniform(-np.pi, np.pi))
    if kind == "house":
        height, look = rng.uniform(1.2, 3.5), printed(rng, ("photo", "stripes", "plain"))
        for side in (-1, 1):  # two walls that meet in a corner turned to the tree
            across = azimuth + side * rng.uniform(0.6, 0.9)
            way = np.array([np.cos(across), np.sin(across), 0.0]) * rng.uniform(0.5, 4.0)
            wall = bar([0, 0, 0], way, 0.2, 2 * height)
            put(scene, "house", NO_WOOD, wall.moved(foot), look)
        return
    if kind == "legs":
        mesh, look = _leg_pair(rng), simple(rng) | {"kind": "plain"}
    elif kind == "solid":
        mesh, look = solid(rng, log_uniform(rng, 0.15, 0.9)), simple(rng)
        look |= {"color": tuple(0.5 * _color(rng))}
    else:
        mesh, look = _bars(rng, kind), simple(rng)
    put(scene, kind, NO_WOOD, mesh.moved(foot, turn), look)


# Roofs


def _shelter(rng, scene):
    """A roof of any pitch, flat, arched or corrugated, on posts or walls, near the tree or over it.

    What carries a roof is of its class.
    """
    width, depth = rng.uniform([0.8, 0.8], [5.0, 4.0])
    top = scene.target.height
    over, reach = rng.random() < 0.25, 0.5 * np.hypot(width, depth)
    away = rng.uniform(0.0, 0.5) if over else reach + rng.uniform(0.2, 2.5)
    eaves = top + rng.uniform(0.05, 0.6) if over else rng.uniform(0.6, 3.2)
    azimuth = rng.uniform(-np.pi, np.pi)
    foot = foot_at(scene, away * np.array([np.cos(azimuth), np.sin(azimuth)]))
    turn = turn_about(rng.uniform(-np.pi, np.pi))
    rise, shape = rng.uniform(0.0, 1.0), str(rng.choice(["flat", "gable", "arch"]))
    waves = rng.uniform(0.003, 0.03) * (rng.random() < 0.4)
    n_waves = width / rng.uniform(0.05, 0.2)

    def height(u, v):
        form = {"flat": v, "gable": 1 - np.abs(2 * v - 1), "arch": np.sqrt(4 * v * (1 - v))}
        return eaves + rise * form[shape] + waves * np.sin(2 * np.pi * n_waves * u)

    is_printed = rng.random() < 0.7
    look = printed(rng, ("plain", "plain", "photo", "stripes")) if is_printed else simple(rng)
    n_panels = int(np.ceil(width * depth / 2.5))
    fine = int(np.clip(6 * n_waves / n_panels, 8, 90)) if waves else 8
    for number in range(n_panels):
        panel = sheet(width / n_panels, depth, lambda u, v, i=number: height((i + u) / n_panels, v),
                      n=(25, fine))  # fmt: skip
        aside = np.array([((number + 0.5) / n_panels - 0.5) * width, 0, 0])
        put(scene, "roof", Label.ROOF, panel.moved(turn @ aside + foot, turn), look)
    look, thick = simple(rng), log_uniform(rng, 0.03, 0.16)
    corners = np.array([(u, v) for u in (0.02, 0.98) for v in (0.02, 0.98)])
    places = np.column_stack([(corners - 0.5) * [width, depth], height(*corners.T)])
    sides = int(rng.choice([4, 12]))
    posts = [bar([*p[:2], -0.1], p, thick, sides=sides) for p in places if rng.random() < 0.85]
    if rng.random() < 0.6:
        posts += [bar(places[i], places[j], thick) for i, j in ((0, 1), (2, 3), (0, 2), (1, 3))]
    for post in posts:
        put(scene, "roof_post", Label.ROOF, post.moved(foot, turn), look)
    for i, j in ((0, 1), (2, 3), (0, 2), (1, 3)):
        if rng.random() < (0.05 if over else 0.2):
            wall = bar([*places[i][:2], 0], [*places[j][:2], 0], 0.02, 2 * places[[i, j], 2].min())
            put(scene, "roof_wall", Label.ROOF, wall.moved(foot, turn), simple(rng))


# Stems and what lies at their feet


def along_stem(stem, offset, middle, width, n):
    points, reach = stem.at(middle + width * np.linspace(-0.5, 0.5, n))
    return points + offset, reach


def sleeve(rng, scene, number, middle, width, tone):
    """Put a sleeve around a stem."""
    points, radii = along_stem(scene.trees[number].axes[0], scene.offsets[number], middle, width, 7)
    look = {"kind": "plain", "seed": int(rng.integers(1 << 30)), "color": tuple(tone)}
    mesh = ring(points, radii + rng.uniform(0.001, 0.01))
    put(scene, "ring", Label.CALIBRATION_UNIT, mesh, look)


def _ring(rng, scene, number):
    """A sleeve of any colour and 1 to 12 cm anywhere on a stem."""
    stem, width = scene.trees[number].axes[0], log_uniform(rng, 0.012, 0.12)
    middle = rng.uniform(0.05, max(0.7 * stem.arclength[-1], 0.06))
    tone = rng.uniform(0.4, 0.75) * np.ones(3) if rng.random() < 0.6 else _color(rng)
    sleeve(rng, scene, number, middle, width, tone)


def patch(rng, scene, number):
    """Moss, a wound, lime or loose bark on one side of a stem, of any colour: it stays trunk."""
    stem, long = scene.trees[number].axes[0], log_uniform(rng, 0.03, 0.5)
    middle = rng.uniform(0.0, 0.7 * stem.arclength[-1])
    points, radii = along_stem(stem, scene.offsets[number], middle, long, 25)
    around, half = rng.uniform(-np.pi, np.pi), rng.uniform(0.3, 1.4)
    t = np.linspace(-1, 1, 15)
    ragged = fbm(points * 30, octaves=3, seed=int(rng.integers(1 << 30))) + 0.5
    share = np.sqrt(np.clip(1 - np.linspace(-1, 1, 25) ** 2, 0.01, 1)) * ragged
    angle = around + half * share[:, None] * t
    out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    places = points[:, None] + (radii[:, None] + 0.003)[..., None] * out
    flat = sheet(1.0, 1.0, lambda u, v: 0 * u, n=(25, 15))
    flat.vertices = np.tile(places.reshape(-1, 3), (len(flat.vertices) // 375, 1))
    flat.attributes["rest"] = flat.vertices.copy()
    look = {"kind": "plain", "seed": int(rng.integers(1 << 30)), "color": tuple(_color(rng))}
    put(scene, "patch", Label.TRUNK, flat, look)


def ivy(rng, scene, number):
    """Leaves that climb a stem: what hides it is trunk."""
    stem, height = scene.trees[number].axes[0], rng.uniform(0.1, 1.2)
    n = int(rng.uniform(100, 900) * height)
    s = height * rng.random(n) ** rng.uniform(1.0, 2.0)
    points, reach = stem.at(s)
    angle = rng.normal(size=n) * rng.uniform(0.8, 3.0)
    out = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(n)])
    reach = reach + rng.uniform(0.002, 0.025, n)
    points = points + scene.offsets[number] + reach[:, None] * out
    ways = rng.normal(size=(n, 3)) * rng.uniform(0.015, 0.04)
    leaves = blades(points - 0.5 * ways, ways, rng.uniform(0.02, 0.05))
    tone = rng.uniform(0.03, 0.12) * np.array([rng.uniform(0.4, 1.2), 1.0, rng.uniform(0.2, 0.5)])
    look = {"kind": "plain", "seed": int(rng.integers(1 << 30)), "color": tuple(tone)}
    put(scene, "ivy", Label.TRUNK, leaves, look)


def floor(rng, scene, taken):
    """Grass around the stem's foot, stones and a hose on the ground, all of class ground."""
    if rng.random() < 0.6:
        n, reach = int(rng.uniform(100, 1500)), rng.uniform(0.1, 0.6)
        xy = rng.normal(size=(n, 2)) * reach
        feet = np.column_stack([xy, scene.ground_height(xy)])
        tall = log_uniform(rng, 0.04, 0.35)
        ways = np.column_stack([rng.normal(size=(n, 2)) * 0.4, np.ones(n)])
        ways *= tall * rng.uniform(0.4, 1.1, (n, 1))
        tone = 0.25 * _color(rng) + rng.uniform(0.02, 0.2) * np.array([0.8, 1.0, 0.3])
        look = {"kind": "plain", "seed": int(rng.integers(1 << 30)), "color": tuple(tone)}
        put(scene, "grass", Label.GROUND, blades(feet, ways, rng.uniform(0.004, 0.012)), look)
    for _ in range(int(rng.choice([0, 0, 1, 4]))):
        xy, _ = beside(rng, [], 0.15, 2.0)
        t, size = np.linspace(0, np.pi, 9), log_uniform(rng, 0.05, 0.5)
        stone = turned(0.5 * size * np.sin(t), -0.3 * size * np.cos(t), 12)
        turn = turn_about(rng.uniform(0, np.pi)) @ np.diag([1.0, rng.uniform(0.5, 1.0), 1.0])
        look = simple(rng) | {"kind": "plain"}
        put(scene, "stone", Label.GROUND, stone.moved(foot_at(scene, xy), turn), look)
    if rng.random() < 0.2:
        t, radius = np.linspace(-3, 3, 80), rng.uniform(0.006, 0.03)
        bend = rng.normal(size=4) * 0.3
        xy = np.column_stack([t, 0.15 + bend[0] * np.sin(t + bend[1]) + bend[2] * np.sin(2.3 * t)])
        xy = xy @ turn_about(rng.uniform(0, np.pi))[:2, :2].T
        hose = tube(np.column_stack([xy, scene.ground_height(xy) + radius]), radius)
        put(scene, "hose", Label.GROUND, hose, simple(rng) | {"kind": "plain"}, radius=radius)


def add_random(scene, rng):
    """Set things drawn at random into a scene of `random_things`, in place."""
    taken = [np.mean(marker["corners"], axis=0)[:2] for marker in scene.markers]
    makers = ((board, 0.4, 0.5), (calibration_unit, 0.4, 0.2), (stray, 0.35, 0.25),
              (add_post, 0.25, 0.1))  # fmt: skip
    for make, one, two in makers:
        for _ in range(int(rng.choice([0, 1, 2], p=[1 - one - two, one, two]))):
            make(rng, scene, taken)
    if rng.random() < 0.45:
        _shelter(rng, scene)
    for number in range(len(scene.trees)):
        for make, mean in ((_ring, 0.8), (patch, 0.8), (ivy, 0.15)):
            for _ in range(min(rng.poisson(mean), 4)):
                make(rng, scene, number)
    floor(rng, scene, taken)
