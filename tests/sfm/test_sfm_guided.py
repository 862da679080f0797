"""Guided matching on points whose geometry is known."""

import numpy as np
import pycolmap
import pytest

from cherrypicker.sfm.guided import PhotoFeatures, guided_matches

FOCAL = 500.0
CAMERA = pycolmap.Camera.create_from_model_name(1, "SIMPLE_PINHOLE", FOCAL, 640, 640)
CONFIG = pycolmap.TwoViewGeometryConfiguration


def unit_bytes(values):
    return np.rint(512 * values / np.linalg.norm(values, axis=1, keepdims=True)).astype(np.uint8)


def photo(points, descriptors):
    rays = FOCAL * points[:, :2] / points[:, 2:]
    return PhotoFeatures(CAMERA, rays + 320.0, np.ascontiguousarray(rays), descriptors)


@pytest.fixture
def views():
    """Two views of points of which every two look the same, and the true E."""
    rng = np.random.default_rng(0)
    points = rng.uniform([-1, -1, 4], [1, 1, 6], (200, 3))
    looks = unit_bytes(np.abs(rng.normal(size=(100, 128))).repeat(2, axis=0))
    shift = np.array([-0.6, 0.1, 0.05])
    order = rng.permutation(200)
    E = np.cross(np.eye(3), shift)  # [t]x for the translation x2 = x1 + shift
    E = np.array([[0, -shift[2], shift[1]], [shift[2], 0, -shift[0]], [-shift[1], shift[0], 0]])
    return photo(points, looks), photo((points + shift)[order], looks[order]), E, order


def geometry_of(config, **matrices):
    geometry = pycolmap.TwoViewGeometry()
    geometry.config = config
    for name, matrix in matrices.items():
        setattr(geometry, name, matrix)
    return geometry


OPTIONS = {"max_error_px": 2.0, "max_ratio": 0.8}


def check(matches, order, least):
    assert len(matches) >= least
    assert (order[matches[:, 1]] == matches[:, 0]).mean() > 0.97
    assert len(set(matches[:, 0])) == len(set(matches[:, 1])) == len(matches)


def test_calibrated_pair_tells_twins_apart(views):
    first, second, E, order = views
    matches = guided_matches(first, second, geometry_of(CONFIG.CALIBRATED, E=E), **OPTIONS)
    check(matches, order, 150)


def test_uncalibrated_pair_works_on_pixels(views):
    first, second, E, order = views
    K_inverse = np.linalg.inv(np.array([[FOCAL, 0, 320], [0, FOCAL, 320], [0, 0, 1.0]]))
    F = K_inverse.T @ E @ K_inverse
    matches = guided_matches(first, second, geometry_of(CONFIG.UNCALIBRATED, F=F), **OPTIONS)
    check(matches, order, 150)


def test_planar_pair_uses_the_homography():
    rng = np.random.default_rng(2)
    pixels = rng.uniform(0, 600, (150, 2))
    H = np.array([[0.9, 0.1, 20], [-0.05, 1.1, -10], [1e-4, 0, 1]])
    moved = np.column_stack([pixels, np.ones(150)]) @ H.T
    moved = moved[:, :2] / moved[:, 2:]
    looks = unit_bytes(np.abs(rng.normal(size=(75, 128))).repeat(2, axis=0))
    first = PhotoFeatures(CAMERA, pixels, pixels, looks)
    second = PhotoFeatures(CAMERA, moved, moved, looks)
    matches = guided_matches(first, second, geometry_of(CONFIG.PLANAR, H=H), **OPTIONS)
    assert len(matches) == 150
    assert (matches[:, 0] == matches[:, 1]).all()


def test_degenerate_pair_gives_nothing(views):
    first, second, _, _ = views
    matches = guided_matches(first, second, geometry_of(CONFIG.DEGENERATE), **OPTIONS)
    assert matches.shape == (0, 2)
