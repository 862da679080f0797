"""Labels for every point of a metric cloud."""

import logging
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from cherrypicker.classes import CHANNELS, CLASS_NAMES, WOOD, Label, wood_mask
from cherrypicker.errors import StageError
from cherrypicker.geometry.neighbors import Neighbors
from cherrypicker.geometry.sampling import voxel_mean, voxel_sample
from cherrypicker.limbs.orchard import Orchard, grow_orchard
from cherrypicker.placement.footprint import Footprint
from cherrypicker.pointcloud import PointCloud
from cherrypicker.progress import Progress
from cherrypicker.segmentation.dgcnn import N_CLASSES, Dgcnn, collate, load_weights
from cherrypicker.segmentation.known_markers import KnownMarkers
from cherrypicker.segmentation.spheres import cover, features_of, in_tree_frame, neighbor_graphs
from cherrypicker.segmentation.stems import limbs_decide
from cherrypicker.segmentation.things import IN_GROUP, group_of, keep_roofs, vote_per_object
from cherrypicker.wood.thinned import GrowthOptions

logger = logging.getLogger(__name__)

# Spheres that see each sampled point at least; by one and by three 0.3 to 0.6 % of the points of
# two scans have another label
N_VISITS = 2
N_NEAREST = 3  # sampled points that a point takes its probabilities from
WOOD_COLUMNS = [CHANNELS.index(label) for label in WOOD]
TRAINED = ("voxel_size_m", "reference_height_m", "sphere_radius_m", "sphere_points")


@dataclass(frozen=True)
class Sampling:
    """How a cloud is cut for the network.

    Config keys of ``segment``; those in `TRAINED`, of ``train_segment``, come from the weights.
    """

    smooth_k: int = 12  # without the vote the mean IoU of a scan falls from 0.695 to 0.660
    voxel_size_m: float = 0.02
    reference_height_m: float = 3.5
    sphere_radius_m: float = 0.7
    sphere_points: int = 1536


def predict_spheres(
    network: Dgcnn,
    points: np.ndarray,
    colors: np.ndarray | None,
    sampling: Sampling,
    *,
    seed: int,
    device: str = "cpu",
) -> np.ndarray:
    """Mean class probabilities (n, N_CLASSES) of sampled points (n, 3) over overlapping spheres.

    Points and colours, None or (n, 3), are in the tree's frame, and the network in evaluation mode.
    Rows sum to 1.
    """
    total = np.zeros((len(points), N_CLASSES), np.float32)
    visits = np.zeros(len(points), np.int32)
    k, n_scales = network.settings["k"], max(network.settings["scales"]) + 1
    radius, most = sampling.sphere_radius_m, sampling.sphere_points
    network = network.to(device)
    spheres = cover(points, radius, most, N_VISITS, np.random.default_rng(seed))
    with (
        Progress(N_VISITS * len(points), "sampled points segmented") as bar,
        torch.inference_mode(),
    ):
        for center, rows in spheres:  # sixteen at once take as long
            part_colors = None if colors is None else colors[rows]
            features = features_of(points[rows], part_colors, center, radius)
            near = neighbor_graphs(points[rows], k, n_scales)
            tensor, graphs, sizes = collate([(features, near)])
            graphs = [graph.to(device) for graph in graphs]
            total[rows] += network(tensor.to(device), graphs, sizes).exp().cpu().numpy()
            visits[rows] += 1  # the rows of one sphere are distinct
            bar.step(int(np.minimum(visits, N_VISITS).sum()) - bar.done)
    return total / visits[:, None]


