"""Training of the network on labelled clouds, resumable epoch by epoch.

Paper: Adam from 0.003 with a decaying rate, negative log-likelihood, 35 epochs, batches of 16
spheres. Each epoch sees every cloud under a new random augmentation, cut at random spheres whose
centres are drawn so that rare classes come up as often as the ground.
"""

import logging
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from cherrypicker.classes import CHANNELS, WOOD, Label
from cherrypicker.errors import StageError
from cherrypicker.files import atomic_path
from cherrypicker.geometry.sampling import majority_label, voxel_mean, voxel_sample
from cherrypicker.progress import Progress
from cherrypicker.segmentation.dgcnn import N_CLASSES, Dgcnn, collate, load_weights
from cherrypicker.segmentation.inference import predict_spheres, smooth_probabilities
from cherrypicker.segmentation.spheres import (
    features_of,
    in_tree_frame,
    neighbor_graphs,
    sphere_indices,
)
from cherrypicker_lab.training.segmentation.augment import augment
from cherrypicker_lab.training.segmentation.metrics import confusion_matrix, score_table, scores
from cherrypicker_lab.training.segmentation.random_props import NO_WOOD
from cherrypicker_lab.training.segmentation.scenes import FreshScenes

logger = logging.getLogger(__name__)

IGNORED = -100  # nll_loss leaves these points out
STRAY = -1  # target of things of no class (`NO_WOOD`), of which only that is known
# Chance of a class to give a sphere's centre: the rare classes as often as the wood.
_CENTER_WEIGHT = {
    Label.GROUND: 0.8,
    Label.BRANCH: 1.2,
    Label.SIGN: 1.2,
    Label.MARKER: 1.4,
    Label.CALIBRATION_UNIT: 1.4,
    Label.ROOF: 0.6,
}
CENTER_WEIGHTS = np.array([_CENTER_WEIGHT.get(label, 1.0) for label in CHANNELS])
BORDER_SHARE = 0.25  # weight of trunk against branch, whose border the stem's course decides


def network_labels(labels):
    """Training targets (n,) int64: channels, the unlabelled is ignored."""
    targets = np.full(256, IGNORED, dtype=np.int64)
    targets[NO_WOOD] = STRAY
    for label in Label:
        targets[label] = IGNORED if label.channel is None else label.channel
    return targets[np.asarray(labels)]


def _sampled(sample, sampling):
    """Points of a voxel each in the network's frame, their targets, their colours or None."""
    local, _ = in_tree_frame(sample.points, sampling.reference_height_m)
    points, inverse, counts = voxel_sample(local, sampling.voxel_size_m)
    targets = network_labels(majority_label(sample.labels, inverse, len(counts)))
    colors = None if sample.colors is None else voxel_mean(sample.colors, inverse, counts)
    return points, targets, colors


def cut_spheres(sample, sampling, n_spheres, k, n_scales, rng):
    """Random spheres (features, graphs, targets) of one (augmented) cloud, ready for `collate`.

    `k` and `n_scales` are those of the network's graphs.
    """
    points, targets, colors = _sampled(sample, sampling)
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


def class_weights(samples, power=0.5):
    """Loss weights (n_classes,): inverse power of the frequencies, within a factor of 5 of 1."""
    counts = np.zeros(N_CLASSES)
    for sample in samples:
        targets = network_labels(sample.labels)
        counts += np.bincount(targets[targets >= 0], minlength=N_CLASSES)
    share = counts / counts.sum()
    weights = (share[counts > 0].mean() / np.where(counts > 0, share, 1.0)) ** power
    return torch.tensor(np.where(counts > 0, weights, 1.0).clip(0.2, 5.0), dtype=torch.float32)


def wood_loss(output, targets, weights):
    """Negative log-likelihood with trunk and branch as one class, plus a share of it with two.

    Where the trunk ends is decided by the limbs (`segmentation.stems`); that something is wood,
    only the network can tell. Of things of no class the likelihood is that of not being wood.

    The output (n, n_classes) has log-probabilities; of the targets (n,) int64 `IGNORED` rows do not
    count, and `STRAY` ones are no wood. The classes have weights (n_classes,). Returns a scalar.
    """
    trunk, branch = (label.channel for label in WOOD)
    wood = torch.logaddexp(output[:, trunk], output[:, branch])
    joined = output.clone()
    joined[:, trunk], joined[:, branch] = wood, wood
    nll = torch.nn.functional.nll_loss
    stray = targets == STRAY
    no_wood = torch.log1p(-wood[stray].exp().clamp(max=1 - 1e-6))
    targets = targets.masked_fill(stray, IGNORED)
    apart = nll(output, targets, weights, ignore_index=IGNORED)
    together = nll(joined, targets, weights, ignore_index=IGNORED)
    return (1 - BORDER_SHARE) * together + BORDER_SHARE * apart - no_wood.sum() / len(targets)


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


