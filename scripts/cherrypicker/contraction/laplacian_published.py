"""The linear algebra of the contraction: cotangent Laplacian, semantic weights, one solve."""

import numpy as np
import robust_laplacian
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import splu


def cotangent_laplacian(
    points: np.ndarray, *, n_neighbors: int = 30, mollify_factor: float = 1e-5
) -> tuple[csr_matrix, np.ndarray]:
    """Cotangent Laplacian of points (n_points, 3) from their intrinsic Delaunay triangulations.

    Returns the weak Laplacian L, (n_points, n_points), positive semi-definite (positive diagonal,
    rows sum to 0), and the diagonal of the lumped mass matrix M, (n_points,): the area around each
    point (Sharp and Crane, A Laplacian for Nonmanifold Triangle Meshes, SGP 2020). A point has so
    many neighbours in its local triangulation, fewer in a tiny cloud, and `mollify_factor` is the
    relative length that robust-laplacian adds to degenerate edges. It raises a RuntimeError where
    the triangulation fails.
    """
    n_neighbors = min(n_neighbors, len(points) - 1)
    L, M = robust_laplacian.point_cloud_laplacian(
        np.ascontiguousarray(points, dtype=np.float64),
        mollify_factor=mollify_factor,
        n_neighbors=n_neighbors,
    )
    L = L.tocsr()
    L.sort_indices()
    return L, M.diagonal()


def semantic_row_weights(L: csr_matrix, weights: np.ndarray) -> np.ndarray:
    """Diagonal of the semantic weighting S: one weight a row of L, (n_points,) float64.

    `weights` (n_points,) are the lambdas of the points' classes. A point whose neighbours in L all
    have its class keeps its class's weight; one with a neighbour of another class takes the
    smallest weight among the classes present (the paper's S_ij, which knows two classes, for any
    number of them).
    """
    weights = np.asarray(weights, dtype=np.float64)
    smallest = weights.copy()
    rows = np.repeat(np.arange(len(weights)), np.diff(L.indptr))
    np.minimum.at(smallest, rows, weights[L.indices])
    return smallest


def solve_contraction(
    L: csr_matrix, w_l: np.ndarray, w_h: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Least-squares solution of [W_L L; W_H] C' = [0; W_H C] (paper, Eq. lbc), (n_points, 3).

    The normal equations (L^T W_L^2 L + W_H^2) C' = W_H^2 C are symmetric positive definite, so
    one sparse factorisation without pivoting serves x, y and z. `w_l` and `w_h` (n_points,) are the
    diagonals of S W_L and W_H. SuperLU raises a RuntimeError where it meets a singular matrix; an
    ill-conditioned one may give values that are not finite.
    """
    weighted = diags(w_l) @ L
    A = (weighted.T @ weighted + diags(w_h**2)).tocsc()
    factor = splu(
        A, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    return factor.solve((w_h**2)[:, None] * points)
