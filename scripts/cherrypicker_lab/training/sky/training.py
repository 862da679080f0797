"""Training of the sky network (paper, section Denoising).

Binary cross-entropy, Adam with a decaying learning rate, as the paper; or, for few epochs from
scratch, one cycle of the learning rate [1]_ and a running mean of the weights. The defaults of the
config section ``train_sky`` are the paper's; resources/weights/sky_unet.md says what the shipped
weights were trained with. Every epoch is checkpointed, and equal seeds draw equal samples, also
after a resumed run.

References
----------
.. [1] Smith, Topin, "Super-Convergence: Very Fast Training of Neural Networks Using Large Learning
   Rates", arXiv:1708.07120.
.. [2] Wortsman et al., "Robust fine-tuning of zero-shot models", CVPR 2022.
"""

from __future__ import annotations

import copy
import hashlib
import json
import logging
import math
import os
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from torch.nn import functional as F

from cherrypicker.errors import StageError
from cherrypicker.files import atomic_path
from cherrypicker.sky.masks import sky_probability
from cherrypicker.sky.sizes import reduce_photo
from cherrypicker.sky.unet import SkyUNet, load_weights, to_tensor
from cherrypicker_lab.training.sky.augment import AugmentOptions, draw_sample
from cherrypicker_lab.training.sky.data import SkyPhoto
from cherrypicker_lab.training.sky.metrics import Confusion

logger = logging.getLogger(__name__)

#: Share of the steps in which one cycle's learning rate rises, and what it starts from.
WARM_UP, FIRST_RATE = 0.05, 0.1


@dataclass(frozen=True)
class TrainOptions(AugmentOptions):
    """Settings of `train_network`; the fields are config keys of ``train_sky``."""

    epochs: int = 15
    batch_size: int = 3
    learning_rate: float = 2e-3
    learning_rate_decay: float = 0.9
    schedule: str = "decay"
    weight_average: float = 0.0
    weight_decay: float = 0.0
    source_power: float = 0.5
    use_bfloat16: bool = False
    time_limit_min: float = 0.0
    image_size_px: int = 400
    samples_per_epoch: int = 0
    max_side_px: int = 640
    widths: tuple[int, ...] = (8, 16, 32, 64, 96, 128)
    start_weights: str = ""
    start_share: float = 0.0
    seed: int = 0


def _fingerprint(photos: list[SkyPhoto], options: TrainOptions) -> str:
    """Hash of what makes two trainings the same but for their length."""
    free = ("epochs", "time_limit_min")
    settings = {k: v for k, v in asdict(options).items() if k not in free}
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True).encode())
    for photo in photos:
        digest.update(photo.name.encode() + np.packbits(photo.sky).tobytes())
    return digest.hexdigest()


def _batches(photos: list[SkyPhoto], options: TrainOptions, epoch: int):
    """Yield (images, sky, weight) tensors of one epoch; only seed and epoch decide them."""
    n_samples = options.samples_per_epoch or len(photos)
    seeds = np.random.SeedSequence([options.seed, epoch]).spawn(n_samples + 1)
    order = np.random.default_rng(seeds[-1])
    # Hundreds of frames of one drive hold less variety than dozens of single photos
    sources, counts = np.unique([p.source for p in photos], return_counts=True)
    size = dict(zip(sources.tolist(), counts.tolist()))
    weights = np.array([size[p.source] ** (options.source_power - 1.0) for p in photos])
    chosen = order.choice(len(photos), size=n_samples, p=weights / weights.sum())
    for start in range(0, n_samples, options.batch_size):
        stop = min(start + options.batch_size, n_samples)
        chances = [np.random.default_rng(seeds[i]) for i in range(start, stop)]
        drawn = [
            draw_sample(photos[i], options.image_size_px, options, chance)
            for i, chance in zip(chosen[start:stop], chances)
        ]
        images, sky, weight = (np.stack(arrays) for arrays in zip(*drawn))
        yield to_tensor(images), torch.from_numpy(sky), torch.from_numpy(weight)


def _rate(options: TrainOptions, epoch: int, done: float) -> float:
    """Learning rate when the share ``done`` of an epoch, counted from 0, is over."""
    if options.schedule == "decay":
        return options.learning_rate * options.learning_rate_decay**epoch
    progress = (epoch + done) / options.epochs
    if progress < WARM_UP:
        return options.learning_rate * (FIRST_RATE + (1 - FIRST_RATE) * progress / WARM_UP)
    along = (progress - WARM_UP) / (1 - WARM_UP)
    return options.learning_rate * 0.5 * (1 + math.cos(math.pi * along))


@torch.no_grad()
def _move_average(average, net, share: float) -> None:
    """Keep ``share`` of the averaged network and take the rest from ``net``, statistics too."""
    for kept, new in zip(average.state_dict().values(), net.state_dict().values()):
        if kept.is_floating_point():
            kept.lerp_(new, 1.0 - share)
        else:
            kept.copy_(new)


