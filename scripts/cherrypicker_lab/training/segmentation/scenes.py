"""Training and held-out clouds from the orchard generator, cached as small arrays."""

import logging
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import Label, wood_mask
from cherrypicker.errors import StageError
from cherrypicker.files import atomic_path
from cherrypicker.progress import Progress
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.scene.variety import bearing_form
from cherrypicker_lab.orchard.seen.sampling import sample_scene
from cherrypicker_lab.orchard.truth import GENERATOR_VERSION
from cherrypicker_lab.training.segmentation.augment import Sample
from cherrypicker_lab.training.segmentation.hard_props import add_hard, hard_things
from cherrypicker_lab.training.segmentation.props import (
    FORMS,
    add_confusable,
    common_things,
    confusable_things,
)
from cherrypicker_lab.training.segmentation.random_props import add_random, random_things

logger = logging.getLogger(__name__)

HELD_OUT_SEED = 900_000  # held-out seeds start here, far from any number of training seeds
UNDER_RING_M = 0.01  # wood this near to a ring's points is under it
# by what stands about the tree: what a scene is drawn with and filled up by
FILLED = {
    "confusable": (confusable_things, add_confusable),
    "random": (random_things, add_random),
    "hard": (hard_things, add_hard),
    "elsewhere": (hard_things, add_hard),  # and trees of other people's skeletons
}
THINGS = ("common", *FILLED)
# Of fresh scenes (taste: random things vary most); the shipped weights were not trained on these
SHARES = {"common": 0.15, "confusable": 0.15, "random": 0.3, "hard": 0.2, "elsewhere": 0.2}
# clouds reach so far at most
EXTENT_M = {"common": 3.2, "confusable": 3.2, "random": 4.5, "hard": 3.5, "elsewhere": 3.5}
QUANTUM_M = 0.00025  # resolution of the coordinates in the cache; they reach 8 m


def make_sample(seed, n_points=250_000, *, habit=None, things="common", skeletons=()):
    """One labelled cloud "as seen" by a dense reconstruction.

    The seed decides the scene and its imperfections. Below `HELD_OUT_SEED` a fifth are bearing
    trees. Of the others half have the generator's own size, the rest are 1.2 to 4.5 m tall. Between
    a quarter and all of `n_points` points are drawn. The habit is as in `generate_scene`, drawn
    from its trained forms and `variety.bearing_form` by default.

    Of `THINGS`, what stands about the tree is as in most orchards ("common"), passes for one
    another ("confusable", see `props`), is drawn at random ("random", see `random_props`), or is
    what the network got wrong (see `hard_props`), around trees of our own forms ("hard") or of the
    skeleton files ("elsewhere").

    Points are float32, colours uint8 (0 to 255), to keep many scenes in memory. Raises a
    `StageError` if trees from elsewhere are asked for and none is given.
    """
    if things == "elsewhere" and not skeletons:
        raise StageError("no skeleton files of trees from elsewhere are given", key="--trees")
    rng = np.random.default_rng([seed, 77])
    if habit is None and seed < HELD_OUT_SEED:
        habit = bearing_form(seed)
    size = {}
    if rng.random() < 0.5 and habit is None:
        height = float(rng.uniform(1.2, 4.5))
        size = {"height": height, "trunk_radius": height * float(rng.uniform(0.011, 0.024))}
    n_points = int(n_points * np.exp(rng.uniform(np.log(0.25), 0.0)))
    if things == "common":
        scene = generate_scene(seed, habit=habit, **size, **common_things(rng))
    else:
        options, fill = FILLED[things]
        form = habit or str(rng.choice(FORMS))
        scene = generate_scene(seed, habit=form, **size | options(rng))
        fill(scene, rng, *([skeletons] if things == "elsewhere" else []))
    cloud = sample_scene(
        scene,
        n_points,
        rng=rng,
        extent=float(rng.uniform(1.5, EXTENT_M[things])),
        ground_share=float(rng.uniform(0.25, 0.5)),
    )
    return without_hidden_bark(
        Sample(
            cloud.points.astype(np.float32),
            np.rint(cloud.colors * 255).astype(np.uint8),
            cloud["label"],
            cloud["tree"],
        )
    )


