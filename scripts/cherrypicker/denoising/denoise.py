"""Removal of isolated points and of sky silhouettes (paper, section Denoising).

The paper's two filters, in its order, and one of ours between them. The statistical one removes
points far from their neighbours; ours those whose surroundings hardly any photo supports.
The sky filter removes points that bear a dominant sky colour: stereo windows reach over the border
of a thin branch and give its neighbourhood the branch's depth and the sky's colour.

The photos have the last word on both (this is ours, not the paper's, see
`cherrypicker.evidence`). Colour alone would also eat white paint, lichen, sunlit bark and the twigs
whose pixels are half sky: a point of sky colour goes only where the photos show that it is more
likely not there. And the tips of twigs are as far from their neighbours, and as poorly seen, as
what floats in the air: an isolated point stays where the photos show it likelier there than not.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pycolmap
from scipy.spatial import cKDTree

from cherrypicker.classes import Removal
from cherrypicker.errors import StageError
from cherrypicker.evidence.existence import PRIOR
from cherrypicker.pointcloud import PointCloud
from cherrypicker.sky.colors import SkyColors

logger = logging.getLogger(__name__)

#: The ground, hills included, lies below this share of the cameras' height over z = 0.
GROUND_SHARE = 0.15
#: Neighbours of a point, itself counted: as in Open3D's example of the filter.
N_NEIGHBORS = 20
#: Points per block of the neighbour search; bounds the memory, changes no result.
BLOCK = 200_000
#: Where this many photos agree on the neighbourhood it is supported, however many see the rest: as
#: many as COLMAP asks of a point.
ENOUGH_VIEWS = pycolmap.StereoFusionOptions().min_num_pixels


@dataclass(frozen=True)
class DenoiseOptions:
    """Settings of `denoise_cloud`; the fields are config keys of ``denoise``."""

    std_ratio: float = 3.0
    min_view_ratio: float = 0.4
    ask_photos: bool = True
    sky_color_distance: float = 0.1


def neighbor_means(
    points: np.ndarray, values: np.ndarray, n_neighbors: int
) -> tuple[np.ndarray, np.ndarray]:
    """Average over the ``n_neighbors`` nearest points, the point itself counted as one.

    Of points (n_points, 3) with values (n_points,) these are the mean distance, the point's own
    zero included, and the mean value, each (n_points,) float64.
    """
    n_points = len(points)
    k = min(n_neighbors, n_points)
    tree = cKDTree(points)
    mean_distance, mean_value = np.empty(n_points), np.empty(n_points)
    for start in range(0, n_points, BLOCK):
        block = slice(start, start + BLOCK)
        distances, index = tree.query(points[block], k=[*range(1, k + 1)], workers=-1)
        mean_distance[block] = distances.mean(axis=1)
        mean_value[block] = values[index].mean(axis=1)
    return mean_distance, mean_value


def statistical_inliers(mean_distance: np.ndarray, std_ratio: float) -> np.ndarray:
    """Find the points whose neighbours are about as near as elsewhere, (n_points,) bool.

    The mean distance (n_points,), from `neighbor_means`, must be below mean + std_ratio * standard
    deviation over the cloud: the maths of Open3D's ``remove_statistical_outlier``, which the paper
    uses and `statistical_filter` is. Where the neighbours are sought for the photos' sake anyway,
    this costs no second search.
    """
    valid = mean_distance > 0  # Open3D leaves points out that coincide with all their neighbours
    if len(mean_distance) < 2 or not valid.any():
        return np.ones(len(mean_distance), bool)
    limit = mean_distance[valid].mean() + std_ratio * mean_distance[valid].std(ddof=1)
    return mean_distance < limit


def statistical_filter(points: np.ndarray, n_neighbors: int, std_ratio: float) -> np.ndarray:
    """Find the points (n_points, 3) that Open3D's statistical filter keeps, (n_points,) bool."""
    import open3d  # takes seconds, and the default does without

    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    _, rows = cloud.remove_statistical_outlier(n_neighbors, std_ratio)
    keep = np.zeros(len(points), bool)
    keep[np.asarray(rows, np.int64)] = True
    return keep


def supported_points(
    n_views: np.ndarray, mean_views: np.ndarray, min_ratio: float, counts: np.ndarray | None = None
) -> np.ndarray:
    """Find the points whose neighbourhood about as many photos saw as the rest, (n_points,) bool.

    Two neighbouring photos can agree on a wrong match (a line of trees behind the crown, sliding
    along itself), a dozen cannot; a thin twig that few photos resolve still has better seen
    neighbours. Not in the paper.

    ``n_views`` (n_points,) are the photos that each point was fused from, ``mean_views`` their mean
    over its neighbours, from `neighbor_means`. Its ratio to the cloud's median of ``n_views`` is to
    be ``min_ratio`` or more, but never more than `ENOUGH_VIEWS` photos are asked for. Points that
    ``counts`` (n_points,), bool, names make the median; all when none is given or none set. The
    ground is most of a cloud, and photos from all sides see it: its median says nothing about
    twigs.
    """
    typical = np.median(n_views if counts is None or not counts.any() else n_views[counts])
    return mean_views >= min(min_ratio * typical, ENOUGH_VIEWS)


