"""The benchmark's methods: which contraction and which graph, run on one cloud and scored."""

import logging
import resource
import time
from dataclasses import replace

import numpy as np

from cherrypicker.classes import Label
from cherrypicker.contraction.contract_points import SkeletonOptions
from cherrypicker.contraction.contract_wood import contract_tree, contract_wood
from cherrypicker.errors import StageError
from cherrypicker.graph.extract import extract_skeleton
from cherrypicker_lab.skeletons.graph_scores import (
    graph_of,
    radius_errors,
    score_graph,
    score_points,
)

logger = logging.getLogger(__name__)

SETTINGS = ("noise", "holes")
# name: skeleton.method
OURS = {
    "lbc_paper": "lbc",
    "slbc_paper": "slbc",
    "bare_default": "limbs",
    "slbc_default": "limbs",
}
GRAPHS_OF = {"bare_default": ("tree",), "slbc_default": ("mst", "tree")}
TRUNK_WEIGHT = 10.0
START_UP_POINTS = 3000  # enough that every compiled function is called


def measure_cloud(cloud, truth, methods, *, keep=None):
    """Run our contractions, and the graphs of the default one, on a cloud and score them.

    "bare_default" gets the cloud with all of its wood labelled branch.

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
        By method: ``cpu_s``, ``peak_mb`` (of the process so far), ``points`` (`score_points`) and,
        for limbs, ``graphs`` of `GRAPHS_OF` (`score_graph`, `radius_errors` as
        ``radius``, ``cpu_s``).
    """
    report = {}
    for name in methods:
        method = OURS[name]
        given = _as_branches(cloud) if name == "bare_default" else cloud
        start = time.process_time()
        if method != "limbs":
            points = contract_as_published(cloud, method)
        else:
            contracted, details = contract_wood(given)
            points = contracted.points
        found = {
            "cpu_s": time.process_time() - start,
            "points": score_points(points, truth.skeleton),
        }
        if keep is not None:
            keep[name] = points
        if name in GRAPHS_OF:
            found["graphs"] = {}
            for graph in GRAPHS_OF[name]:
                scores = _measure_graph(contracted, given, truth, graph, details)
                if keep is not None:
                    keep[f"{name}_{graph}"] = scores.pop("segments")
                else:
                    scores.pop("segments")
                found["graphs"][graph] = scores
        found["peak_mb"] = peak_mb()
        report[name] = found
        logger.info("%s: Chamfer %.2f cm2", name, found["points"]["chamfer_cm2"])
    return report


def start_up(cloud):
    """Run the limbs on a few of the points, which compiles and loads its functions."""
    rng = np.random.default_rng(0)
    few = cloud.select(np.sort(rng.choice(len(cloud), min(START_UP_POINTS, len(cloud)), False)))
    contracted, details = contract_wood(few)
    extract_skeleton(contracted, few, base=details["base"], limbs=details["limbs"])


def peak_mb():
    """Most memory that this process has held so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _as_branches(cloud):
    """The cloud with all of its points labelled branch."""
    fields = {**cloud.fields, "label": np.full(len(cloud), Label.BRANCH, np.uint8)}
    return replace(cloud, fields=fields)


def contract_as_published(cloud, method, **constants):
    """All points of a set's cloud contracted as published, neither chosen nor thinned."""
    return contract_tree(
        cloud.points,
        np.asarray(cloud["label"]),
        weights={Label.TRUNK: TRUNK_WEIGHT},
        options=SkeletonOptions(method, **constants),
    )[0]


def _measure_graph(contracted, cloud, truth, method, details):
    start = time.process_time()
    skeleton = extract_skeleton(
        contracted,
        cloud,
        base=details["base"],
        limbs=details["limbs"] if method == "tree" else None,
    )
    cpu_s = time.process_time() - start
    graph = graph_of(skeleton)
    if not len(graph.edges):
        raise StageError(f"the {method} graph has no edges", key="skeleton.method")
    segments = np.asarray(graph.points)[graph.edges]
    scores = score_graph(graph, truth) | {
        "radius": radius_errors(skeleton.points, skeleton.radius, truth)
    }
    return {"cpu_s": cpu_s, **scores, "segments": segments}
