"""Directions: their length, what lies across them, the angle between two and the turn onto one."""

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


def rodrigues(source: ArrayLike, destination: ArrayLike) -> np.ndarray:
    """Rotation of the unit vector `source` onto `destination` by Rodrigues' formula.

    Parameters
    ----------
    source, destination : array-like of shape (3,)

    Returns
    -------
    ndarray of shape (3, 3)
        The smallest rotation; for opposite vectors a half turn about an axis orthogonal to both,
        of -z onto z about x. Between axes of the frame all entries are exactly 0, 1 or -1.
    """
    source, destination = unit(source), unit(destination)
    axis = np.cross(source, destination)
    sine, cosine = np.linalg.norm(axis), float(source @ destination)
    if sine < 1e-12:
        if cosine > 0:
            return np.eye(3)
        axis = tangent_basis(source)[1]
        return 2 * np.outer(axis, axis) - np.eye(3)
    k = np.cross(axis / sine, -np.eye(3))
    return np.eye(3) + sine * k + (1 - cosine) * (k @ k)
