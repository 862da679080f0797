"""The benchmark's methods: which contraction and which graph, run on one cloud and scored."""

import logging
import resource
import time

import numpy as np

from cherrypicker.classes import Label
from cherrypicker.contraction.contract_points import SkeletonOptions
from cherrypicker.contraction.contract_wood import contract_tree, contract_wood
from cherrypicker.errors import StageError
from cherrypicker.geometry.sampling import thin_randomly
from cherrypicker.graph.extract import extract_skeleton
from cherrypicker_lab.skeletons.graph_scores import (
    graph_of,
    radius_errors,
    score_graph,
    score_points,
)

logger = logging.getLogger(__name__)

SETTINGS = ("noise", "holes")
GRAPHS_OF = {"bare_default": ("tree",), "slbc_default": ("mst", "tree")}  # of limbs
OURS = ("lbc_paper", "slbc_paper", *GRAPHS_OF)
TRUNK_WEIGHT = 10.0
START_UP_POINTS = 3000


def measure_cloud(cloud, truth, methods):
    """Run our contractions and the graphs of the default one on a cloud and score them.

    The methods are of `OURS`. The cloud is labelled, in metres; "bare_default" gets it with all of
    its wood labelled branch. Returns by method ``cpu_s``, ``peak_mb`` (of the process so far),
    ``points`` (`score_points`) and, for limbs, ``graphs`` of `GRAPHS_OF` (`score_graph`,
    `radius_errors` as ``radius``, ``cpu_s``).
    """
    report = {}
    for name in methods:
        given = cloud
        if name == "bare_default":
            given = cloud.with_fields(label=np.full(len(cloud), Label.BRANCH, np.uint8))
        start = time.process_time()
        if name in GRAPHS_OF:
            contracted, details = contract_wood(given)
            points = contracted.points
        else:
            points = contract_as_published(cloud, name.removesuffix("_paper"))
        found = {
            "cpu_s": time.process_time() - start,
            "points": score_points(points, truth.skeleton),
        }
        for graph in GRAPHS_OF.get(name, ()):
            scores = _measure_graph(contracted, given, truth, graph, details)
            found.setdefault("graphs", {})[graph] = scores
        found["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        report[name] = found
        logger.info("%s: Chamfer %.2f cm2", name, found["points"]["chamfer_cm2"])
    return report


def start_up(cloud):
    """Run the limbs on a few of the points, which compiles and loads its functions."""
    find_skeleton(cloud.select(thin_randomly(np.arange(len(cloud)), START_UP_POINTS)))


def find_skeleton(cloud, **options):
    """Skeleton of a labelled cloud as the workflow's stages make it, and the contraction's report.

    The options are those of `contract_wood`.
    """
    contracted, report = contract_wood(cloud, **options)
    return extract_skeleton(contracted, cloud, base=report["base"], limbs=report["limbs"]), report


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
    radius = radius_errors(skeleton.points, skeleton.radius, truth)
    return {"cpu_s": cpu_s, **score_graph(graph, truth), "radius": radius}
