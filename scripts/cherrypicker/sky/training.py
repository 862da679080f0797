"""Training of the sky network (paper, section Denoising).

Binary cross-entropy, Adam with a decaying learning rate, as the paper. The defaults of the config
section ``train_sky`` are the paper's; resources/weights/sky_unet.md says what the shipped weights
were trained with. Every epoch is checkpointed, and equal seeds draw equal samples, also after a
resumed run.
"""

from __future__ import annotations

import hashlib
import json
import logging
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path

import cv2
import numpy as np
import torch
from torch.nn import functional as F

from cherrypicker.errors import StageError
from cherrypicker.files import atomic_path
from cherrypicker.sky.augment import AugmentOptions, draw_sample
from cherrypicker.sky.data import SkyPhoto
from cherrypicker.sky.masks import sky_probability
from cherrypicker.sky.metrics import Confusion
from cherrypicker.sky.unet import DEFAULT_WIDTHS, SkyUNet, to_tensor

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class TrainOptions:
    """Settings of `train_network`; the fields are the config keys of ``train_sky``."""

    epochs: int = 15
    batch_size: int = 3
    learning_rate: float = 1e-5
    learning_rate_decay: float = 0.9
    image_size: int = 400
    samples_per_epoch: int | None = None
    working_side: int = 800
    widths: tuple[int, ...] = DEFAULT_WIDTHS
    seed: int = 0
    augment: AugmentOptions = field(default_factory=AugmentOptions)


def _fingerprint(photos: list[SkyPhoto], options: TrainOptions) -> str:
    """Hash of what makes two trainings the same but for their number of epochs."""
    settings = {k: v for k, v in asdict(options).items() if k != "epochs"}
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True).encode())
    for photo in photos:
        digest.update(photo.name.encode() + np.packbits(photo.sky).tobytes())
    return digest.hexdigest()


def _source_weights(photos: list[SkyPhoto]) -> np.ndarray:
    """Chance of each photo: a source's share grows with the root of its size.

    Hundreds of frames of one drive hold less variety than dozens of single photos.
    """
    sources, counts = np.unique([p.source for p in photos], return_counts=True)
    size = dict(zip(sources.tolist(), counts.tolist()))
    weights = np.array([size[p.source] ** -0.5 for p in photos])
    return weights / weights.sum()


def _batches(photos: list[SkyPhoto], options: TrainOptions, epoch: int):
    """Yield (images, sky, weight) tensors of one epoch; only seed and epoch decide them."""
    n_samples = options.samples_per_epoch or len(photos)
    seeds = np.random.SeedSequence([options.seed, epoch]).spawn(n_samples + 1)
    order = np.random.default_rng(seeds[-1])
    chosen = order.choice(len(photos), size=n_samples, p=_source_weights(photos))
    for start in range(0, n_samples, options.batch_size):
        stop = min(start + options.batch_size, n_samples)
        drawn = [
            draw_sample(
                photos[chosen[i]],
                options.image_size,
                options.augment,
                np.random.default_rng(seeds[i]),
            )
            for i in range(start, stop)
        ]
        images, sky, weight = (np.stack(arrays) for arrays in zip(*drawn))
        yield to_tensor(images), torch.from_numpy(sky), torch.from_numpy(weight)


def _train_epoch(net, optimiser, photos, options: TrainOptions, epoch: int) -> float:
    net.train()
    losses = []
    for images, sky, weight in _batches(photos, options, epoch):
        logits = net(images.contiguous(memory_format=torch.channels_last))[:, 0]
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
    return float(np.mean(losses))


def evaluate(net: SkyUNet, photos: list[SkyPhoto], working_side: int) -> dict:
    """Compare the network's masks with reference masks, over all pixels as they are labelled.

    Returns
    -------
    dict
        `Confusion.summary` over all photos, ``n_photos``, and ``sources`` with the same per source.
    """
    total = Confusion()
    sources: dict[str, Confusion] = {}
    for photo in photos:
        probability = sky_probability(net, photo.image, working_side)
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
    """Train the sky network.

    Parameters
    ----------
    training, validation : lists of SkyPhoto
        See `cherrypicker.sky.data.split_photos`.
    options : TrainOptions
    checkpoint : Path, optional
        Written after every epoch; a run with equal data and settings goes on from there.

    Returns
    -------
    net : SkyUNet
        After the last epoch, in evaluation mode.
    history : dict
        ``epochs``: list of per-epoch numbers, ``validation``: `evaluate` of the last epoch.

    Raises
    ------
    StageError
        When the loss diverges.
    """
    cv2.setNumThreads(1)
    torch.manual_seed(options.seed)
    net = SkyUNet(options.widths).to(memory_format=torch.channels_last)
    optimiser = torch.optim.Adam(net.parameters(), lr=options.learning_rate)
    fingerprint = _fingerprint(training, options)
    epochs: list[dict] = []
    state = _load_checkpoint(checkpoint, fingerprint) if checkpoint else None
    if state is not None:
        net.load_state_dict(state["net"])
        optimiser.load_state_dict(state["optimiser"])
        epochs = json.loads(state["epochs"])
        logger.info("resuming after epoch %d of %d", len(epochs), options.epochs)
    for epoch in range(len(epochs), options.epochs):
        start = time.monotonic()
        rate = options.learning_rate * options.learning_rate_decay**epoch
        for group in optimiser.param_groups:
            group["lr"] = rate
        loss = _train_epoch(net, optimiser, training, options, epoch)
        scores = evaluate(net.eval(), validation, options.working_side)
        epochs.append({"loss": loss, "learning_rate": rate, **scores})
        seconds = time.monotonic() - start
        logger.info(
            "epoch %d of %d: loss %.4f, F1 sky %.3f ground %.3f, soft Dice %.3f, %.0f s left",
            *(epoch + 1, options.epochs, loss, scores["f1_sky"], scores["f1_ground"]),
            *(scores["dice_soft"], seconds * (options.epochs - epoch - 1)),
            extra={"console": True},
        )
        if checkpoint:
            _save_checkpoint(checkpoint, net, optimiser, epochs, fingerprint)
    return net.eval(), {"epochs": epochs, "validation": epochs[-1]}


def _save_checkpoint(path: Path, net, optimiser, epochs: list[dict], fingerprint: str) -> None:
    state = {
        "net": net.state_dict(),
        "optimiser": optimiser.state_dict(),
        "epochs": json.dumps(epochs),
        "fingerprint": fingerprint,
    }
    with atomic_path(path) as tmp:
        torch.save(state, tmp)
