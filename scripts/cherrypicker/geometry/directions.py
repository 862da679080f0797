"""Directions: their length, what lies across them, the angle between two, the turn onto z."""

import numpy as np
from numpy.typing import ArrayLike


def unit(vectors: ArrayLike) -> np.ndarray:
    """Scale vectors of shape (..., 3) to length one."""
    vectors = np.asarray(vectors, float)
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)


def angle_deg(a: ArrayLike, b: ArrayLike) -> float:
    """Angle between two vectors in degrees, precise near zero."""
    a, b = unit(a), unit(b)
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def tangent_basis(directions: ArrayLike) -> np.ndarray:
    """Two unit vectors across each direction (..., 3) and each other, (..., 2, 3), right-handed."""
    directions = unit(directions)
    first = unit(np.cross(directions, np.eye(3)[np.argmin(np.abs(directions), axis=-1)]))
    return np.stack([first, np.cross(directions, first)], axis=-2)


def rodrigues(direction: ArrayLike) -> np.ndarray:
    """The smallest rotation of a direction (3,) onto +z, (3, 3), by Rodrigues' formula.

    Of -z the half turn about x. Between axes of the frame all entries are exactly 0, 1 or -1.
    """
    direction = unit(direction)
    axis = np.cross(direction, [0.0, 0.0, 1.0])
    sine, cosine = np.linalg.norm(axis), direction[2]
    if sine < 1e-12:
        return np.diag([1.0, 1.0, 1.0] if cosine > 0 else [1.0, -1.0, -1.0])
    k = np.cross(axis / sine, -np.eye(3))
    return np.eye(3) + sine * k + (1 - cosine) * (k @ k)
