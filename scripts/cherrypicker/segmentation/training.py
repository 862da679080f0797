"""Training of the network on labelled clouds, resumable epoch by epoch.

Paper: Adam from 0.003 with a decaying rate, negative log-likelihood, 35 epochs, batches of 16
spheres. Each epoch sees every cloud under a new random augmentation, cut at random spheres whose
centres are drawn so that rare classes come up as often as the ground.
"""

import logging
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree

from cherrypicker.classes import Label
from cherrypicker.errors import StageError
from cherrypicker.files import atomic_path
from cherrypicker.progress import Progress
from cherrypicker.segmentation.augment import augment
from cherrypicker.segmentation.dgcnn import N_CLASSES, Dgcnn, collate, load_weights
from cherrypicker.segmentation.inference import predict_spheres
from cherrypicker.segmentation.metrics import confusion_matrix, score_table, scores
from cherrypicker.segmentation.refine import clean_trunk, smooth_probabilities
from cherrypicker.segmentation.spheres import (
    features_of,
    neighbor_graphs,
    sphere_indices,
    tree_frame,
    voxel_majority,
    voxel_mean,
    voxel_sample,
)

logger = logging.getLogger(__name__)

IGNORED = -100  # nll_loss leaves these points out
# Chance of a class to give a sphere's centre: the rare classes as often as the wood.
CENTER_WEIGHTS = np.array([0.8, 1.0, 1.2, 1.2, 1.4, 1.4, 0.6])
BORDER_SHARE = 0.25  # weight of trunk against branch, whose border the stem's course decides


@dataclass(frozen=True)
class Schedule:
    """Course of a training.

    Attributes
    ----------
    epochs : int
    batch_spheres : int
    spheres_per_cloud : int
        Spheres cut from each cloud in an epoch.
    learning_rate, final_learning_rate : float
        Adam's rate at the start and the end; it decays by an equal factor each step.
    color_dropout : float
        Share of the clouds shown without colour.
    seed : int
    minutes : float or None
        Stop after this time, with the rate falling over it rather than over the epochs; for a
        machine whose load is not known beforehand. Two such runs differ.
    """

    epochs: int = 35
    batch_spheres: int = 16
    spheres_per_cloud: int = 8
    learning_rate: float = 0.003
    final_learning_rate: float = 3e-5
    color_dropout: float = 0.25
    seed: int = 0
    minutes: float | None = None


def network_labels(labels):
    """Training targets (n,) int64: the post counts as trunk (paper), the unlabelled is ignored."""
    targets = np.asarray(labels).astype(np.int64)
    targets[targets == Label.SUPPORT_POST] = int(Label.TRUNK)
    targets[targets >= N_CLASSES] = IGNORED
    return targets


def cut_spheres(sample, sampling, n_spheres, k, n_scales, rng):
    """Random spheres of one (augmented) cloud, ready for `collate`.

    Parameters
    ----------
    sample : cherrypicker.segmentation.augment.Sample
    sampling : Sampling
    n_spheres : int
    k, n_scales : int
        Of the network's graphs.
    rng : numpy.random.Generator

    Returns
    -------
    list of (features, graphs, targets)
    """
    frame = tree_frame(sample.points, sampling.reference_height_m)
    points, inverse, counts = voxel_sample(frame.apply(sample.points), sampling.voxel_size_m)
    targets = network_labels(voxel_majority(sample.labels, inverse, len(counts)))
    colors = None if sample.colors is None else voxel_mean(sample.colors, inverse, counts)
    # The frame's origin is an estimate; the network must not lean on its exact place.
    points = points + rng.normal(0.0, [0.3, 0.3, 0.03])
    present = np.array([(targets == c).any() for c in range(N_CLASSES)])
    if not present.any():
        return []
    weights = CENTER_WEIGHTS * present
    tree = cKDTree(points)
    spheres = []
    for c in rng.choice(N_CLASSES, size=n_spheres, p=weights / weights.sum()):
        pool = np.flatnonzero(targets == c)
        center = points[pool[rng.integers(len(pool))]]
        center = center + rng.normal(0.0, 0.2 * sampling.sphere_radius_m, 3)
        indices = sphere_indices(
            tree, center, sampling.sphere_radius_m, sampling.sphere_points, rng
        )
        if len(indices) < 2 * k:
            continue
        part_colors = None if colors is None else colors[indices]
        features = features_of(points[indices], part_colors, center, sampling.sphere_radius_m)
        graphs = neighbor_graphs(points[indices], k, n_scales)
        spheres.append((features, graphs, targets[indices]))
    return spheres


