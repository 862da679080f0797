"""What stands around a scan, as real geometry: hills, hedges, buildings, the orchard's other rows.

Nothing of it has a class, and no cloud holds it (the clouds end 3 m from the stem); photos, their
depth and their masks do. Frame: metres, z up, the row along x, the target's stem at the origin.
"""

import numpy as np

from cherrypicker.classes import Label
from cherrypicker_lab.orchard.grow.templates import grow_any
from cherrypicker_lab.orchard.scene.buildings import barn, garden_wall, shed
from cherrypicker_lab.orchard.scene.bushes import bush, hedge
from cherrypicker_lab.orchard.scene.mesh import SceneObject, join, tree_mesh, turn_about
from cherrypicker_lab.orchard.scene.noise import fbm

BACKGROUNDS = ("hills", "hedges", "buildings", "rows")

# hills as high as on captures in hilly orchards: the horizon 9 to 22 degrees above the camera
HILL_FROM_M, HILL_TO_M = 8.0, 38.0
HILL_M = (6.0, 15.0)  # heights at HILL_TO_M
ROW_STEP_M = (4.6, 5.2)  # between rows (alleys of 4 to 5 m take a tractor)
ROW_REACH_M = 24.0  # rows go on up to here; what lies behind is the backdrop's treeline
NEAR_ROW_M = 7.0  # trees within get their twigs, beyond a twig is below a pixel
N_FORMS = 5  # different trees in the rows, each turned at random
KEEP_FROM_STEMS_M = 2.2


def hill_height(xy, seed):
    """How far hills around the orchard rise above its floor at xy (N, 2), m; (N,).

    It is 0 within `HILL_FROM_M` of the stem; the seed is the ground's.
    """
    distance = np.linalg.norm(xy, axis=1)
    way = np.column_stack([xy / np.maximum(distance, 1e-9)[:, None], np.full(len(xy), 3.0)])
    high = HILL_M[0] + (HILL_M[1] - HILL_M[0]) * np.clip(
        0.5 + 2.2 * (fbm(way * 1.4, octaves=3, seed=seed + 81) - 0.5), 0, 1
    )
    t = np.clip((distance - HILL_FROM_M) / (HILL_TO_M - HILL_FROM_M), 0, 1)
    p = np.column_stack([xy, np.zeros(len(xy))])
    humps = 1.6 * (fbm(p * 0.16, octaves=4, gain=0.5, seed=seed + 83) - 0.5)
    return high * t**1.4 + humps * np.clip(4 * t, 0, 1)


def _free_place(rng, low, high, taken, apart):
    """A place at a distance in [low, high] that keeps `apart` from those in `taken`; or None."""
    for _ in range(60):
        azimuth, r = rng.uniform(-np.pi, np.pi), rng.uniform(low, high)
        xy = r * np.array([np.cos(azimuth), np.sin(azimuth)])
        if all(np.linalg.norm(xy - other) > gap + apart for other, gap in taken):
            taken.append((xy, apart))
            return xy
    return None


def _foot(xy, ground):
    return np.append(xy, ground(np.asarray(xy)[None])[0])


def _bushes(rng, seed, n, low, high, taken, ground, *, leaf_m):
    made = []
    for i in range(n):
        width = rng.uniform(1.2, 2.6)
        xy = _free_place(rng, low, high, taken, 0.6 * width)
        if xy is not None:
            tall = width * rng.uniform(0.7, 1.15)
            made.append(bush(rng, f"bush_{seed + i}", _foot(xy, ground), tall, width, seed + i,
                             leaf_m=leaf_m))  # fmt: skip
    return made


def _hills(rng, seed, taken, ground):
    """Bushes strewn over the slopes; the hills themselves are the ground's (`hill_height`)."""
    return _bushes(rng, seed + 300, 22, 9.0, 30.0, taken, ground, leaf_m=0.12)


def _hedges(rng, seed, taken, ground):
    """Hedges along both sides of the orchard and bushes between and behind them."""
    made = []
    for number, side in enumerate((-1, 1)):
        y = side * rng.uniform(5.2, 8.0)
        slant = rng.uniform(-0.12, 0.12)
        first, last = -rng.uniform(6.0, 10.0), rng.uniform(3.0, 10.0)
        if rng.random() < 0.5:
            first, last = -last, -first
        ends = [np.array([x, y + slant * x]) for x in (first, last)]
        height, width = rng.uniform(1.7, 2.8), rng.uniform(0.8, 1.2)
        made.append(hedge(rng, f"hedge_{number}", *ends, height, width, ground, seed + number))
        taken.extend((ends[0] + t * (ends[1] - ends[0]), 1.0) for t in np.linspace(0, 1, 9))
    made += _bushes(rng, seed + 320, 12, 6.0, 12.0, taken, ground, leaf_m=0.07)
    return made + _bushes(rng, seed + 360, 10, 13.0, 24.0, taken, ground, leaf_m=0.14)


