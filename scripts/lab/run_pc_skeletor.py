"""Contract a labelled cloud with pc-skeletor, the paper authors' program, and take its graph.

Runs in that program's own Python (docs/lab/skeleton.md makes one), so it imports nothing of
this project. Reads points and labels from an NPZ file; writes the contracted points and the graph's
nodes and edges as NPZ, and what they cost as JSON. Example:

    PEER/bin/python scripts/lab/run_pc_skeletor.py --cloud cloud.npz --method slbc --weight 10 \
        --skeleton skeleton.npz --report report.json
"""

import argparse
import json
import resource
import time
from importlib.metadata import version

import numpy as np
import open3d
from scipy import sparse
from scipy.sparse.linalg import spsolve

TRUNK = 1


def cloud_of(points):
    """Return Open3D's cloud of points, shape (N, 3)."""
    return open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))


def row_scaled(contraction):
    """Return S-LBC's solve with its loop over the entries of S as one scaling of rows.

    The same numbers: rows of L without an entry in a column past the trunk's are multiplied by the
    weight. The loop takes minutes on clouds that the rest takes seconds for.
    """
    n_trunk = len(contraction.trunk.points)

    def solve(pcd_points, L, laplacian_weighting, positional_weighting):
        rows, columns = L.nonzero()
        scale = np.full(L.shape[0], float(contraction.semantic_weighting))
        scale[rows[columns > n_trunk]] = 1.0
        weighted = sparse.diags(scale * laplacian_weighting) @ L
        WH = sparse.diags(positional_weighting)
        A = sparse.vstack([weighted, WH]).tocsc()
        b = np.vstack([np.zeros((len(pcd_points), 3)), WH.dot(pcd_points)])
        normal = A.T @ A
        columns = [spsolve(normal, A.T @ b[:, axis], permc_spec="COLAMD") for axis in range(3)]
        return np.vstack(columns).T

    return solve


def contract(points, labels, method, weight, max_iterations, own_solve):
    """Return the contraction that has run, and its CPU seconds."""
    from pc_skeletor import LBC, SLBC  # here, so that --help works without it

    options = {"filter_nb_neighbors": 0, "max_iteration_steps": max_iterations}
    if method == "lbc":
        contraction = LBC(cloud_of(points), **options)
    else:
        parts = {"trunk": points[labels == TRUNK], "branches": points[labels != TRUNK]}
        clouds = {name: cloud_of(part) for name, part in parts.items()}
        contraction = SLBC(clouds, semantic_weighting=weight, **options)
        if not own_solve:
            contraction.contraction_type = row_scaled(contraction)
    start = time.process_time()
    contraction.extract_skeleton()
    return contraction, time.process_time() - start


def main(cloud, method, weight, skeleton, report, max_iterations, own_solve):
    """Load, contract, take the graph, save."""
    with np.load(cloud, allow_pickle=False) as stored:
        points, labels = stored["points"].astype(np.float64), stored["labels"]
    contraction, cpu_s = contract(points, labels, method, weight, max_iterations, own_solve)
    contracted = np.asarray(contraction.contracted_point_cloud.points).copy()
    start = time.process_time()
    contraction.extract_topology()
    graph = contraction.skeleton_graph
    ids = {node: row for row, node in enumerate(graph.nodes)}
    nodes = np.array([graph.nodes[node]["pos"] for node in graph.nodes])
    edges = np.array([[ids[a], ids[b]] for a, b in graph.edges], dtype=np.int64)
    np.savez(skeleton, contracted=contracted, nodes=nodes, edges=edges)
    details = {
        "version": version("pc-skeletor"),
        "method": method,
        "n_points": len(points),
        "cpu_s": cpu_s,
        "graph_cpu_s": time.process_time() - start,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }
    with open(report, "w", encoding="utf-8") as stream:
        json.dump(details, stream, indent=2)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cloud", required=True, help="NPZ with points (N, 3) and labels (N,)")
    parser.add_argument("--method", choices=["lbc", "slbc"], required=True)
    parser.add_argument("--weight", type=float, default=10.0, help="lambda of the trunk")
    parser.add_argument("--max_iterations", type=int, default=20)
    parser.add_argument("--own_solve", action="store_true", help="S-LBC's solve with its loop")
    parser.add_argument("--skeleton", required=True, help="NPZ to write")
    parser.add_argument("--report", required=True, help="JSON to write")
    main(**vars(parser.parse_args()))
