"""Other programs, each run in its own Python on the benchmark's clouds: pc-skeletor, PyTLidar."""

import logging
import os
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.files import read_json
from cherrypicker_lab.skeletons.cylinders import graph_of_cylinders, places_on_cylinders
from cherrypicker_lab.skeletons.graph_scores import (
    Graph,
    radius_errors,
    score_graph,
    score_points,
)
from cherrypicker_lab.skeletons.methods import TRUNK_WEIGHT

logger = logging.getLogger(__name__)

RUNNER = Path(__file__).parents[2] / "lab/run_pc_skeletor.py"
PYTLIDAR_RUNNER = RUNNER.with_name("run_pytlidar.py")
SAMPLE_M = 0.005  # places along cylinders, as the true skeleton is sampled


class PeerFailedError(StageError):
    """Another program was started and gave no result; what it said is the cause."""


def _call(python, runner, arguments, *, program, key):
    """Run a program's runner in its own Python; a failure names the program and the key."""
    environment = {**os.environ, "LC_ALL": "C.UTF-8", "OMP_NUM_THREADS": "1"}
    environment.pop("PYTHONPATH", None)
    command = [str(part) for part in (python, runner, *arguments)]
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    except OSError as error:
        raise StageError(
            f"{program}'s Python cannot be started ({error})", file=str(python), key=key
        ) from error
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise PeerFailedError(f"{program} fails ({last})", key=key)


def run_peer(python, cloud, method, *, max_iterations=20, own_solve=False):
    """Run the peer, "lbc" or "slbc", on a labelled cloud, metres, in the Python that it stands in.

    The cloud's mean lies at the origin, as our contraction has it: robust-laplacian's normals
    depend on the frame (docs/lab/skeleton.md). `own_solve` takes S-LBC's solve with its own loop
    over the entries of a matrix, for small clouds.

    Returns ``contracted`` (n, 3), ``nodes`` (m, 3), ``edges`` (k, 2), and a report with ``cpu_s``,
    ``graph_cpu_s``, ``peak_mb``, ``version``. Raises a `StageError` if it cannot be started or
    fails.
    """
    centre = cloud.points.mean(axis=0)
    with tempfile.TemporaryDirectory() as folder:
        paths = {name: Path(folder, name) for name in ("cloud.npz", "skeleton.npz", "report.json")}
        np.savez(
            paths["cloud.npz"], points=cloud.points - centre, labels=np.asarray(cloud["label"])
        )
        arguments = [
            *("--method", method, "--weight", TRUNK_WEIGHT, "--max_iterations", max_iterations),
            *("--cloud", paths["cloud.npz"]),
            *("--skeleton", paths["skeleton.npz"], "--report", paths["report.json"]),
        ]
        arguments += ["--own_solve"] * own_solve
        key = "benchmark.skeleton.peer_python"
        _call(python, RUNNER, arguments, program="pc-skeletor", key=key)
        with np.load(paths["skeleton.npz"], allow_pickle=False) as stored:
            skeleton = {name: stored[name] + centre for name in ("contracted", "nodes")}
            skeleton["edges"] = stored["edges"]
        return skeleton, read_json(paths["report.json"])


def measure_peer(python, cloud, truth):
    """Run and score both of the peer's methods on a cloud.

    Returns by method (``peer_lbc``, ``peer_slbc``) what `measure_cloud` does; its graph is called
    ``own``. A method that fails on this cloud has ``failed`` alone, its last words. Raises a
    `StageError` if it cannot be started, or both methods fail.
    """
    report = {}
    for method in ("lbc", "slbc"):
        try:
            skeleton, details = run_peer(python, cloud, method)
        except PeerFailedError as error:
            if method == "slbc" and "failed" in report["peer_lbc"]:
                raise
            logger.warning("%s: %s", method, error.cause)
            report[f"peer_{method}"] = {"failed": error.cause}
            continue
        # its graph has no root: the node nearest to the true foot stands for one
        nodes, foot = skeleton["nodes"], truth.skeleton.points[0]
        root = int(np.argmin(np.linalg.norm(nodes - foot, axis=1)))
        graph = Graph(nodes, skeleton["edges"], root)
        report[f"peer_{method}"] = {
            "cpu_s": details["cpu_s"],
            "peak_mb": details["peak_mb"],
            "version": details["version"],
            "points": score_points(skeleton["contracted"], truth.skeleton),
            "graphs": {"own": {"cpu_s": details["graph_cpu_s"], **score_graph(graph, truth)}},
        }
        logger.info("peer %s: %.1f CPU s", method, details["cpu_s"])
    return report


def run_pytlidar(python, cloud):
    """Run PyTLidar, in the Python that it stands in, on a cloud of wood, metres, z up.

    It estimates the sizes of patches itself; labels are not looked at. Returns the cylinders'
    ``start``, ``end`` (n, 3), ``radius``, ``parent`` (-1 for the first), ``branch`` (n,), and a
    report with ``cpu_s``, ``peak_mb``, ``version``, ``patches_m``. Raises a `StageError` if it
    cannot be started or fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder, name) for name in ("cloud.npz", "cylinders.npz", "report.json")]
        np.savez(paths[0], points=cloud.points)
        arguments = ["--cloud", paths[0], "--cylinders", paths[1], "--report", paths[2]]
        key = "benchmark.skeleton.pytlidar_python"
        _call(python, PYTLIDAR_RUNNER, arguments, program="PyTLidar", key=key)
        with np.load(paths[1], allow_pickle=False) as stored:
            cylinders = {name: stored[name] for name in stored.files}
        return cylinders, read_json(paths[2])


def measure_pytlidar(python, cloud, truth):
    """Run PyTLidar on a cloud and score the axes and radii of its cylinders.

    Returns ``peer_pytlidar`` as `measure_peer`, with `radius_errors`; its points lie on its axes.
    """
    cylinders, details = run_pytlidar(python, cloud)
    graph = graph_of_cylinders(cylinders)
    places, radius = places_on_cylinders(cylinders, SAMPLE_M)
    logger.info("PyTLidar: %.1f CPU s", details["cpu_s"])
    scores = score_graph(graph, truth) | {"radius": radius_errors(places, radius, truth)}
    found = {name: details[name] for name in ("cpu_s", "peak_mb", "version", "patches_m")}
    found["points"] = score_points(places, truth.skeleton)
    found["graphs"] = {"own": {"cpu_s": 0.0, **scores}}
    return {"peer_pytlidar": found}
