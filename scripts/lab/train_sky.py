"""Train the sky network on folders of photos with sky masks.

Reads every images/ or photos/ folder with a masks/ folder beside it (equal stems, 255 = sky) below
the given folders; writes the weights, which ``sky.weights`` takes, and the metrics on the held-out
photos. A checkpoint beside the weights lets a killed run go on. Example:

    python scripts/lab/train_sky.py --folders data/sky --holdout "sky/0001TP*" \\
        --weights results/training/sky/sky_unet.npz --metrics results/training/sky/metrics.json
"""

import fnmatch
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import torch

import lab_path  # noqa: F401
from cherrypicker.errors import StageError
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.training.sky.data import load_photos, split_photos
from cherrypicker_lab.training.sky.training import TrainOptions, save_weights, train_network


def main(
    weights: Annotated[str, "weights to write (NPZ)"],
    metrics: Annotated[str, "metrics to write (JSON)"],
    *,
    folders: tuple[str, ...] = (),
    holdout: tuple[str, ...] = (),
    exclude: tuple[str, ...] = (),
    validation_fraction: float = 0.2,
    options: TrainOptions,
    threads: int = 2,
):
    """Load photos and masks, train, save weights and metrics."""
    if not folders:
        raise StageError("no folder of photos with sky masks is given", key="train_sky.folders")
    torch.set_num_threads(threads)
    photos = load_photos(folders, options.max_side_px)
    photos = [p for p in photos if not any(fnmatch.fnmatch(p.name, e) for e in exclude)]
    training, validation = split_photos(photos, validation_fraction, holdout, options.seed)
    checkpoint = Path(weights).with_name("checkpoint.pt")
    net, history = train_network(training, validation, options, checkpoint)
    save_weights(weights, net)
    settings = {"options": asdict(options), "folders": list(folders)}
    settings |= {"holdout": list(holdout), "exclude": list(exclude)}
    counts = {"n_training": len(training), "n_validation": len(validation)}
    write_json(metrics, {**settings, **counts, **history})
    if len(history["epochs"]) == options.epochs:  # else a run after the time limit goes on from it
        checkpoint.unlink(missing_ok=True)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
