"""The paper's graph: networkx's minimum spanning tree over sampled skeleton points (Sec. Graph)."""

import logging

import numpy as np
import numpy.typing as npt

from cherrypicker.errors import StageError
from cherrypicker.geometry.neighbors import Neighbors, component_links, edge_lengths
from cherrypicker.geometry.sampling import farthest_point_sample, majority_label
from cherrypicker.skeleton.model import Skeleton, rooted_order
from cherrypicker.wood.target_wood import lowest_base

logger = logging.getLogger(__name__)

FEWEST_NODES = 3


def spanning_tree(
    points: np.ndarray,
    labels: np.ndarray,
    *,
    spacing_m: float = 0.01,
    k: int = 30,
    base: npt.ArrayLike | None = None,
) -> Skeleton:
    """Farthest point sampling and the minimum spanning tree, rooted at the stem base.

    Points (n_points, 3) are contracted, with classes (n_points,); each lies within the spacing of a
    sample. A sample has `k` neighbours in the graph; the shortest links between its components are
    added, so that it is always connected: 6 to 60 neighbours gave one tree of each of three scans.
    The root is near the foot of the stem, `base` (3,), the lowest points if left out.

    The skeleton has zero radii; ``fields["gap"]`` marks the links added between components. A
    `StageError` where there are too few points or they coincide.
    """
    import networkx as nx

    base = np.asarray(lowest_base(points, labels).base if base is None else base)
    below = np.array([base[0], base[1], points[:, 2].min()])  # the stem may reach below its base
    root = int(np.argmin(np.linalg.norm(points - below, axis=1)))
    samples, nearest = farthest_point_sample(points, spacing_m, first=root)
    if len(samples) < FEWEST_NODES:
        raise StageError(
            f"{len(samples)} skeleton samples are too few for a graph", key="graph.spacing_m"
        )
    nodes, label = points[samples], majority_label(labels, nearest, len(samples))
    edges, _ = Neighbors(nodes, k).touching(k, np.inf)
    links = component_links(nodes, edges)
    edges = np.vstack([edges, links]).astype(np.int64)
    length = edge_lengths(nodes, edges).tolist()
    graph = nx.Graph()
    graph.add_weighted_edges_from(zip(*edges.T.tolist(), length, strict=True))
    pairs = np.array(nx.minimum_spanning_tree(graph).edges)
    order, parent = rooted_order(len(nodes), pairs, 0)
    skeleton = Skeleton(nodes[order], parent, np.zeros(len(nodes)), label[order])
    # no sample lies within 3 spacings of one that missing data parts from the next
    skeleton.fields["gap"] = (skeleton.edge_length > 3 * spacing_m).astype(np.int64)
    logger.info("%d samples every %.1f mm, %d links added", len(nodes), 1e3 * spacing_m, len(links))
    return skeleton