def denoise_cloud(
    cloud: PointCloud,
    sky: SkyColors,
    evidence_of: Callable[[np.ndarray, np.ndarray], np.ndarray],
    options: DenoiseOptions,
    ground_height: float = -np.inf,
) -> tuple[PointCloud, dict, np.ndarray]:
    """Remove isolated points and sky silhouettes.

    The sky filter is skipped where the cloud has no colours, or no sky colour is dominant.
    ``evidence_of(asked, sure)``, both of shape (n, 3), returns what the photos say about the
    former, see `cherrypicker.evidence.existence.ask_points`. What lies below the ground's height
    does not count for how many photos see a point of the cloud.

    Returns the cloud, the report's counts and, (n_input,) uint8, the
    `cherrypicker.classes.Removal` of each point that went, 0 of those that stay.

    Raises
    ------
    StageError
        When no point is left.
    """
    is_isolated, is_unsupported = _find_isolated(cloud, options, ground_height)
    is_doubted = is_isolated | is_unsupported
    is_sky_colored = ~is_doubted & _find_sky_colored(cloud, sky, options)
    asked = np.flatnonzero(is_sky_colored | is_doubted)
    keep = ~(is_doubted | is_sky_colored)
    if options.ask_photos and len(asked):
        above = ~is_doubted & (cloud.points[:, 2] > ground_height)
        sure = keep & above if (keep & above).any() else above
        told = evidence_of(cloud.points[asked], cloud.points[sure])
        # a colour alone is little against what the stereo found
        keep[asked] = told > np.where(is_doubted[asked], 0.0, -np.log(PRIOR / (1.0 - PRIOR)))
    removed_by = np.zeros(len(cloud), np.uint8)
    for reason, said in (
        (Removal.SKY, is_sky_colored),
        (Removal.FEW_PHOTOS, is_unsupported),
        (Removal.ISOLATED, is_isolated),
    ):
        removed_by[said & ~keep] = reason
    counts = np.bincount(removed_by, minlength=len(Removal) + 1)
    report = {
        "n_input": len(cloud),
        "n_removed_statistical": int(counts[Removal.ISOLATED]),
        "n_removed_views": int(counts[Removal.FEW_PHOTOS]),
        "n_kept_twigs": int(np.count_nonzero(is_doubted & keep)),
        "n_sky_colored": int(np.count_nonzero(is_sky_colored)),
        "n_kept_by_photos": int(np.count_nonzero(is_sky_colored & keep)),
        "n_removed_sky": int(counts[Removal.SKY]),
        "n_output": int(counts[0]),
    }
    for what, key, of in (
        ("statistical filter: removed", "n_removed_statistical", "n_input"),
        ("seen by too few photos: removed", "n_removed_views", "n_input"),
        ("isolated, but a twig before the sky in the photos: kept", "n_kept_twigs", "n_input"),
        ("sky filter: of a sky colour", "n_sky_colored", "n_input"),
        ("sky filter: removed", "n_removed_sky", "n_input"),
        ("sky filter: the photos spared", "n_kept_by_photos", "n_sky_colored"),
        ("denoising kept", "n_output", "n_input"),
    ):
        part, whole = report[key], report[of]
        share = 100 * part / max(whole, 1)
        logger.info("%s %s", what, f"{part:,} of {whole:,} points ({share:.1f} %)")
    if not keep.any():
        raise StageError(
            f"the filters removed all {len(cloud):,} points: the statistical one "
            f"{report['n_removed_statistical']:,}, too few photos {report['n_removed_views']:,}, "
            f"sky {report['n_removed_sky']:,}",
            key="denoise.std_ratio, denoise.min_view_ratio, denoise.sky_color_distance",
        )
    return cloud.select(keep), report, removed_by


def _find_isolated(
    cloud: PointCloud, options: DenoiseOptions, ground_height: float
) -> tuple[np.ndarray, np.ndarray]:
    """Find what is far from its neighbours, and what hardly any photo supports."""
    n_views = cloud.fields.get("n_views") if options.min_view_ratio > 0 else None
    if n_views is None:
        is_isolated = ~statistical_filter(cloud.points, N_NEIGHBORS, options.std_ratio)
        return is_isolated, np.zeros(len(cloud), bool)
    mean_distance, mean_views = neighbor_means(cloud.points, n_views, N_NEIGHBORS)
    is_isolated = ~statistical_inliers(mean_distance, options.std_ratio)
    counts = cloud.points[:, 2] > ground_height
    is_unsupported = ~supported_points(n_views, mean_views, options.min_view_ratio, counts)
    return is_isolated, is_unsupported


def _find_sky_colored(cloud: PointCloud, sky: SkyColors, options: DenoiseOptions) -> np.ndarray:
    """Find the points whose colour is near a dominant sky colour."""
    if sky.n_clusters == 0:
        logger.info("sky filter: no sky in the photos, nothing to do")
    elif cloud.colors is not None:
        return sky.distance(cloud.colors) <= options.sky_color_distance
    else:
        logger.warning("sky filter skipped: the cloud has no colours")
    return np.zeros(len(cloud), bool)
