"""Dominant sky colours of a scan (paper, section Denoising).

The RGB of sky pixels is jittered by N(0, 1/256), since clustering does not work on discrete values,
and clustered with DBSCAN. Sky colours lie on curved sheets in the RGB cube, so a cluster is kept as
the set of its core colours rather than as a mean.
"""

import logging
import os
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import cKDTree
from sklearn.cluster import DBSCAN

from cherrypicker.errors import StageError
from cherrypicker.files import read_npz, write_npz

logger = logging.getLogger(__name__)

JITTER = 1.0 / 256.0
# Sky pixels sampled over all photos; with half and twice as many up to 1.5 % of the points of a sky
# colour are others on two scans
N_SAMPLES = 20_000
# How near colours of one sky lie, in the RGB unit cube; with half and twice as much up to 14 % are
# others, and the photos decide on each
EPSILON = 0.02
# A cluster with a smaller share of the samples is no sky: a red roof that masks took for it. One
# scan is the same without, and another keeps 300 of 533 thousand points more
LEAST_SHARE = 0.02


@dataclass(frozen=True)
class SkyColors:
    """Dominant sky colours."""

    # (n_colors, 3) float32: core colours of the dominant clusters, RGB in [0, 1]
    colors: np.ndarray
    cluster: np.ndarray  # (n_colors,) int32: cluster of each colour, 0 the largest
    fraction: np.ndarray  # (n_clusters,) float64: share of the sampled sky pixels in each cluster
    n_sampled: int  # sky pixels that were clustered

    @property
    def n_clusters(self) -> int:
        """Number of dominant clusters, 0 in a scan without sky."""
        return len(self.fraction)

    def distance(self, colors: np.ndarray) -> np.ndarray:
        """Distance of each colour of shape (n, 3) to the nearest sky colour; inf without any."""
        if len(self.colors) == 0:
            return np.full(len(colors), np.inf)
        tree = cKDTree(self.colors.astype(np.float64))
        return tree.query(np.asarray(colors, np.float64), workers=-1)[0]


def sample_sky_pixels(
    image: np.ndarray, mask: np.ndarray, n_samples: int, rng: np.random.Generator
) -> np.ndarray:
    """Draw the colours of sky pixels that lie well inside the sky, (n, 3) uint8; none without sky.

    Of an image (H, W, 3), uint8, and its mask (H, W), uint8, where 255 is sky, at most
    ``n_samples`` are drawn, without replacement.
    """
    # The border of the mask holds colours mixed from sky and wood.
    reach = 2 * max(1, round(max(mask.shape) / 1000)) + 1
    kernel = np.ones((reach, reach), np.uint8)
    inside = np.flatnonzero(cv2.erode(mask, kernel, borderValue=255))
    if len(inside) > n_samples:
        inside = np.sort(rng.choice(inside, size=n_samples, replace=False))
    return image.reshape(-1, 3)[inside]


def cluster_sky_colors(samples: np.ndarray, *, seed: int) -> SkyColors:
    """Cluster sampled sky colours (n, 3), uint8, and keep the dominant clusters.

    They are ordered by size; there is none without samples.
    """
    n_samples = len(samples)
    if n_samples == 0:
        return SkyColors(np.zeros((0, 3), np.float32), np.zeros(0, np.int32), np.zeros(0), 0)
    rng = np.random.default_rng(seed)
    jittered = samples / 255.0 + rng.normal(0.0, JITTER, samples.shape)
    # Equal cells are clustered once, with their count as weight. That bounds the neighbour lists,
    # which would grow with the square of the samples under a white sky.
    cells, inverse, counts = np.unique(
        np.rint(jittered * 256).astype(np.int32), axis=0, return_inverse=True, return_counts=True
    )
    inverse = inverse.ravel()
    clustering = DBSCAN(eps=EPSILON, n_jobs=1).fit(cells / 256.0, sample_weight=counts)
    labels = clustering.labels_
    n_found = int(labels.max()) + 1
    share = np.bincount(labels[inverse] + 1, minlength=n_found + 1)[1:] / n_samples
    order = np.argsort(-share, kind="stable")
    dominant = order[share[order] >= LEAST_SHARE]
    logger.info(
        "sky colours: %d clusters in %d samples, %d dominant, %.1f %% noise",
        *(n_found, n_samples, len(dominant), 100 * float(np.mean(labels[inverse] < 0))),
    )
    rank = np.full(n_found + 1, -1, dtype=np.int32)  # the last one is that of the noise, -1
    rank[dominant] = np.arange(len(dominant))
    kept = clustering.core_sample_indices_[rank[labels[clustering.core_sample_indices_]] >= 0]
    kept = kept[np.argsort(rank[labels[kept]], kind="stable")]
    return SkyColors(
        colors=np.clip(cells[kept] / 256.0, 0, 1).astype(np.float32),
        cluster=rank[labels[kept]],
        fraction=share[dominant],
        n_sampled=n_samples,
    )


def write_sky_colors(path: str | os.PathLike, sky: SkyColors) -> None:
    """Write sky colours as NPZ: ``colors``, ``cluster``, ``fraction``, ``n_sampled``."""
    write_npz(path, **vars(sky) | {"n_sampled": np.int64(sky.n_sampled)})


def read_sky_colors(path: str | os.PathLike) -> SkyColors:
    """Read what `write_sky_colors` wrote.

    Raises
    ------
    StageError
        When the file is missing or not of that form.
    """
    data = read_npz(path, required=("colors", "cluster", "fraction", "n_sampled"))
    colors, cluster, fraction = data["colors"], data["cluster"], data["fraction"]
    if colors.ndim != 2 or colors.shape[1] != 3 or cluster.shape != (len(colors),):
        raise StageError(
            f"colors must be (n, 3) and cluster (n,), got {colors.shape}, {cluster.shape}",
            file=path,
        )
    return SkyColors(colors, cluster, fraction, int(data["n_sampled"]))