def hidden_bark(points, labels):
    """Which wood lies under a calibration ring, where nothing can see it, (n,) bool.

    The sampled surface of a scene has the bark below a sleeve as well as the sleeve.
    """
    hidden = np.zeros(len(points), bool)
    rings = points[labels == Label.CALIBRATION_UNIT]
    if not len(rings):
        return hidden
    low, high = rings.min(axis=0) - UNDER_RING_M, rings.max(axis=0) + UNDER_RING_M
    wood = wood_mask(labels)
    rows = np.flatnonzero(wood & (points > low).all(axis=1) & (points < high).all(axis=1))
    distance, _ = cKDTree(rings).query(points[rows], distance_upper_bound=UNDER_RING_M)
    hidden[rows] = np.isfinite(distance)
    return hidden


def without_hidden_bark(sample):
    """A generated `Sample` without its `hidden_bark`."""
    hidden = hidden_bark(sample.points, sample.labels)
    return sample.select(~hidden) if hidden.any() else sample


def load_samples(seeds, folder, n_points=250_000, *, habits=(None,), things="common", skeletons=()):
    """Clouds of many seeds, made once by `make_sample` and kept in a folder.

    The folder gets one NPZ a scene, named by the generator's version, the form and the seed; the
    forms `habits` are taken in turn.
    """
    folder, seeds, samples = Path(folder), list(seeds), []
    folder.mkdir(parents=True, exist_ok=True)
    with Progress(len(seeds), "generated scenes") as bar:
        for number, seed in enumerate(seeds):
            habit = habits[number % len(habits)]
            kind = (habit or "any") + ("" if things == "common" else f"_{things}")
            file = folder / f"scene_v{GENERATOR_VERSION}_{kind}_{seed:06d}_{n_points}.npz"
            if not file.is_file():
                options = {"habit": habit, "things": things, "skeletons": skeletons}
                _save(file, make_sample(seed, n_points, **options))
            samples.append(_load(file))
            bar.step()
    shares = np.bincount(np.concatenate([s.labels for s in samples]), minlength=256)
    told = [f"{label.name.lower()} {shares[label]:,}" for label in Label if shares[label]]
    logger.info("%d scenes, points a class: %s", len(samples), ", ".join(told))
    return samples


class FreshScenes:
    """Scenes that are made as they are asked for: in each epoch new ones, kept nowhere.

    An epoch has `n_scenes` of them, then the samples `more`. The skeletons are files of trees from
    elsewhere; without one there are no such scenes. Raises a `StageError` if the first epoch would
    reach the held-out seeds; `begin` raises it for the later ones.
    """

    def __init__(self, first_seed, n_scenes, n_points=250_000, *, skeletons=(), more=()):
        self.first_seed, self.n_scenes, self.n_points = first_seed, n_scenes, n_points
        self.skeletons, self.more = sorted(skeletons), list(more)
        self.begin(0)

    def begin(self, epoch):
        """Take the seeds of an epoch."""
        self.seed = self.first_seed + epoch * self.n_scenes
        if self.first_seed < 0 or self.seed + self.n_scenes > HELD_OUT_SEED:
            raise StageError(
                f"training seeds are 0 to {HELD_OUT_SEED - 1}, epoch {epoch + 1} asks for "
                f"{self.n_scenes} from {self.seed}",
                key="train_segment.n_scenes",
            )

    def __len__(self):
        return self.n_scenes + len(self.more)

    def __getitem__(self, number):
        if number >= self.n_scenes:
            return self.more[number - self.n_scenes]
        seed = self.seed + number
        kinds = [kind for kind in SHARES if kind != "elsewhere" or self.skeletons]
        shares = np.array([SHARES[kind] for kind in kinds])
        things = str(np.random.default_rng([seed, 78]).choice(kinds, p=shares / shares.sum()))
        return make_sample(seed, self.n_points, things=things, skeletons=self.skeletons)


def _save(path, sample):
    """Coordinates as steps of `QUANTUM_M`: half the bytes, far below any noise."""
    steps = np.rint(sample.points / QUANTUM_M).clip(-32767, 32767).astype(np.int16)
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        np.savez(file, points=steps, colors=sample.colors, labels=sample.labels, trees=sample.trees)


def _load(path):
    with np.load(path, allow_pickle=False) as arrays:
        points = arrays["points"].astype(np.float32) * np.float32(QUANTUM_M)
        sample = Sample(points, arrays["colors"], arrays["labels"], arrays["trees"])
    return without_hidden_bark(sample)  # older files have it
