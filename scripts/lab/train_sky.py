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

import torch

import lab_path  # noqa: F401
from cherrypicker.errors import StageError
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker.sky.unet import save_weights
from cherrypicker_lab.training.sky.augment import AugmentOptions
from cherrypicker_lab.training.sky.data import load_photos, split_photos
from cherrypicker_lab.training.sky.training import TrainOptions, train_network


def main(
    folders,
    weights,
    metrics,
    *,
    holdout,
    exclude,
    validation_fraction,
    epochs,
    batch_size,
    learning_rate,
    learning_rate_decay,
    schedule,
    weight_average,
    weight_decay,
    source_power,
    use_bfloat16,
    time_limit_min,
    image_size,
    samples_per_epoch,
    max_side_px,
    elastic_px,
    scale_range,
    branch_fraction,
    exchange_fraction,
    seed,
    threads,
):
    """Load photos and masks, train, save weights and metrics."""
    if not folders:
        raise StageError("no folder of photos with sky masks is given", key="train_sky.folders")
    torch.set_num_threads(threads)
    options = TrainOptions(
        epochs=epochs,
        batch_size=batch_size,
        learning_rate=learning_rate,
        learning_rate_decay=learning_rate_decay,
        schedule=schedule,
        weight_average=weight_average,
        weight_decay=weight_decay,
        source_power=source_power,
        use_bfloat16=bool(use_bfloat16),
        time_limit_min=time_limit_min,
        image_size=image_size,
        samples_per_epoch=samples_per_epoch or None,
        working_side=max_side_px,
        seed=seed,
        augment=AugmentOptions(
            scale_range=tuple(scale_range),
            elastic_px=elastic_px,
            branch_fraction=branch_fraction,
            exchange_fraction=exchange_fraction,
        ),
    )
    photos = load_photos(folders, max_side_px)
    photos = [p for p in photos if not any(fnmatch.fnmatch(p.name, e) for e in exclude)]
    training, validation = split_photos(photos, validation_fraction, holdout, seed)
    checkpoint = Path(weights).with_name("checkpoint.pt")
    net, history = train_network(training, validation, options, checkpoint)
    save_weights(weights, net)
    settings = {"options": asdict(options), "folders": list(folders)}
    settings |= {"holdout": list(holdout), "exclude": list(exclude)}
    counts = {"n_training": len(training), "n_validation": len(validation)}
    write_json(metrics, {**settings, **counts, **history})
    if len(history["epochs"]) == epochs:  # else a run after the time limit goes on from it
        checkpoint.unlink(missing_ok=True)


parser = stage_parser(__doc__)
parser.add_argument("--folders", nargs="+", required=True, help="folders of photos with masks")
parser.add_argument("--weights", required=True, help="weights to write (NPZ)")
parser.add_argument("--metrics", required=True, help="metrics to write (JSON)")
parser.add_argument("--holdout", nargs="*", default=[], help="name patterns to validate on")
parser.add_argument("--exclude", nargs="*", default=[], help="name patterns kept for a test")
parser.add_argument("--validation_fraction", type=float, default=0.2)
parser.add_argument("--epochs", type=int, default=15)
parser.add_argument("--batch_size", type=int, default=3)
parser.add_argument("--learning_rate", type=float, default=1e-5)
parser.add_argument("--learning_rate_decay", type=float, default=0.9)
parser.add_argument("--schedule", default="decay", choices=["decay", "one_cycle"])
parser.add_argument("--weight_average", type=float, default=0.0)
parser.add_argument("--weight_decay", type=float, default=0.0)
parser.add_argument("--source_power", type=float, default=0.5)
parser.add_argument("--use_bfloat16", action="store_true")
parser.add_argument("--time_limit_min", type=float, default=0.0)
parser.add_argument("--image_size", type=int, default=400)
parser.add_argument("--samples_per_epoch", type=int, default=0)
parser.add_argument("--max_side_px", type=int, default=640)
parser.add_argument("--elastic_px", type=float, default=4.0)
parser.add_argument("--scale_range", type=float, nargs=2, default=[0.5, 1.6])
parser.add_argument("--branch_fraction", type=float, default=0.45)
parser.add_argument("--exchange_fraction", type=float, default=0.35)
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--threads", type=int, default=2)
run(main, parser, globals().get("snakemake"))
