"""Training and held-out clouds from the orchard generator, cached as small arrays."""

import logging
from pathlib import Path

import numpy as np

from cherrypicker.classes import Label
from cherrypicker.files import atomic_path
from cherrypicker.orchard import generate_scene, sample_scene
from cherrypicker.progress import Progress
from cherrypicker.segmentation.augment import Sample

logger = logging.getLogger(__name__)

HELD_OUT_SEED = 900_000  # held-out seeds start here, far from any number of training seeds


def make_sample(seed, n_points=250_000):
    """One labelled cloud "as seen" by a dense reconstruction.

    Half of the trees have the generator's own size, the others are 1.2 to 4.5 m tall.

    Parameters
    ----------
    seed : int
        Decides the scene and its imperfections.
    n_points : int

    Returns
    -------
    cherrypicker.segmentation.augment.Sample
        Points float32, colours uint8 (0 to 255), to keep many scenes in memory.
    """
    rng = np.random.default_rng([seed, 77])
    size = {}
    if rng.random() < 0.5:
        height = float(rng.uniform(1.2, 4.5))
        size = {"height": height, "trunk_radius": height * float(rng.uniform(0.011, 0.024))}
    scene = generate_scene(seed, **size)
    has_roof = any(thing.label == Label.ROOF for thing in scene.objects)
    cloud = sample_scene(
        scene,
        2 * n_points if has_roof else n_points,
        rng=rng,
        extent=float(rng.uniform(1.5, 3.2)),
        ground_share=float(rng.uniform(0.25, 0.5)),
    )
    if has_roof:
        # A roof takes most of the points by its area alone and teaches least.
        is_roof = cloud["label"] == Label.ROOF
        keep = 0.25 * (~is_roof).sum() / max(is_roof.sum(), 1)
        cloud = cloud.select(~is_roof | (rng.random(len(cloud)) < keep))
    return Sample(
        cloud.points.astype(np.float32),
        np.rint(cloud.colors * 255).astype(np.uint8),
        cloud["label"],
        cloud["tree"],
    )


def load_samples(seeds, cache, n_points=250_000):
    """Clouds of many seeds, made once and kept in a folder.

    Parameters
    ----------
    seeds : iterable of int
    cache : str or Path
        Folder of ``scene_<seed>_<points>.npz``. Delete it after a change of the generator.
    n_points : int

    Returns
    -------
    list of Sample
    """
    folder = Path(cache)
    folder.mkdir(parents=True, exist_ok=True)
    seeds, samples = list(seeds), []
    with Progress(len(seeds), "training scenes") as bar:
        for seed in seeds:
            path = folder / f"scene_{seed:06d}_{n_points}.npz"
            if not path.is_file():
                sample = make_sample(seed, n_points)
                with atomic_path(path) as temporary, open(temporary, "wb") as file:
                    np.savez(
                        file,
                        points=sample.points,
                        colors=sample.colors,
                        labels=sample.labels,
                        trees=sample.trees,
                    )
            with np.load(path, allow_pickle=False) as arrays:
                samples.append(
                    Sample(*(arrays[n] for n in ("points", "colors", "labels", "trees")))
                )
            bar.step()
    shares = np.bincount(np.concatenate([s.labels for s in samples]), minlength=256)
    logger.info(
        "%d scenes, points a class: %s",
        len(samples),
        ", ".join(f"{label.name.lower()} {shares[label]:,}" for label in Label if shares[label]),
    )
    return samples