def segment_cloud(
    cloud: PointCloud,
    weights: str | Path,
    *,
    sampling: Sampling,
    growth: GrowthOptions | None = None,
    region: Footprint | None = None,
    is_row: bool = False,
    pixel: float | None = None,
    markers: KnownMarkers | None = None,
    by: str = "limbs",
    seed: int = 0,
    device: str = "cpu",
) -> tuple[PointCloud, Orchard]:
    """Label every point of a cloud (paper, section Point Cloud Segmentor), and grow its limbs.

    The cloud's z is up; colours may be absent. The file of weights is one that
    `cherrypicker.segmentation.dgcnn.load_weights` reads. ``growth``, ``region``, ``is_row`` and
    ``pixel`` are as of `cherrypicker.limbs.orchard.grow_orchard`. The markers are those of the
    scene, in the frame of the cloud; left out where nothing is known of them. By "limbs" what is
    known of things and of limbs beside the network decides, by "network" its likeliest class alone,
    as published.

    Returns the same points in the same order with fields ``label`` (uint8) and ``confidence``
    (float32, the probability of the label, of wood that of all wood), and the limbs that decided
    between trunk and branch.

    Raises
    ------
    StageError
        The cloud is empty or tiny, the weights cannot be used, or no wood was found.
    """
    growth, markers = growth or GrowthOptions(), markers or KnownMarkers()
    is_alone = by == "network"
    network, trained_at = load_weights(weights)
    if len(cloud) < network.settings["k"]:
        raise StageError(f"the cloud has {len(cloud)} points, too few to segment")
    if is_alone and network.settings["graph"] != "dynamic":
        logger.warning(
            "the graph of these weights is fixed; train_segment.graph: dynamic trains the paper's, "
            "with neighbours in feature space (segment.weights)"
        )
    if missing := [name for name in TRAINED if name not in trained_at]:
        cause = f"the segmentation weights do not tell their {', '.join(missing)}"
        raise StageError(cause, file=weights, key="segment.weights")
    sampling = replace(sampling, **{name: trained_at[name] for name in TRAINED})
    local, shrunk = in_tree_frame(cloud.points, sampling.reference_height_m)
    points, voxel_of, counts = voxel_sample(local, sampling.voxel_size_m)
    places, voxel = voxel_mean(cloud.points, voxel_of, counts), sampling.voxel_size_m / shrunk
    colors = None if cloud.colors is None else voxel_mean(cloud.colors, voxel_of, counts)
    logger.info(
        f"sampled {len(points):,} points on {voxel:.3f} m voxels of {len(cloud):,}; the network "
        f"sees them at {100 * shrunk:.0f} % of their size"
    )
    likely = predict_spheres(network, points, colors, sampling, seed=seed, device=device)
    likely = smooth_probabilities(points, likely, sampling.smooth_k)
    if not is_alone:
        likely = keep_roofs(places, likely, voxel)
        likely = vote_per_object(places, likely, voxel, markers)
    likely = propagate(local, points, likely)
    own = True if is_alone else IN_GROUP[group_of(likely)]  # the likeliest group comes first
    labels = np.array(CHANNELS, np.uint8)[np.where(own, likely, -1.0).argmax(axis=1)]
    if not wood_mask(labels).any():
        found = ", ".join(CLASS_NAMES[int(label)] for label in np.unique(labels))
        raise StageError(f"no point is trunk or branch (found: {found})", key="segment.weights")
    result, wood = cloud.with_fields(label=labels), likely[:, WOOD_COLUMNS].sum(axis=1)
    grow = partial(grow_orchard, options=growth, region=region, is_row=is_row, pixel=pixel)
    if is_alone:
        orchard = grow(result)
    else:
        known = markers.hold(cloud.points, voxel)
        post = likely[:, CHANNELS.index(Label.SUPPORT_POST)]  # of what is that or wood
        post = post / np.maximum(post + wood, np.finfo(np.float32).tiny)
        orchard = limbs_decide(result, grow, post=post, known=known, stem_gap_m=growth.stem_gap_m)
    likely[:, WOOD_COLUMNS] = wood[:, None]
    confidence = likely[np.arange(len(cloud)), np.searchsorted(CHANNELS, labels)].clip(0.0, 1.0)
    for label in np.unique(labels):
        chosen = labels == label
        logger.info(
            f"{CLASS_NAMES[int(label)]:16} {chosen.sum():12,} points ({100 * chosen.mean():.1f} %),"
            f" mean confidence {confidence[chosen].mean():.2f}"
        )
    return result.with_fields(confidence=confidence), orchard


def smooth_probabilities(points: np.ndarray, probabilities: np.ndarray, k: int) -> np.ndarray:
    """Mean probabilities (n, n_classes) over the `k` nearest of the sampled points (n, 3)."""
    nearest = Neighbors(points, max(k, 1) - 1).index
    result = _weighted(probabilities, nearest, np.ones(nearest.shape))
    changed = (result.argmax(axis=1) != probabilities.argmax(axis=1)).mean()
    logger.info("vote of %d neighbours changed %.1f %% of the labels", k, 100 * changed)
    return result / nearest.shape[1]


def propagate(points: np.ndarray, sampled: np.ndarray, probabilities: np.ndarray) -> np.ndarray:
    """Probabilities (n, n_classes) of any points (n, 3), float32.

    Each takes those of the nearest sampled ones (m, 3), weighted by inverse distance.
    """
    nearby = range(1, 1 + min(N_NEAREST, len(sampled)))
    away, nearest = cKDTree(sampled).query(points, k=nearby, workers=torch.get_num_threads())
    weight = 1.0 / (away + np.finfo(np.float32).eps)  # a sampled point has all its weight
    weight /= weight.sum(axis=1, keepdims=True)
    return _weighted(probabilities.astype(np.float32), nearest, weight.astype(np.float32))


def _weighted(values: np.ndarray, rows: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Weighted sums (n, c) of rows (n, k) of values (m, c)."""
    ends = np.arange(0, rows.size + 1, rows.shape[1])
    return csr_matrix((weight.ravel(), rows.ravel(), ends), (len(rows), len(values))) @ values