def class_weights(samples):
    """Loss weights (7,): inverse root of the class frequencies, within a factor of 5 of 1."""
    counts = np.zeros(N_CLASSES)
    for sample in samples:
        targets = network_labels(sample.labels)
        counts += np.bincount(targets[targets >= 0], minlength=N_CLASSES)
    share = counts / counts.sum()
    weights = np.sqrt(share[counts > 0].mean() / np.where(counts > 0, share, 1.0))
    return torch.tensor(np.where(counts > 0, weights, 1.0).clip(0.2, 5.0), dtype=torch.float32)


def wood_loss(output, targets, weights):
    """Negative log-likelihood with trunk and branch as one class, plus a share of it with two.

    Where the trunk ends is decided by the stem's course (`stem_axis`); that something is wood,
    only the network can tell.

    Parameters
    ----------
    output : Tensor of shape (n, 7)
        Log-probabilities.
    targets : Tensor of shape (n,), int64
        `IGNORED` rows do not count.
    weights : Tensor of shape (7,)
        Loss weights of the classes.

    Returns
    -------
    Tensor
        A scalar.
    """
    trunk, branch = int(Label.TRUNK), int(Label.BRANCH)
    wood = torch.logaddexp(output[:, trunk], output[:, branch])
    joined = output.clone()
    joined[:, trunk], joined[:, branch] = wood, wood
    nll = torch.nn.functional.nll_loss
    apart = nll(output, targets, weights, ignore_index=IGNORED)
    together = nll(joined, targets, weights, ignore_index=IGNORED)
    return (1 - BORDER_SHARE) * together + BORDER_SHARE * apart


def _batches(samples, network, sampling, schedule, epoch):
    """Batches of one epoch; the order and every draw follow from the seed and the epoch."""
    rng = np.random.default_rng([schedule.seed, epoch])
    k, n_scales = network.settings["k"], max(network.settings["scales"]) + 1
    waiting = []
    # Spheres of several clouds wait together, so that a batch mixes clouds and augmentations.
    reserve = 4 * schedule.batch_spheres
    for i in rng.permutation(len(samples)):
        changed = augment(samples[i], rng, schedule.color_dropout)
        waiting += cut_spheres(changed, sampling, schedule.spheres_per_cloud, k, n_scales, rng)
        while len(waiting) >= reserve:
            order = rng.permutation(len(waiting))
            chosen = order[: schedule.batch_spheres]
            yield [waiting[j] for j in chosen]
            waiting = [waiting[j] for j in order[schedule.batch_spheres :]]
    while len(waiting) >= schedule.batch_spheres:
        yield waiting[: schedule.batch_spheres]
        waiting = waiting[schedule.batch_spheres :]


