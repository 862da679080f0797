"""Training and held-out clouds from the orchard generator, cached as small arrays."""

import logging
from pathlib import Path

import numpy as np

from cherrypicker.classes import Label
from cherrypicker.files import atomic_path
from cherrypicker.orchard import generate_scene, sample_scene
from cherrypicker.orchard.truth import GENERATOR_VERSION
from cherrypicker.progress import Progress
from cherrypicker.segmentation.augment import Sample

logger = logging.getLogger(__name__)

HELD_OUT_SEED = 900_000  # held-out seeds start here, far from any number of training seeds
MARKER_DICTIONARIES = ("DICT_4X4_50", "DICT_5X5_100", "DICT_6X6_250", "DICT_APRILTAG_36h11")
QUANTUM_M = 0.00025  # resolution of the coordinates in the cache; they reach 8 m


def _things_of(rng):
    """Options of `generate_scene`: what stands about the tree, rare classes often enough."""
    markers = [
        {
            "dictionary": str(rng.choice(MARKER_DICTIONARIES)),
            "id": int(rng.integers(0, 50)),
            "side_m": float(rng.uniform(0.08, 0.30)),
            "pose": str(rng.choice(["lying", "standing"])),
        }
        for _ in range(int(rng.choice([0, 1, 2, 3], p=[0.1, 0.4, 0.3, 0.2])))
    ]
    return {
        "markers": markers,
        "sign": bool(rng.random() < 0.75),
        "cube": bool(rng.random() < 0.45),
        "ring": bool(rng.random() < 0.5),
    }


def make_sample(seed, n_points=250_000, *, habit=None):
    """One labelled cloud "as seen" by a dense reconstruction.

    Half of the trees have the generator's own size, the others are 1.2 to 4.5 m tall.

    Parameters
    ----------
    seed : int
        Decides the scene and its imperfections.
    n_points : int
        Points at most; between a quarter and all of them are drawn.
    habit : str, optional
        As `generate_scene`; drawn from its trained forms by default.

    Returns
    -------
    cherrypicker.segmentation.augment.Sample
        Points float32, colours uint8 (0 to 255), to keep many scenes in memory.
    """
    rng = np.random.default_rng([seed, 77])
    size = {}
    if rng.random() < 0.5 and habit is None:
        height = float(rng.uniform(1.2, 4.5))
        size = {"height": height, "trunk_radius": height * float(rng.uniform(0.011, 0.024))}
    n_points = int(n_points * np.exp(rng.uniform(np.log(0.25), 0.0)))
    scene = generate_scene(seed, habit=habit, **size, **_things_of(rng))
    cloud = sample_scene(
        scene,
        n_points,
        rng=rng,
        extent=float(rng.uniform(1.5, 3.2)),
        ground_share=float(rng.uniform(0.25, 0.5)),
    )
    return Sample(
        cloud.points.astype(np.float32),
        np.rint(cloud.colors * 255).astype(np.uint8),
        cloud["label"],
        cloud["tree"],
    )


def load_samples(seeds, cache, n_points=250_000, *, habits=(None,)):
    """Clouds of many seeds, made once and kept in a folder.

    Parameters
    ----------
    seeds : iterable of int
    cache : str or Path
        Folder of one NPZ a scene, named by the generator's version, the form and the seed.
    n_points : int
        As `make_sample`.
    habits : sequence of str or None
        Forms, taken in turn.

    Returns
    -------
    list of Sample
    """
    folder = Path(cache)
    folder.mkdir(parents=True, exist_ok=True)
    seeds, samples = list(seeds), []
    with Progress(len(seeds), "generated scenes") as bar:
        for number, seed in enumerate(seeds):
            habit = habits[number % len(habits)]
            name = f"scene_v{GENERATOR_VERSION}_{habit or 'any'}_{seed:06d}_{n_points}.npz"
            if not (folder / name).is_file():
                _save(folder / name, make_sample(seed, n_points, habit=habit))
            samples.append(_load(folder / name))
            bar.step()
    shares = np.bincount(np.concatenate([s.labels for s in samples]), minlength=256)
    logger.info(
        "%d scenes, points a class: %s",
        len(samples),
        ", ".join(f"{label.name.lower()} {shares[label]:,}" for label in Label if shares[label]),
    )
    return samples


def _save(path, sample):
    """Coordinates as steps of `QUANTUM_M`: half the bytes, far below any noise."""
    steps = np.rint(sample.points / QUANTUM_M).clip(-32767, 32767).astype(np.int16)
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        np.savez(file, points=steps, colors=sample.colors, labels=sample.labels, trees=sample.trees)


def _load(path):
    with np.load(path, allow_pickle=False) as arrays:
        points = arrays["points"].astype(np.float32) * np.float32(QUANTUM_M)
        return Sample(points, arrays["colors"], arrays["labels"], arrays["trees"])