class _Run:
    """The changing parts of a training: network, optimiser, running mean, batches so far."""

    def __init__(self, network, schedule, device):
        self.network = network.to(device)
        self.optimizer = torch.optim.Adam(network.parameters(), lr=schedule.learning_rate)
        self.average = None
        if schedule.average:
            decay = get_ema_multi_avg_fn(schedule.average)
            self.average = AveragedModel(network, multi_avg_fn=decay, use_buffers=True)
        self.n_batches = 0
        self.history = []

    def step(self, batch, weights, rate, device):
        """One batch; returns its loss, its right answers and its known points."""
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        features, graphs, sizes = collate([(f, g) for f, g, _ in batch])
        targets = torch.from_numpy(np.concatenate([t for _, _, t in batch])).to(device)
        graphs = [graph.to(device) for graph in graphs]
        output = self.network(features.to(device), graphs, sizes)
        loss = wood_loss(output, targets, weights)
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        if self.average is not None:
            self.average.update_parameters(self.network)
        self.n_batches += 1
        known = targets >= 0
        hits = float((output.argmax(dim=1) == targets)[known].sum())
        return float(loss.detach()), hits, float(known.sum())

    def state(self):
        """All of it, to go on from."""
        return {
            "network": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "average": self.average.state_dict() if self.average is not None else {},
            "n_batches": self.n_batches,
            "history": self.history,
        }

    def restore(self, content):
        """Go on from what `state` gave."""
        self.network.load_state_dict(content["network"])
        self.optimizer.load_state_dict(content["optimizer"])
        if self.average is not None:
            self.average.load_state_dict(content["average"])
        self.n_batches, self.history = content["n_batches"], content["history"]

    def kept(self):
        """The network to keep, on the CPU, in evaluation mode."""
        network = self.network if self.average is None else self.average.module
        return network.cpu().eval()


def _train_epoch(run, samples, sampling, schedule, epoch, weights, device, began):
    torch.manual_seed(schedule.seed * 100_003 + epoch)
    run.network.train()
    n_batches = max(1, len(samples) * schedule.spheres_per_cloud // schedule.batch_spheres)
    loss_sum = hit_sum = n_sum = 0.0
    for step, batch in enumerate(_batches(samples, run.network, sampling, schedule, epoch)):
        progress = (epoch + min(step / n_batches, 1.0)) / schedule.epochs
        if schedule.minutes is not None:
            progress = (time.monotonic() - began) / (60 * schedule.minutes)
            if progress >= 1 and n_sum:
                break
        rate = schedule.rate(progress, run.n_batches)
        loss, hits, n_known = run.step(batch, weights, rate, device)
        loss_sum += loss * n_known
        hit_sum += hits
        n_sum += n_known
    if n_sum == 0:
        raise StageError(
            "an epoch gave no full batch of spheres",
            key="train_segment.n_scenes or train_segment.batch_spheres",
        )
    return loss_sum / n_sum, hit_sum / n_sum


def evaluate(network, samples, sampling, *, use_color=True, device="cpu"):
    """Measures on whole clouds, after the clean-up and before the post is split off.

    They are those of `metrics.scores`, on the sampled points; without `use_color`, on the same
    clouds without colour.
    """
    network.eval()
    total = np.zeros((N_CLASSES, N_CLASSES), np.int64)
    for sample in (sample.as_float() for sample in samples):
        points, targets, colors = _sampled(sample, sampling)
        shown = colors if use_color else None
        result = predict_spheres(network, points, shown, sampling, seed=0, device=device)
        result = smooth_probabilities(points, result, sampling.smooth_k)
        total += confusion_matrix(targets, result.argmax(axis=1))
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

    The checkpoint is written after every epoch. `network_settings` are arguments of `Dgcnn`;
    `start` are weights to go on from, of a network of its own settings.

    Returns the network and a history: of each epoch ``epoch``, ``loss``, ``accuracy`` (on the
    augmented training spheres), ``seconds`` so far (0 without a time limit), ``n_scenes``,
    ``n_batches`` so far. Raises a `StageError` if there is nothing to train on.
    """
    if not len(samples):
        raise StageError("there are no training clouds", key="train_segment.n_scenes")
    torch.manual_seed(schedule.seed)
    if start:
        network = load_weights(start)[0]
    else:
        network = Dgcnn(**(network_settings or {}))
    run = _Run(network, schedule, device)
    settings = {
        "network": network.settings,
        "schedule": asdict(schedule),
        "sampling": asdict(sampling),
        "n_samples": len(samples),
    }
    content = _load_checkpoint(checkpoint, settings)
    if content is not None:
        run.restore(content)
        logger.info("going on after epoch %d of %d", len(run.history), schedule.epochs)
    weights = class_weights(samples, schedule.class_balance).to(device)
    began = time.monotonic() - (run.history[-1]["seconds"] if run.history else 0.0)
    with Progress(schedule.epochs, "epochs") as bar:
        bar.step(len(run.history))
        for epoch in range(len(run.history), schedule.epochs):
            if isinstance(samples, FreshScenes):
                samples.begin(epoch)
            loss, accuracy = _train_epoch(
                run, samples, sampling, schedule, epoch, weights, device, began
            )
            seconds = time.monotonic() - began if schedule.minutes is not None else 0.0
            entry = {"epoch": epoch + 1, "loss": loss, "accuracy": accuracy, "seconds": seconds}
            run.history.append(entry | {"n_scenes": len(samples), "n_batches": run.n_batches})
            logger.info(
                "epoch %d, %d scenes, %d batches: loss %.4f, accuracy %.3f",
                epoch + 1, len(samples), run.n_batches, loss, accuracy,
            )  # fmt: skip
            with atomic_path(checkpoint) as temporary:
                torch.save({"settings": settings} | run.state(), temporary)
            bar.step()
            if schedule.minutes is not None and seconds >= 60 * schedule.minutes:
                break
    return run.kept(), run.history


def measure(network, held_out, sampling, *, device="cpu"):
    """Held-out measures with and without colour, logged as tables.

    They are those of `evaluate`, by ``color`` and ``no_color``.
    """
    result = {}
    for name, use_color in (("color", True), ("no_color", False)):
        result[name] = evaluate(network, held_out, sampling, use_color=use_color, device=device)
        said = "held out (%s): mean IoU %.3f\n%s"
        logger.info(said, name, result[name]["mean_iou"], score_table(result[name]))
    return result
