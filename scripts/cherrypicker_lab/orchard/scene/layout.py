"""Lay an orchard scene out: target tree, neighbours, ground, sign, markers, calibration, roof.

Frame: metres, z up, the row along x, the target's stem foot at the origin on the ground.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from cherrypicker.classes import Label
from cherrypicker_lab.orchard.grow.dressing import dress_tree, run_wild
from cherrypicker_lab.orchard.grow.elsewhere import tree_from_skeleton
from cherrypicker_lab.orchard.grow.growth import HABITS
from cherrypicker_lab.orchard.grow.templates import grow_any
from cherrypicker_lab.orchard.scene.appearance import make_light
from cherrypicker_lab.orchard.scene.boards import (
    board_on_post,
    checker_cube,
    marker_object,
    stem_ring,
)
from cherrypicker_lab.orchard.scene.buds import bud_mesh, set_buds
from cherrypicker_lab.orchard.scene.ground import GROUNDS
from cherrypicker_lab.orchard.scene.mesh import SceneObject, join, tree_mesh
from cherrypicker_lab.orchard.scene.noise import fbm
from cherrypicker_lab.orchard.scene.structures import (
    WIRE_RADIUS_M,
    foil_roof,
    support_post,
    trellis,
)
from cherrypicker_lab.orchard.scene.structures import net as hang_net
from cherrypicker_lab.orchard.scene.surroundings import BACKGROUNDS, hill_height, surroundings

DRESSING = ("wires", "paint", "stubs", "spurs", "buds", "relief", "wind", "net")
NEAR_M = 5.0  # cameras stand nearer to the stem
DICTIONARIES = ("DICT_4X4_50", "DICT_5X5_100", "DICT_6X6_250", "DICT_APRILTAG_36h11")


@dataclass
class Scene:
    """An orchard scene."""

    seed: int
    trees: list  # the target first
    offsets: np.ndarray  # (n_trees, 3): stem feet, m
    objects: list  # all that is neither a tree nor the ground
    # `dictionary`, `id`, `side_m`, `corners` (4, 3) in the order of OpenCV (clockwise from the
    # marker's top left)
    markers: list
    light: object
    ground_seed: int
    ground_relief_m: tuple  # amplitudes of the gentle and of the fine relief, m
    options: dict = field(default_factory=dict)  # what was asked for, for the record
    ground_kind: str = "meadow"  # a key of `ground.GROUNDS`
    # Amplitude of the sway from photo to photo, see `wind.sway`; the scene is at rest
    wind_m: float = 0.0
    # One of `surroundings.BACKGROUNDS`; None for nothing but what lies at infinity
    background: str | None = None

    @property
    def target(self):
        """The tree that the cameras look at."""
        return self.trees[0]

    def ground_height(self, xy):
        """Ground level z (N,) at positions xy (N, 2), m; 0 at the target's stem."""
        return _ground_height(xy, self.ground_seed, self.ground_relief_m, self.background)

    @cached_property
    def surroundings(self):
        """Objects of the background, see `surroundings.surroundings`; clouds leave them out."""
        return surroundings(self)

    def neighbour_wood(self):
        """Skeleton nodes of all trees but the target, shape (n, 3), m."""
        nodes = [t.skeleton().points + o for t, o in zip(self.trees[1:], self.offsets[1:])]
        return np.concatenate([np.empty((0, 3)), *nodes])

    def obstacles(self):
        """Where no photographer can stand, shape (n, 3), m: neighbours, posts, background."""
        posts = [
            thing.mesh.vertices
            for thing in self.objects
            if thing.label == Label.SUPPORT_POST and thing.radius > WIRE_RADIUS_M
        ]
        around = [thing.mesh.vertices for thing in self.surroundings]
        near = [points[np.hypot(points[:, 0], points[:, 1]) < NEAR_M] for points in around]
        return np.concatenate([self.neighbour_wood(), *posts, *near])

    def tree_objects(self, **resolution):
        """One bark object per tree, meshed at the resolution asked for (see `tree_mesh`).

        Buds are part of it; the relief of the bark is not (see `appearance.bark_relief`).
        """
        made = []
        for i, (tree, offset) in enumerate(zip(self.trees, self.offsets)):
            mesh = tree_mesh(tree, **resolution)
            if tree.buds is not None:
                mesh = join([mesh, bud_mesh(tree.buds)])
            name, label = f"tree{i}", int(Label.BRANCH)
            made.append(SceneObject(name, label, mesh.moved(offset), tree.bark, i))
        return made