def _buildings(rng, seed, taken, ground):
    """A wall and a shed on one side of the row, a barn and a wall on the other, and bushes."""
    side = rng.choice([-1, 1])
    plots = [
        (garden_wall, side, rng.uniform(-5.0, -2.0), rng.uniform(6.0, 8.0),
         {"length": rng.uniform(6.0, 9.0), "height": rng.uniform(1.9, 2.5)}),
        (shed, side, rng.uniform(3.5, 5.5), rng.uniform(5.2, 7.5),
         {"width": rng.uniform(3.2, 4.4), "height": rng.uniform(2.3, 2.9)}),
        (barn, -side, rng.uniform(-3.5, 0.0), rng.uniform(7.5, 9.5),
         {"width": rng.uniform(7.0, 9.0), "ridge": rng.uniform(4.4, 5.2)}),
        (garden_wall, -side, rng.uniform(6.0, 7.5), rng.uniform(5.5, 7.5),
         {"length": rng.uniform(4.0, 6.0), "height": rng.uniform(1.6, 2.2)}),
    ]  # fmt: skip
    made = []
    for number, (build, way, x, y, size) in enumerate(plots):
        xy = np.array([x, way * y])
        azimuth = np.arctan2(way, 0.0) + rng.normal() * 0.12
        parts = build(rng, _foot(xy, ground), azimuth, seed + 400 + 7 * number, **size)
        for part in parts:
            part.name = f"{part.name}_{number}"
        made += parts
        half = 0.5 * size.get("length", size.get("width"))
        taken.extend((xy + [t, way * 1.5], 2.0) for t in np.linspace(-half, half, 5))
    return made + _bushes(rng, seed + 440, 7, 6.5, 14.0, taken, ground, leaf_m=0.08)


def _coarse(tree, is_near):
    """A tree's mesh with few facets, without its thinnest axes where they would not be seen."""
    if is_near:
        return tree_mesh(tree, row_step=0.03, side_step=0.02, max_sides=10, min_sides=4)
    mesh = tree_mesh(tree, row_step=0.08, side_step=0.04, max_sides=6, min_sides=3)
    seen = np.array([axis.radii[0] > 0.004 for axis in tree.axes])
    mesh.faces = mesh.faces[seen[mesh.attributes["axis"][mesh.faces[:, 0]]]]
    return mesh


def _rows(rng, seed, scene, ground):
    """The orchard's other rows on both sides, and the own row's further trees."""
    habit = scene.options["habit"]  # a target from elsewhere is of none
    height = scene.target.height
    forms = [
        grow_any(seed * 31 + 7 + i, habit, height=height * rng.uniform(0.8, 1.1),
                 trunk_radius=None, density=rng.uniform(1.0, 1.4)) for i in range(N_FORMS)
    ]  # fmt: skip
    meshes = [(_coarse(tree, True), _coarse(tree, False)) for tree in forms]
    spacing = max(2.2, float(scene.options.get("row_spacing", 3.2)))
    step = rng.uniform(*ROW_STEP_M)
    rest = [0.0, *scene.offsets[1:, 0]]
    made = []
    for row in range(-int(ROW_REACH_M // step), int(ROW_REACH_M // step) + 1):
        shift = rng.uniform(0, spacing) if row else 0.0
        for x in np.arange(-ROW_REACH_M, ROW_REACH_M, spacing) + shift:
            xy = np.array([x, row * step]) + rng.normal(size=2) * 0.1
            if np.hypot(*xy) > ROW_REACH_M:
                continue
            if row == 0 and min(abs(x - taken) for taken in rest) < 0.8 * spacing:
                continue
            pick, turn = int(rng.integers(N_FORMS)), turn_about(rng.uniform(0, 2 * np.pi))
            is_near = np.hypot(*xy) < NEAR_ROW_M
            mesh = meshes[pick][0 if is_near else 1]
            made.append((pick, mesh.moved(_foot(xy, ground) - [0, 0, 0.01], turn)))
    joined = []
    for pick, tree in enumerate(forms):
        parts = [mesh for number, mesh in made if number == pick]
        if parts:
            joined.append(SceneObject(f"row_trees_{pick}", int(Label.UNLABELLED), join(parts),
                                      tree.bark, radius=0.01))  # fmt: skip
    return joined


def surroundings(scene):
    """Objects of a scene's background, one of `BACKGROUNDS` or None for none.

    They are of no class (`Label.UNLABELLED`), and none is nearer to the stem than 3 m.
    """
    if scene.background is None:
        return []
    seed, ground = int(scene.seed), scene.ground_height
    rng = np.random.default_rng([seed, 461])
    if scene.background == "rows":
        return _rows(rng, seed, scene, ground)
    taken = [(stem[:2], KEEP_FROM_STEMS_M) for stem in scene.offsets]
    build = {"hills": _hills, "hedges": _hedges, "buildings": _buildings}[scene.background]
    return build(rng, seed, taken, ground)
