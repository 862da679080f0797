"""Lines: places on polylines and which way they run; where rays come nearest to one another."""

import numpy as np

N_SAMPLES = 12  # of a stretch whose direction is taken
NEAR = 1e-9  # lengths below this are none, and a determinant: of rays that are parallel


class Line:
    """A polyline (n, 3), and the way along it, or another number that grows from node to node."""

    def __init__(self, points: np.ndarray, along: np.ndarray | None = None) -> None:
        if along is None:
            steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
            along = np.append(0.0, np.cumsum(steps))
        self.points, self.along = points, along

    def at(self, places: np.ndarray | float) -> np.ndarray:
        """Points at places along it, (..., 3); its ends beyond them."""
        return np.stack([np.interp(places, self.along, axis) for axis in self.points.T], axis=-1)

    def direction(self, low: float, high: float) -> np.ndarray:
        """Unit direction over a stretch: a line fitted to even samples of it; up for none."""
        start, end = self.along[0], self.along[-1]
        if end <= start:
            return np.array([0.0, 0.0, 1.0])
        low, high = max(low, start), min(high, end)
        if high - low < NEAR:
            low, high = start, end
        places = np.linspace(low, high, N_SAMPLES)
        samples, offset = self.at(places), places - places.mean()
        slope = offset @ samples / (offset @ offset)
        if np.linalg.norm(slope) < NEAR:  # it comes back to where it started
            slope = samples[-1] - samples[0]
        return slope / max(float(np.linalg.norm(slope)), 1e-12)


def intersect_rays(
    origins: np.ndarray, directions: np.ndarray, weights: np.ndarray | float = 1.0
) -> np.ndarray:
    """Point (..., 3) with the least (weighted) sum of squared distances to lines (..., n, 3).

    Solves ``sum_j w_j (I - u_j u_j^T) (x - t_j) = 0`` (paper, eq. objective). Directions are unit
    vectors, a row of NaN is no line. NaN where fewer than two lines are, or all are parallel.
    """
    weights = np.where(np.isfinite(directions[..., 0]), weights, 0.0)
    directions = np.nan_to_num(directions)
    projectors = np.eye(3) - directions[..., :, None] * directions[..., None, :]
    projectors *= weights[..., None, None]
    left = projectors.sum(axis=-3)
    right = np.einsum("...nij,...nj->...i", projectors, origins)
    size = np.trace(left, axis1=-2, axis2=-1)[..., None, None]
    is_open = np.abs(np.linalg.det(left / np.where(size > 0, size, 1.0))) < NEAR
    left = np.where(is_open[..., None, None], np.eye(3), left)
    point = np.linalg.solve(left, right[..., None])[..., 0]
    return np.where(is_open[..., None], np.nan, point)
