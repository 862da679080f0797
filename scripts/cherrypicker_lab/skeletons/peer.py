"""pc-skeletor, the paper authors' program, run in its own Python on the benchmark's clouds."""

import logging
import os
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.files import read_json
from cherrypicker_lab.skeletons.graph_scores import Graph, score_graph
from cherrypicker_lab.skeletons.methods import TRUNK_WEIGHT
from cherrypicker_lab.skeletons.point_scores import score_points

logger = logging.getLogger(__name__)

RUNNER = Path(__file__).parents[2] / "lab/run_pc_skeletor.py"


def run_peer(python, cloud, method, *, max_iterations=20, own_solve=False):
    """Run the peer on a cloud whose mean it gets at the origin, as our contraction does.

    robust-laplacian's normals depend on the frame (docs/skeleton.md).

    Parameters
    ----------
    python : path-like
        Python of the environment that it is installed in.
    cloud : PointCloud
        Labelled, metres.
    method : {"lbc", "slbc"}
    max_iterations : int, default 20
    own_solve : bool, default False
        S-LBC's solve with its own loop over the entries of a matrix, for small clouds.

    Returns
    -------
    skeleton : dict of str to ndarray
        ``contracted`` (n, 3), ``nodes`` (m, 3), ``edges`` (k, 2).
    report : dict
        ``cpu_s``, ``graph_cpu_s``, ``peak_mb``, ``version``.

    Raises
    ------
    StageError
        If it cannot be started or fails.
    """
    centre = cloud.points.mean(axis=0)
    environment = {**os.environ, "LC_ALL": "C.UTF-8", "OMP_NUM_THREADS": "1"}
    environment.pop("PYTHONPATH", None)
    with tempfile.TemporaryDirectory() as folder:
        paths = {name: Path(folder, name) for name in ("cloud.npz", "skeleton.npz", "report.json")}
        np.savez(
            paths["cloud.npz"], points=cloud.points - centre, labels=np.asarray(cloud["label"])
        )
        command = [
            *(str(python), str(RUNNER), "--method", method, "--weight", str(TRUNK_WEIGHT)),
            *("--max_iterations", str(max_iterations), "--cloud", str(paths["cloud.npz"])),
            *("--skeleton", str(paths["skeleton.npz"]), "--report", str(paths["report.json"])),
        ]
        command += ["--own_solve"] * own_solve
        try:
            done = subprocess.run(
                command, env=environment, capture_output=True, text=True, check=False
            )
        except OSError as error:
            raise StageError(
                f"pc-skeletor's Python cannot be started ({error})",
                file=str(python),
                key="benchmark.skeleton.peer_python",
            ) from error
        if done.returncode:
            last = (done.stderr.strip().splitlines() or ["no message"])[-1]
            raise StageError(f"pc-skeletor fails ({last})", key="benchmark.skeleton.peer_python")
        with np.load(paths["skeleton.npz"], allow_pickle=False) as stored:
            skeleton = {name: stored[name] + centre for name in ("contracted", "nodes")}
            skeleton["edges"] = stored["edges"]
        return skeleton, read_json(paths["report.json"])


def measure_peer(python, cloud, truth, *, keep=None):
    """Run and score both of the peer's methods on a cloud.

    Returns
    -------
    dict
        By method (``peer_lbc``, ``peer_slbc``), as `measure_cloud`; its graph is called ``own``.
    """
    report = {}
    for method in ("lbc", "slbc"):
        skeleton, details = run_peer(python, cloud, method)
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
        if keep is not None:
            keep[f"peer_{method}"] = skeleton["contracted"]
            keep[f"peer_{method}_own"] = nodes[skeleton["edges"]]
        logger.info("peer %s: %.1f CPU s", method, details["cpu_s"])
    return report