def _train_epoch(state, photos, options: TrainOptions, epoch: int) -> float:
    net, average, optimiser = state
    net.train()
    losses = []
    n_steps = -(-(options.samples_per_epoch or len(photos)) // options.batch_size)
    for step, (images, sky, weight) in enumerate(_batches(photos, options, epoch)):
        for group in optimiser.param_groups:
            group["lr"] = _rate(options, epoch, step / n_steps)
        with torch.autocast("cpu", torch.bfloat16, enabled=options.use_bfloat16):
            logits = net(images.contiguous(memory_format=torch.channels_last))[:, 0].float()
        loss = F.binary_cross_entropy_with_logits(logits, sky, weight=weight, reduction="sum")
        loss = loss / weight.sum().clamp(min=1.0)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
        if not np.isfinite(losses[-1]):
            raise StageError(
                f"the loss is {losses[-1]} in epoch {epoch + 1}", key="train_sky.learning_rate"
            )
        if average is not net:
            # Few steps in, a running mean would still hold the random weights of the start.
            age = epoch * n_steps + step
            _move_average(average, net, min(options.weight_average, (1 + age) / (10 + age)))
    return float(np.mean(losses))


def evaluate(net: SkyUNet, photos: list[SkyPhoto], working_side: int) -> dict:
    """Compare the network's masks with reference masks, over all pixels as they are labelled.

    Returns `Confusion.summary` over all photos, ``n_photos``, and ``sources`` with the same per
    source.
    """
    total = Confusion()
    sources: dict[str, Confusion] = {}
    for photo in photos:
        probability = sky_probability(net, reduce_photo(photo.image, working_side))
        if probability.shape != photo.sky.shape:
            size = photo.sky.shape[::-1]
            probability = cv2.resize(probability, size, interpolation=cv2.INTER_LINEAR)
        for confusion in (total, sources.setdefault(photo.source, Confusion())):
            confusion.add(probability, photo.sky)
    parts = {name: c.summary() for name, c in sorted(sources.items())}
    return {"n_photos": len(photos), **total.summary(), "sources": parts}


def _load_checkpoint(path: Path, fingerprint: str) -> dict | None:
    if not path.is_file():
        return None
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch's unpickler raises what it pleases on a broken file
        logger.warning("checkpoint %s is unreadable (%s): starting afresh", path, error)
        return None
    if state.get("fingerprint") != fingerprint:
        logger.info("checkpoint %s belongs to other data or settings: starting afresh", path)
        return None
    return state


def train_network(
    training: list[SkyPhoto],
    validation: list[SkyPhoto],
    options: TrainOptions,
    checkpoint: Path | None = None,
) -> tuple[SkyUNet, dict]:
    """Train the sky network on one side of `split_photos`, measured on the other.

    The checkpoint is written after every epoch; a run with equal data and settings goes on from
    there. Returns the network after the last epoch, or the mean of the weights, in evaluation mode,
    and a history: ``epochs``, a list of per-epoch numbers, and ``validation``, `evaluate` of the
    last epoch. Raises a `StageError` when the loss diverges.
    """
    cv2.setNumThreads(1)
    torch.manual_seed(options.seed)
    net = load_weights(start) if (start := options.start_weights) else SkyUNet(options.widths)
    net = net.to(memory_format=torch.channels_last)
    average = copy.deepcopy(net) if options.weight_average > 0 else net
    rate, decay = options.learning_rate, options.weight_decay
    optimiser = torch.optim.AdamW(net.parameters(), lr=rate, weight_decay=decay)
    fingerprint = _fingerprint(training, options)
    epochs: list[dict] = []
    state = _load_checkpoint(checkpoint, fingerprint) if checkpoint else None
    if state is not None:
        net.load_state_dict(state["net"])
        average.load_state_dict(state["average"])
        optimiser.load_state_dict(state["optimiser"])
        epochs = json.loads(state["epochs"])
        logger.info("resuming after epoch %d of %d", len(epochs), options.epochs)
    begin = time.monotonic()
    for epoch in range(len(epochs), options.epochs):
        start = time.monotonic()
        if options.time_limit_min and epochs and start - begin > 60 * options.time_limit_min:
            logger.warning("the time limit ends the training after epoch %d", epoch)
            break
        loss = _train_epoch((net, average, optimiser), training, options, epoch)
        scores = evaluate(average.eval(), validation, options.max_side_px)
        epochs.append({"loss": loss, "learning_rate": _rate(options, epoch, 0.0), **scores})
        seconds = time.monotonic() - start
        logger.info(
            "epoch %d of %d: loss %.4f, F1 sky %.3f ground %.3f, soft Dice %.3f, %.0f s left",
            *(epoch + 1, options.epochs, loss, scores["f1_sky"], scores["f1_ground"]),
            *(scores["dice_soft"], seconds * (options.epochs - epoch - 1)),
            extra={"console": True},
        )
        if checkpoint:
            parts = {"net": net, "average": average, "optimiser": optimiser}
            state = {name: part.state_dict() for name, part in parts.items()}
            state |= {"epochs": json.dumps(epochs), "fingerprint": fingerprint}
            with atomic_path(checkpoint) as tmp:
                torch.save(state, tmp)
    if options.start_weights and options.start_share > 0:
        # What the first weights knew and the new photos do not show stays known [2]_.
        _move_average(average, load_weights(options.start_weights), 1 - options.start_share)
    return average.eval(), {"epochs": epochs, "validation": epochs[-1]}


def save_weights(path: str | os.PathLike, net: SkyUNet) -> None:
    """Write a network as half-precision NPZ (no pickle; equal weights give equal bytes)."""
    arrays = {f"p:{k}": v.detach().cpu().numpy() for k, v in net.state_dict().items()}
    arrays = {k: v.astype(np.float16) if v.dtype == np.float32 else v for k, v in arrays.items()}
    with atomic_path(path) as tmp, open(tmp, "wb") as handle:
        np.savez(handle, widths=np.array(net.widths, dtype=np.int32), **arrays)
