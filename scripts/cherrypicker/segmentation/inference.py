"""Labels for every point of a metric cloud."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree

from cherrypicker.classes import CHANNELS, CLASS_NAMES, WOOD, wood_mask
from cherrypicker.errors import StageError
from cherrypicker.geometry.sampling import voxel_mean, voxel_sample
from cherrypicker.pointcloud import PointCloud
from cherrypicker.progress import Progress
from cherrypicker.segmentation.dgcnn import N_CLASSES, Dgcnn, collate, load_weights
from cherrypicker.segmentation.refine import (
    Smoothing,
    clean_trunk,
    keep_sheets,
    smooth_probabilities,
)
from cherrypicker.segmentation.spheres import (
    TreeFrame,
    cover,
    features_of,
    neighbor_graphs,
    tree_frame,
)
from cherrypicker.segmentation.standing_posts import split_standing_posts
from cherrypicker.segmentation.stems import StemModel, relabel_wood
from cherrypicker.segmentation.support_post import PostModel, split_support_post
from cherrypicker.segmentation.things import Square, one_class_a_thing, wood_under_things

logger = logging.getLogger(__name__)

_WOOD_CHANNELS = [label.channel or 0 for label in WOOD]

_BLOCK = 500_000  # points of a block; bounds the memory, changes no result
N_NEAREST = 3  # sampled points that a point takes its probabilities from
NEAREST_M = 1e-6  # a sampled point nearer than this has all the weight
VOXEL_RATIO = 0.5  # weights hold to about half more or less than the voxel they were trained at
TRAINED = ("voxel_size_m", "reference_height_m", "sphere_radius_m", "sphere_points")


@dataclass(frozen=True)
class Sampling:
    """How a cloud is cut for the network; the fields are config keys of ``segment``.

    Those named in `TRAINED` may be None for `segment_cloud`: as the weights were trained.
    """

    voxel_size_m: float | None = None
    max_points: int = 4_000_000
    reference_height_m: float | None = None
    sphere_radius_m: float | None = None
    sphere_points: int | None = None
    min_visits: int = 2
    batch_spheres: int = 16

    def filled(self, trained_at: dict) -> Sampling:
        """With the values of the training where ours are None."""
        return replace(self, **{k: trained_at[k] for k in TRAINED if getattr(self, k) is None})


def predict_spheres(
    network: Dgcnn,
    points: np.ndarray,
    colors: np.ndarray | None,
    sampling: Sampling,
    *,
    seed: int,
    device: str = "cpu",
) -> np.ndarray:
    """Mean class probabilities over overlapping spheres.

    Parameters
    ----------
    network : Dgcnn
        In evaluation mode.
    points : ndarray of shape (n, 3), float64
        Sampled points in the tree's frame.
    colors : ndarray of shape (n, 3) or None
    sampling : Sampling
    seed : int
    device : str

    Returns
    -------
    ndarray of shape (n, 7), float32
        Rows sum to 1.
    """
    rng = np.random.default_rng(seed)
    total = np.zeros((len(points), N_CLASSES), np.float32)
    visits = np.zeros(len(points), np.int32)
    k = network.settings["k"]
    n_scales = max(network.settings["scales"]) + 1
    radius, most = sampling.sphere_radius_m, sampling.sphere_points
    assert radius is not None and most is not None  # `Sampling.filled`
    network = network.to(device)
    batch: list[tuple] = []
    rows: list[np.ndarray] = []

    def flush() -> None:
        features, graphs, sizes = collate(batch)
        graphs = [graph if device == "cpu" else graph.long().to(device) for graph in graphs]
        with torch.inference_mode():
            result = network(features.to(device), graphs, sizes).exp().cpu().numpy()
        for indices, part in zip(rows, np.split(result, np.cumsum(sizes)[:-1])):
            total[indices] += part  # the indices of one sphere are distinct
            visits[indices] += 1
        batch.clear()
        rows.clear()

    goal = sampling.min_visits * len(points)
    with Progress(goal, "sampled points segmented") as bar:
        done = 0
        for center, indices in cover(points, radius, most, sampling.min_visits, rng):
            part = points[indices]
            part_colors = None if colors is None else colors[indices]
            features = features_of(part, part_colors, center, radius)
            batch.append((features, neighbor_graphs(part, k, n_scales)))
            rows.append(indices)
            if len(batch) == sampling.batch_spheres:
                flush()
                now = int(np.minimum(visits, sampling.min_visits).sum())
                bar.step(now - done)
                done = now
        if batch:
            flush()
        bar.step(goal - done)
    logger.info(
        "every sampled point was seen %.1f times on average (at least %d)",
        visits.mean(),
        visits.min(),
    )
    return total / visits[:, None]


def sample_cloud(
    cloud: PointCloud, sampling: Sampling, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray | None, TreeFrame]:
    """Voxel sample of a cloud in the tree's frame.

    Parameters
    ----------
    cloud : PointCloud
    sampling : Sampling
    rng : numpy.random.Generator
        Chooses the points of a cloud above ``max_points``.

    Returns
    -------
    points : ndarray of shape (n, 3), float64
    colors : ndarray of shape (n, 3) or None
    frame : TreeFrame
    """
    voxel, height = sampling.voxel_size_m, sampling.reference_height_m
    assert voxel is not None and height is not None  # `Sampling.filled`
    chosen = np.arange(len(cloud))
    if len(cloud) > sampling.max_points:
        chosen = np.sort(rng.choice(len(cloud), sampling.max_points, replace=False))
        logger.info(
            "thinned to %s of %s points (segment.max_points)",
            f"{len(chosen):,}",
            f"{len(cloud):,}",
        )
    frame = tree_frame(cloud.points[chosen], height)
    if frame.scale < 1:
        logger.info(
            "the cloud is taller than %.1f m; the network sees it at %.0f %% of its size",
            height,
            100 * frame.scale,
        )
    points, inverse, counts = voxel_sample(frame.apply(cloud.points[chosen]), voxel)
    colors = None
    if cloud.colors is not None:
        colors = voxel_mean(np.asarray(cloud.colors[chosen], np.float64), inverse, counts)
    logger.info(
        "sampled %s points on %.3f m voxels of %s",
        f"{len(points):,}",
        voxel / frame.scale,
        f"{len(cloud):,}",
    )
    return points, colors, frame


def propagate(points: np.ndarray, sampled: np.ndarray, probabilities: np.ndarray) -> np.ndarray:
    """Probabilities of any points from the nearest sampled ones, weighted by inverse distance.

    Parameters
    ----------
    points : ndarray of shape (n, 3)
    sampled : ndarray of shape (m, 3)
        In the same frame.
    probabilities : ndarray of shape (m, n_classes)

    Returns
    -------
    ndarray of shape (n, n_classes), float32
    """
    k = min(N_NEAREST, len(sampled))
    tree = cKDTree(sampled)
    out = np.zeros((len(points), probabilities.shape[1]), np.float32)
    # In blocks: neighbours and weights of all points would take more memory than the cloud itself
    for start in range(0, len(points), _BLOCK):
        block = points[start : start + _BLOCK]
        distance, nearest = tree.query(block, k=k, workers=torch.get_num_threads())
        distance, nearest = distance.reshape(len(block), k), nearest.reshape(len(block), k)
        weight = 1.0 / (distance + NEAREST_M)
        weight /= weight.sum(axis=1, keepdims=True)
        for j in range(k):
            out[start : start + _BLOCK] += (
                weight[:, j : j + 1].astype(np.float32) * probabilities[nearest[:, j]]
            )
    return out


def segment_cloud(
    cloud: PointCloud,
    weights: str | Path,
    *,
    sampling: Sampling,
    smoothing: Smoothing,
    post: PostModel | None,
    stems: StemModel | None = None,
    squares: list[Square] | None = None,
    seed: int = 0,
    device: str = "cpu",
) -> PointCloud:
    """Label every point of a cloud (paper, section Point Cloud Segmentor).

    Parameters
    ----------
    cloud : PointCloud
        z up; colours may be absent.
    weights : str or Path
        File of `cherrypicker.segmentation.dgcnn.save_weights`.
    sampling : Sampling
    smoothing : cherrypicker.segmentation.refine.Smoothing
    post : cherrypicker.segmentation.support_post.PostModel or None
        None leaves support posts in the wood.
    stems : cherrypicker.segmentation.stems.StemModel, optional
        How the stems are traced that decide between trunk and branch; None leaves it to the
        network.
    squares : list of cherrypicker.segmentation.things.Square, optional
        All markers of the scene, in the frame of the cloud; None where they are not known.
    seed : int
    device : str

    Returns
    -------
    PointCloud
        The same points in the same order with fields ``label`` (uint8) and ``confidence``
        (float32, the probability of the label; of wood, where the stem's course chose which).

    Raises
    ------
    StageError
        The cloud is empty or tiny, the weights cannot be used, or no wood was found.
    """
    network, trained_at, _ = load_weights(weights)
    if len(cloud) < network.settings["k"]:
        raise StageError(f"the cloud has {len(cloud)} points, too few to segment")
    sampling = sampling.filled(trained_at)
    voxel = sampling.voxel_size_m
    assert voxel is not None  # `Sampling.filled`
    if abs(trained_at["voxel_size_m"] / voxel - 1) > VOXEL_RATIO:
        logger.warning(
            "segment.voxel_size_m is %.3f, the weights were trained at %.3f",
            voxel,
            trained_at["voxel_size_m"],
        )
    rng = np.random.default_rng(seed)
    points, colors, frame = sample_cloud(cloud, sampling, rng)
    probabilities = predict_spheres(network, points, colors, sampling, seed=seed, device=device)
    probabilities = smooth_probabilities(points, probabilities, smoothing)
    probabilities = keep_sheets(points, probabilities)
    if squares is not None:
        squares = [Square(frame.apply(square.corners)) for square in squares]
    probabilities = one_class_a_thing(points, probabilities, voxel, squares)
    probabilities = wood_under_things(points, probabilities, voxel)
    probabilities = clean_trunk(points, probabilities, smoothing)
    full = propagate(frame.apply(cloud.points), points, probabilities)
    labels = _likeliest(full)
    confidence = full.max(axis=1).clip(0.0, 1.0).astype(np.float32)
    if not wood_mask(labels).any():
        found = ", ".join(CLASS_NAMES[int(c)] for c in np.unique(labels))
        raise StageError(
            f"no point was labelled trunk or branch (found: {found})",
            key="segment.weights or segment.voxel_size_m",
        )
    if post is not None:
        labels = split_support_post(cloud.points, labels, frame, post)
        labels = split_standing_posts(cloud.points, labels, frame, post)
    if stems is not None:
        chosen = relabel_wood(cloud.points, labels, frame, stems, cloud.colors)
        moved = chosen != labels
        wood = full[moved][:, _WOOD_CHANNELS].sum(axis=1)
        labels, confidence[moved] = chosen, wood.clip(0.0, 1.0)
    _log_counts(labels, confidence)
    return cloud.with_fields(label=labels, confidence=confidence)


def _likeliest(probabilities: np.ndarray) -> np.ndarray:
    """Label of each row; the classes of wood together stand against the rest."""
    joined, wood = probabilities.copy(), _WOOD_CHANNELS
    joined[:, wood] = probabilities[:, wood].sum(axis=1, keepdims=True)
    channel = joined.argmax(axis=1)
    is_wood = np.isin(channel, wood)
    channel[is_wood] = np.array(wood)[probabilities[is_wood][:, wood].argmax(axis=1)]
    return np.array(CHANNELS, np.uint8)[channel]


def _log_counts(labels: np.ndarray, confidence: np.ndarray) -> None:
    for label in np.unique(labels):
        chosen = labels == label
        logger.info(
            "%-16s %12s points (%.1f %%), mean confidence %.2f",
            CLASS_NAMES[int(label)],
            f"{int(chosen.sum()):,}",
            100 * chosen.mean(),
            confidence[chosen].mean(),
        )
