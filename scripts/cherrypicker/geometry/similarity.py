"""Turn, shift and scale that bring points onto others with the least squares."""

import numpy as np


def best_turn(covariance: np.ndarray) -> tuple[np.ndarray, float]:
    """Rotation R with the largest trace of R^T C, never a mirror (Kabsch 1976; Umeyama 1991).

    C, (3, 3), is the sum of w b a^T over pairs of a point a and its target b, both from their
    middles; R turns the points towards the targets. With R, (3, 3), comes that trace: over the sum
    of w |a|^2 it is the scale of the best similarity.
    """
    left, singular, right = np.linalg.svd(covariance)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right)) or 1.0])
    return left * sign @ right, float(singular @ sign)


def fit_similarity(
    source: np.ndarray, target: np.ndarray
) -> tuple[float, np.ndarray, float, float]:
    """Scale s and turn R, (3, 3), of the similarity ``s R x + t`` of points (n, 3) onto others.

    By least squares (Umeyama 1991). With them come what it leaves, root mean square, and the size
    of the source: the root of the summed squared distances from the middle.
    """
    source, target = source - source.mean(axis=0), target - target.mean(axis=0)
    rotation, gain = best_turn(target.T @ source)
    spread = max(float(np.square(source).sum()), 1e-12)
    scale = gain / spread
    left = np.square(target - scale * source @ rotation.T).sum(axis=1)
    return scale, rotation, float(np.sqrt(left.mean())), float(np.sqrt(spread))


def fit_rigid(source: np.ndarray, target: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Turn and shift, (4, 4), that bring points (n, 3) onto others by weighted least squares."""
    weight = weight / max(weight.sum(), 1e-12)
    here, there = weight @ source, weight @ target
    matrix = np.eye(4)
    matrix[:3, :3], _ = best_turn((target - there).T @ (weight[:, None] * (source - here)))
    matrix[:3, 3] = there - matrix[:3, :3] @ here
    return matrix


def moved(points: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Points (..., 3) in another frame; `frame` has shape (4, 4)."""
    return points @ frame[:3, :3].T + frame[:3, 3]
