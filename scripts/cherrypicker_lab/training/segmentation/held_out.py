"""The whole stage measured on clouds that the network never saw, as tables.

Generated scenes (held-out seeds of the trained forms; forms that were never trained on) and scans
that came through photos, judged against the surface of their scene.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cherrypicker.classes import CHANNELS, Label
from cherrypicker.errors import StageError
from cherrypicker.files import read_json
from cherrypicker.geometry.neighbors import link_components
from cherrypicker.geometry.similarity import moved
from cherrypicker.placement.footprint import Footprint, read_region
from cherrypicker.pointcloud import PointCloud, read_cloud
from cherrypicker.segmentation.inference import segment_cloud
from cherrypicker.segmentation.known_markers import KnownMarkers, known_markers
from cherrypicker_lab.evaluation import REACH_M, at_surface, cameras_beside_truth
from cherrypicker_lab.tables import markdown_table
from cherrypicker_lab.training.segmentation.metrics import confusion_matrix, scores
from cherrypicker_lab.training.segmentation.scenes import hidden_bark
from cherrypicker_lab.training.segmentation.training import network_labels


@dataclass(frozen=True)
class LabelledCloud:
    """A cloud, its true labels (n_points,) uint8, 255 where unknown, its markers."""

    name: str
    cloud: PointCloud
    truth: np.ndarray
    markers: KnownMarkers | None = None
    region: Footprint | None = None


def of_sample(name, sample):
    """A generated `Sample`.

    As `estimate_scale` would, its markers say where one may stand, though none is solved.
    """
    sample = sample.as_float()
    cloud = PointCloud(sample.points, colors=sample.colors)
    boards = sample.points[sample.labels == Label.MARKER]
    board = link_components(boards, REACH_M)
    places = []
    for number in np.unique(board):
        own = boards[board == number]
        middle = own.mean(axis=0)
        places.append([*middle, np.linalg.norm(own - middle, axis=1).max()])
    markers = KnownMarkers(open_places=np.reshape(places, (-1, 4)))
    return LabelledCloud(name, cloud, sample.labels, markers)


def of_scans(pairs):
    """`of_scan` of each of the texts RESULTS=TRUTH that a script is given.

    Raises a `StageError` if one has no truth, or see `of_scan`.
    """
    clouds = []
    for pair in pairs:
        results, _, truth = pair.partition("=")
        if not truth:
            raise StageError("a scan is given as RESULTS=TRUTH", file=pair, key="--scan")
        clouds.append(of_scan(results, truth))
    return clouds


def of_scan(results, truth):
    """The metric cloud of a scan's results, each point with the class of the nearest surface.

    ``results/{tree}`` has metric.ply, metric_poses.npz, and scale.json and align.json where the
    stage is to know the solved markers, as in the workflow; ``{scene}/truth`` has cloud.ply and
    poses.npz. Raises a `StageError` if a file is missing or broken.
    """
    results, truth = Path(results), Path(truth)
    cloud = read_cloud(results / "metric.ply")
    surface = read_cloud(truth / "cloud.ply", required=("label",))
    surface = surface.select(~hidden_bark(surface.points, surface["label"]))
    points = moved(cloud.points, cameras_beside_truth(results, truth)["frame"])
    labels = at_surface(points, surface.points, surface["label"], Label.UNLABELLED)
    files = [results / "scale.json", results / "align.json"]
    markers = None
    if all(file.is_file() for file in files):
        markers = known_markers(*map(read_json, files))
    metric = results / "metric.json"
    region = read_region(metric if metric.is_file() else None)
    return LabelledCloud(results.name, cloud, labels, markers, region)


def judge(labelled, weights, **settings):
    """Run the stage, `segment_cloud` with its settings, on one cloud and count.

    Returns the confusion matrix, (n_classes, n_classes) int64, and the labels, (n_points,) uint8.
    """
    given = {"markers": labelled.markers, "region": labelled.region}
    labels = segment_cloud(labelled.cloud, weights, **given, **settings)[0]["label"]
    targets = network_labels(labelled.truth)
    known = targets >= 0
    return confusion_matrix(targets[known], network_labels(labels)[known]), labels


def table(confusions):
    """Markdown table: a row a set of clouds, F1 of every class and the mean IoU.

    A class that the truth lacks has a dash in place of an F1. The confusion matrices (n_classes,
    n_classes) are by the name of the set.
    """
    rows = []
    for name, confusion in confusions.items():
        result = scores(confusion)
        cells = [f"{c['f1']:.3f}" if c["n_points"] else "-" for c in result["classes"].values()]
        rows.append([name, f"{result['mean_iou']:.3f}", *cells])
    return markdown_table(["clouds", "mean IoU", *(label.title for label in CHANNELS)], rows)