def _ground_height(xy, seed, relief, background=None):
    def level(at):
        p = np.column_stack([at, np.zeros(len(at))])
        gentle = fbm(p * 0.35 + 100.0, octaves=2, gain=0.4, seed=seed + 3) - 0.5
        fine = fbm(p * 5.0, octaves=3, gain=0.5, seed=seed + 5) - 0.5
        return relief[0] * gentle + relief[1] * fine

    xy = np.asarray(xy, float)
    z = level(xy) - level(np.zeros((1, 2)))[0]
    return z + hill_height(xy, seed) if background == "hills" else z


def _around(rng, low, high, avoid=None, spread=0.9):
    """A random place at a distance in [low, high] whose azimuth keeps off those in `avoid`."""
    avoid = [] if avoid is None else avoid
    for _ in range(50):
        azimuth = rng.uniform(-np.pi, np.pi)
        if all(abs(np.angle(np.exp(1j * (azimuth - a)))) > spread for a in avoid):
            break
    avoid.append(azimuth)
    return rng.uniform(low, high) * np.array([np.cos(azimuth), np.sin(azimuth)]), azimuth


def _plant_neighbours(rng, seed, n, spacing, ground, habit):
    trees, offsets = [], []
    for i in range(n):
        side = (-1) ** i
        x = side * (1 + i // 2) * spacing * rng.uniform(0.93, 1.07)
        xy = np.array([x, rng.normal() * 0.06])
        trees.append(grow_any(seed * 97 + 13 + i, habit, density=rng.uniform(0.7, 1.0)))
        offsets.append([*xy, ground(xy[None])[0] - 0.01])
    return trees, offsets


def generate_scene(
    seed,
    *,
    habit=None,
    height=None,
    trunk_radius=None,
    density=1.0,
    sky=None,
    neighbours=None,
    row_spacing=None,
    markers=None,
    sign=None,
    ring=None,
    cube=None,
    post=None,
    roof=None,
    wires=0,
    paint=0.0,
    stubs=0,
    spurs=0.0,
    buds=0.0,
    relief=0.0,
    ground="meadow",
    net=None,
    wind=0.0,
    background=None,
    tip_radius=None,
    skeleton=None,
):
    """Lay out a random orchard scene; every option left at None is drawn from the seed.

    Parameters
    ----------
    seed : int
        Equal arguments give an equal scene.
    habit : str, optional
        Form of the trees: "leader", "spindle" or "vase", one of which is drawn by default, or a
        template of Weber and Penn, see `templates.grow_any`.
    height, trunk_radius : float, optional
        Of the target, m.
    density : float, default 1
        How closely the target's laterals and twigs stand.
    sky : {"clear", "broken", "overcast", "low"}, optional
        Light; one of the first three by default, "low" is a low warm sun.
    neighbours : int, optional
        Number of other trees in the row (0 to 2 by default).
    row_spacing : float, optional
        Distance between the trees of the row, m (2.2 to 3.8 by default).
    markers : list of dict, optional
        `dictionary`, `id`, `side_m` and optionally `pose` ("lying", "standing", "post"), `xy`,
        `azimuth` (rad, of the marker's own up), `tilt` (rad, of a lying board). One random
        marker by default, [] for none.
    sign, ring, cube, post, roof : bool, optional
        Whether the scene has a sign, a white calibration ring on the stem, a checker cube, a
        support post beside the stem, a roof of foil. `sign` may also be a dict with `xy`, `width`
        and `top` (m).
    wires : int, default 0
        Wires along the row, between two posts.
    paint : float, default 0
        Height up to which stems are painted white, m.
    stubs : int, default 0
        Branches of the target that were cut back to a stub.
    spurs : float, default 0
        Short fruiting spurs a metre of the target's older branches.
    buds : float, default 0
        Buds a metre of the young wood of all trees, and one on each tip.
    relief : float, default 0
        Depth of the relief of the bark of all trees, of that of old cherry trees.
    ground : str, default "meadow"
        Kind of floor, a key of `ground.GROUNDS`.
    net : {"over", "along"}, optional
        A net over the row or beside it; none by default.
    wind : float, default 0
        How far the tip of a twig of 0.5 m sways from photo to photo, m root mean square.
    background : {"hills", "hedges", "buildings", "rows"}, optional
        What stands around, see `surroundings`; by default only what lies at infinity.
    tip_radius : tuple of float, optional
        (low, high) of the radii of the target's tips, m, for a template of Weber and Penn.
    skeleton : path-like, optional
        File of a tree that we did not grow, see `elsewhere.tree_from_skeleton`: the target, with
        shoots and spurs where its scan ends, in place of one of the habit.

    Raises
    ------
    ValueError
        If the habit, the ground, the net or the background is not known.
    """
    if background is not None and background not in BACKGROUNDS:
        raise ValueError(f"background must be one of {', '.join(BACKGROUNDS)}, got {background!r}")
    if ground not in GROUNDS:
        raise ValueError(f"ground must be one of {', '.join(GROUNDS)}, got {ground!r}")
    options = {k: v for k, v in locals().items() if k != "seed" and v is not None}
    options = {k: v for k, v in options.items() if v or k not in DRESSING}
    rng = np.random.default_rng([int(seed), 1])
    # all draws happen whatever the options say, so that one option does not reshuffle the rest
    drawn = {
        "habit": str(rng.choice(sorted(HABITS))),
        "neighbours": int(rng.integers(0, 3)),
        "row_spacing": rng.uniform(2.2, 3.8),
        "sign": rng.random() < 0.7,
        "ring": rng.random() < 0.5,
        "cube": rng.random() < 0.25,
        "post": rng.random() < 0.4,
        "roof": rng.random() < 0.2,
    }
    pick = {k: options.get(k, value) for k, value in drawn.items()}
    slopes = (rng.uniform(0.04, 0.20), rng.uniform(0.015, 0.05))
    ground_seed = int(rng.integers(1 << 30))

    def level(xy):
        return _ground_height(xy, ground_seed, slopes, background)

    light = make_light(np.random.default_rng([int(seed), 2]), sky)
    if skeleton:
        its_own = np.random.default_rng([int(seed), 11])
        target = tree_from_skeleton(skeleton, its_own)
        run_wild(its_own, target, twigs=True)
    else:
        target = grow_any(
            seed, pick["habit"], height=height, trunk_radius=trunk_radius, density=density,
            tip_radius=tip_radius,
        )  # fmt: skip
    dress_tree(target, seed, stubs=stubs, spurs=spurs)
    others, offsets = _plant_neighbours(
        np.random.default_rng([int(seed), 3]), int(seed), pick["neighbours"],
        pick["row_spacing"], level, pick["habit"],
    )  # fmt: skip
    objects, truth = _place_objects(
        np.random.default_rng([int(seed), 4]), int(seed), pick, markers, target, level
    )
    for i, tree in enumerate((target, *others)):
        tree.paint_m, tree.relief = float(paint), float(relief)
        if buds > 0:
            tree.buds = set_buds(np.random.default_rng([int(seed), 10, i]), tree, float(buds))
    if wires:
        objects.extend(trellis(int(seed), pick["row_spacing"], wires, level))
    if net:
        objects.extend(hang_net(int(seed), net, target.height, level))
    return Scene(
        int(seed), [target, *others], np.array([[0.0, 0.0, 0.0], *offsets]), objects, truth,
        light, ground_seed, slopes, options | pick, ground,
        float(wind), background,
    )  # fmt: skip


def _place_objects(rng, seed, pick, markers, target, ground):
    taken, objects, truth = [], [], []
    if markers is None:
        markers = [
            {
                "dictionary": str(rng.choice(DICTIONARIES)),
                "id": int(rng.integers(0, 50)),
                "side_m": float(rng.choice([0.10, 0.15, 0.20, 0.25])),
                "pose": str(rng.choice(["lying", "standing"])),
            }
        ]
    if pick["post"]:
        side = rng.choice([-1, 1])
        xy = np.array([side * rng.uniform(0.10, 0.22), rng.normal() * 0.03])
        taken.append(np.arctan2(xy[1], xy[0]))
        objects.append(support_post(rng, seed, ground, xy))
    for wanted in markers:
        xy, azimuth = _around(rng, 0.45, 0.95, taken)
        xy = np.asarray(wanted.get("xy", xy), float)
        spec = {
            "pose": "lying", "tilt": rng.uniform(0, 0.25),
            "azimuth": azimuth + np.pi + rng.normal() * 0.4, **wanted,
        }  # fmt: skip
        made, marker = marker_object(spec, xy, ground(xy[None])[0], seed)
        objects.extend(made)
        truth.append(marker)
    if pick["sign"]:
        xy, azimuth = _around(rng, 0.6, 1.2, taken, spread=0.6)
        spec = {"xy": xy, **(pick["sign"] if isinstance(pick["sign"], dict) else {})}
        azimuth = np.arctan2(spec["xy"][1], spec["xy"][0])
        level = ground(np.asarray(spec["xy"], float)[None])[0]
        objects.extend(board_on_post(rng, seed, spec, azimuth, level))
    if pick["cube"]:
        xy, _ = _around(rng, 0.4, 1.1, taken, spread=0.6)
        objects.append(checker_cube(rng, seed, xy, ground(xy[None])[0]))
    if pick["ring"]:
        objects.append(stem_ring(rng, seed, target.axes[0]))
    if pick["roof"]:
        objects.append(foil_roof(rng, seed))
    return objects, truth
