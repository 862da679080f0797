"""Two dates of generated trees, seen twice: skeletons as found, and what truly changed."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from cherrypicker.classes import wood_mask
from cherrypicker.geometry.similarity import moved
from cherrypicker.series.compare import Scan, compare_scans
from cherrypicker.series.wood import sample_wood
from cherrypicker.skeleton import axes
from cherrypicker.traits.branches import branch_rows
from cherrypicker_lab.orchard.grow.growth import HABITS
from cherrypicker_lab.orchard.grow.seasons import at_date
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.scene.mesh import NO_TREE
from cherrypicker_lab.orchard.seen.as_seen import AsSeen
from cherrypicker_lab.orchard.seen.sampling import sample_scene
from cherrypicker_lab.series.judge import judge_step
from cherrypicker_lab.skeletons.methods import find_skeleton

NOISE_M = 0.002  # of the exact surface's points: a good scan's
KINDS = ("same", "grown", "pruned", "both")
PHOTOS = (36, 65)
# What is drawn of a scan around what `AsSeen` has of rendered photos, and how widely (log scale)
DRAWN = ("pixel_m", "match_px", "thin_noise", "sink_share", "jitter_px", "spill_px", "width_px")
SPREAD = 0.25
FORMS = (*sorted(HABITS), "cherry_leader", "cherry_spindle", "cherry_vase")


def make_date(seed, kind):
    """The scene of a seed, and its target at a date as a `DatedTree`.

    The kind, one of `KINDS`, says what became of the tree; the "first" date is the tree as it grew.
    """
    scene = generate_scene(seed, habit=FORMS[seed % len(FORMS)], neighbours=0, markers=[])
    dated = at_date(scene.target, kind, seed)
    return replace(scene, trees=[dated.tree, *scene.trees[1:]]), dated


def walk_around(rng):
    """A scan from photos on all sides, around what the dense stage makes of rendered ones."""
    n_photos = int(rng.integers(*PHOTOS))
    usual = AsSeen()
    drawn = {name: getattr(usual, name) * np.exp(rng.normal(0.0, SPREAD)) for name in DRAWN}
    return replace(usual, n_photos=n_photos, **drawn)


def see_date(scene, seed, kind, n_points, walk):
    """A labelled cloud of a date, with its own noise and in a frame of its own.

    The kind is as in `make_date`; the first date's frame is the scene's. The walk is "noise", the
    exact surface with Gaussian noise, or "seen", as photos see it, see `walk_around`. The frame (4,
    4) that comes with the cloud brings the scene's frame to the cloud's.
    """
    rng = np.random.default_rng([int(seed), *kind.encode()])
    if walk == "noise":
        cloud = sample_scene(scene, n_points, rng=rng, exact=True, is_colored=False)
        cloud.points = cloud.points + rng.normal(0.0, NOISE_M, cloud.points.shape)
    else:
        cloud = sample_scene(scene, n_points, rng=rng, as_seen=walk_around(rng))
    cloud = cloud.select(np.isin(cloud["tree"], (0, NO_TREE)))
    del cloud.fields["tree"]
    frame = np.eye(4)
    if kind != "first":
        tilt = np.radians(rng.normal(0.0, 0.5, 2))
        turn = Rotation.from_euler("zxy", [rng.uniform(-np.pi, np.pi), *tilt])
        frame[:3, :3] = turn.as_matrix()
        frame[:3, 3] = [*rng.uniform(-0.5, 0.5, 2), rng.normal(0.0, 0.02)]
    cloud.points = moved(cloud.points, frame)
    return cloud, frame


def as_scan(name, cloud, frame):
    """What the stage reads of a finished scan of a cloud, see `see_date`."""
    skeleton, _ = find_skeleton(cloud, target_xy=frame[:2, 3].copy())
    branches = branch_rows(skeleton, axes(skeleton), float(skeleton.points[0, 2]))
    points = cloud.points[wood_mask(cloud["label"])]
    return Scan(name, "", sample_wood(skeleton), branches, points)


def measure_pairs(seed, n_points, walk):
    """See a tree at its first date and after each kind of change, compare, and judge.

    Each cloud has `n_points`, 45 % of them ground; the walk is as in `see_date`. Returns `seed`,
    `habit`, `walk`, and `pairs`: kind to what `judge.judge_step` says.
    """
    seen = {}
    for kind in ("first", *KINDS):
        scene, dated = make_date(seed, kind)
        cloud, frame = see_date(scene, seed, kind, n_points, walk)
        seen[kind] = dated, frame, as_scan(kind, cloud, frame)
    first, _, earlier = seen["first"]
    pairs = {}
    for kind in KINDS:
        dated, frame, later = seen[kind]
        comparison = compare_scans([earlier, later])
        pairs[kind] = judge_step(comparison, first, dated, later.wood, frame)
    return {"seed": int(seed), "habit": first.tree.habit, "walk": walk, "pairs": pairs}