def _train_epoch(network, optimizer, samples, sampling, schedule, epoch, weights, device, began):
    torch.manual_seed(schedule.seed * 100_003 + epoch)
    network.train()
    n_batches = max(1, len(samples) * schedule.spheres_per_cloud // schedule.batch_spheres)
    loss_sum = hit_sum = n_sum = 0.0
    for step, batch in enumerate(_batches(samples, network, sampling, schedule, epoch)):
        progress = (epoch + min(step / n_batches, 1.0)) / schedule.epochs
        if schedule.minutes is not None:
            progress = (time.monotonic() - began) / (60 * schedule.minutes)
            if progress >= 1 and n_sum:
                break
        decay = schedule.final_learning_rate / schedule.learning_rate
        for group in optimizer.param_groups:
            group["lr"] = schedule.learning_rate * decay ** min(progress, 1.0)
        features, graphs, sizes = collate([(f, g) for f, g, _ in batch])
        targets = torch.from_numpy(np.concatenate([t for _, _, t in batch])).to(device)
        graphs = [g if device == "cpu" else g.long().to(device) for g in graphs]
        output = network(features.to(device), graphs, sizes)
        loss = wood_loss(output, targets, weights)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        known = targets >= 0
        n_known = float(known.sum())
        loss_sum += float(loss.detach()) * n_known
        hit_sum += float((output.argmax(dim=1) == targets)[known].sum())
        n_sum += n_known
    if n_sum == 0:
        raise StageError(
            "an epoch gave no full batch of spheres",
            key="train_segment.n_scenes or train_segment.batch_spheres",
        )
    return loss_sum / n_sum, hit_sum / n_sum


def evaluate(network, samples, sampling, smoothing, *, seed=0, use_color=True, device="cpu"):
    """Measures on whole clouds, after the clean-up and before the post is split off.

    Parameters
    ----------
    network : Dgcnn
    samples : list of cherrypicker.segmentation.augment.Sample
    sampling : Sampling
    smoothing : Smoothing
    seed : int
    use_color : bool
        False measures on the same clouds without colour.
    device : str

    Returns
    -------
    dict
        As `cherrypicker.segmentation.metrics.scores`, on the sampled points.
    """
    network.eval()
    total = np.zeros((N_CLASSES, N_CLASSES), np.int64)
    for sample in (sample.as_float() for sample in samples):
        frame = tree_frame(sample.points, sampling.reference_height_m)
        points, inverse, counts = voxel_sample(frame.apply(sample.points), sampling.voxel_size_m)
        targets = network_labels(voxel_majority(sample.labels, inverse, len(counts)))
        colors = None
        if use_color and sample.colors is not None:
            colors = voxel_mean(sample.colors, inverse, counts)
        result = predict_spheres(network, points, colors, sampling, seed=seed, device=device)
        result = clean_trunk(points, smooth_probabilities(points, result, smoothing), smoothing)
        total += confusion_matrix(targets, result.argmax(axis=1), N_CLASSES)
    return scores(total)


def _load_checkpoint(path, settings):
    """Content of a checkpoint of the same training, else None."""
    if not Path(path).is_file():
        return None
    content = torch.load(path, map_location="cpu", weights_only=True)
    if content["settings"] != settings:
        logger.info("the checkpoint belongs to another training; starting over")
        return None
    return content


def train(
    samples, *, schedule, sampling, checkpoint, network_settings=None, start=None, device="cpu"
):
    """Train a network, going on from the checkpoint where there is one of the same settings.

    Parameters
    ----------
    samples : list of cherrypicker.segmentation.augment.Sample
    schedule : Schedule
    sampling : Sampling
    checkpoint : str or Path
        Written after every epoch.
    network_settings : dict, optional
        Arguments of `Dgcnn`.
    start : str or Path, optional
        Weights to go on from, of a network of its own settings.
    device : str

    Returns
    -------
    network : Dgcnn
    history : list of dict
        ``epoch``, ``loss``, ``accuracy`` (on the augmented training spheres), ``seconds`` so far
        (0 without a time limit).

    Raises
    ------
    StageError
        There is nothing to train on.
    """
    if not samples:
        raise StageError("there are no training clouds", key="train_segment.n_scenes")
    torch.manual_seed(schedule.seed)
    network = load_weights(start)[0] if start else Dgcnn(**(network_settings or {}))
    network = network.to(device)
    optimizer = torch.optim.Adam(network.parameters(), lr=schedule.learning_rate)
    settings = {
        "network": network.settings,
        "schedule": asdict(schedule),
        "sampling": asdict(sampling),
        "n_samples": len(samples),
    }
    history = []
    content = _load_checkpoint(checkpoint, settings)
    if content is not None:
        network.load_state_dict(content["network"])
        optimizer.load_state_dict(content["optimizer"])
        history = content["history"]
        logger.info("going on after epoch %d of %d", len(history), schedule.epochs)
    weights = class_weights(samples).to(device)
    began = time.monotonic() - (history[-1]["seconds"] if history else 0.0)
    with Progress(schedule.epochs, "epochs") as bar:
        bar.step(len(history))
        for epoch in range(len(history), schedule.epochs):
            loss, accuracy = _train_epoch(
                network, optimizer, samples, sampling, schedule, epoch, weights, device, began
            )
            seconds = time.monotonic() - began if schedule.minutes is not None else 0.0
            history.append(
                {"epoch": epoch + 1, "loss": loss, "accuracy": accuracy, "seconds": seconds}
            )
            logger.info("epoch %d: loss %.4f, accuracy %.3f", epoch + 1, loss, accuracy)
            with atomic_path(checkpoint) as temporary:
                torch.save(
                    {
                        "settings": settings,
                        "network": network.state_dict(),
                        "optimizer": optimizer.state_dict(),
                        "history": history,
                    },
                    temporary,
                )
            bar.step()
            if schedule.minutes is not None and seconds >= 60 * schedule.minutes:
                break
    return network.cpu().eval(), history


def measure(network, held_out, sampling, smoothing, *, device="cpu"):
    """Held-out measures with and without colour, logged as tables.

    Returns
    -------
    dict
        ``color`` and ``no_color``, each as `evaluate`.
    """
    result = {}
    for name, use_color in (("color", True), ("no_color", False)):
        result[name] = evaluate(
            network, held_out, sampling, smoothing, use_color=use_color, device=device
        )
        logger.info(
            "held out (%s): mean IoU %.3f\n%s",
            name,
            result[name]["mean_iou"],
            score_table(result[name]),
        )
    return result
