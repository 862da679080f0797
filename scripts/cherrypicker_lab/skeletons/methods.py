"""The benchmark's methods: which contraction and which graph, run on one cloud and scored."""

import logging
import time

import numpy as np

from cherrypicker.classes import Label
from cherrypicker.contraction.contract_points import ContractionOptions
from cherrypicker.contraction.contract_tree import contract_tree
from cherrypicker.contraction.contract_wood import WoodOptions, contract_wood
from cherrypicker.errors import StageError
from cherrypicker.graph.extract import GraphOptions, extract_skeleton
from cherrypicker_lab.skeletons.graph_scores import graph_of, score_graph
from cherrypicker_lab.skeletons.point_scores import score_points

logger = logging.getLogger(__name__)

SETTINGS = ("noise", "holes")
# name: method, preset
OURS = {
    "lbc_paper": ("lbc", "paper"),
    "slbc_paper": ("slbc", "paper"),
    "lbc_default": ("lbc", "default"),
    "slbc_default": ("slbc", "default"),
}
GRAPHS = ("mst", "tree")
GRAPHS_OF = ("slbc_default",)
TRUNK_WEIGHT = 10.0


def measure_cloud(cloud, truth, methods, *, keep=None):
    """Run our contractions, and the graphs of the default one, on a cloud and score them.

    Parameters
    ----------
    cloud : PointCloud
        Labelled, metres.
    truth : TrueTree
    methods : iterable of str
        Keys of `OURS`.
    keep : dict, optional
        Takes each method's contracted points, (n, 3), and each graph's nodes and edges.

    Returns
    -------
    dict
        By method: ``cpu_s``, ``points`` (`score_points`) and, for the default S-LBC, ``graphs`` by
        `GRAPHS` (`score_graph` and ``cpu_s``).
    """
    report = {}
    for name in methods:
        method, preset = OURS[name]
        start = time.process_time()
        if preset == "paper":
            contracted = contract_as_published(cloud, method)
        else:
            contracted, details = contract_wood(cloud, WoodOptions(method=method))
        found = {
            "cpu_s": time.process_time() - start,
            "points": score_points(contracted.points, truth.skeleton),
        }
        if keep is not None:
            keep[name] = contracted.points
        if name in GRAPHS_OF:
            found["graphs"] = {}
            for graph in GRAPHS:
                scores = _measure_graph(contracted, cloud, truth, graph, details)
                if keep is not None:
                    keep[f"{name}_{graph}"] = scores.pop("segments")
                else:
                    scores.pop("segments")
                found["graphs"][graph] = scores
        report[name] = found
        logger.info("%s: Chamfer %.2f cm2", name, found["points"]["chamfer_cm2"])
    return report


def contract_as_published(cloud, method, *, callback=None, **constants):
    """Contract all points of a set's cloud with the preset paper, neither chosen nor thinned."""
    return contract_tree(
        cloud.points,
        np.asarray(cloud["label"]),
        weights={Label.TRUNK: TRUNK_WEIGHT} if method == "slbc" else None,
        options=ContractionOptions("paper", **constants),
        callback=callback,
    )


def _measure_graph(contracted, cloud, truth, method, details):
    start = time.process_time()
    skeleton = extract_skeleton(
        contracted,
        cloud,
        GraphOptions(method=method),
        base=details["base"],
        limbs=details["limbs"],
    )
    cpu_s = time.process_time() - start
    graph = graph_of(skeleton)
    if not len(graph.edges):
        raise StageError(f"the {method} graph has no edges", key="graph.method")
    segments = np.asarray(graph.points)[graph.edges]
    return {"cpu_s": cpu_s, **score_graph(graph, truth), "segments": segments}
