"""What the photos say about points: twigs, fringes, paint, masks that lost the twigs."""

import functools
from dataclasses import replace

import cv2
import numpy as np
import pytest
from sky_scene import PAINT, SKIES, STEM, TWIG, colored_as_sky, draw, pinhole, ring, without_twigs

from cherrypicker.denoising.evidence import (
    AWAY,
    CLEAR,
    SOLID,
    EvidenceOptions,
    photo_evidence,
    sky_evidence,
    thin_structures,
)
from cherrypicker.pointcloud import PointCloud

POSES = ring()
OPTIONS = EvidenceOptions()
MASKS = {
    "exact": lambda mask: mask,
    "twigs lost": without_twigs,
}


@functools.cache
def photo(i, rods, sky):
    """Photo of the ring and its exact mask, drawn once."""
    return draw(POSES, i, rods, sky)


def share(cloud, sky, mask="exact", options=OPTIONS, rods=(TWIG, STEM)):
    """Share of the photos that speak for each point, of those that say anything; 1 without any."""

    def look(i):
        image, free = photo(i, rods, sky)
        return image, MASKS[mask](free), np.zeros_like(free)

    seen = sky_evidence(cloud.points, POSES, pinhole(POSES), look, options)
    n_seen = seen.n_solid + seen.n_clear
    return np.where(n_seen > 0, seen.n_solid / np.maximum(n_seen, 1), 1.0)


@pytest.mark.parametrize("mask", ["exact", "twigs lost"])
@pytest.mark.parametrize("sky", SKIES)
def test_twigs_of_sky_color_are_told_from_their_fringe(sky, mask):
    rng = np.random.default_rng(0)
    twig = colored_as_sky(POSES, TWIG.surface(400, rng), sky)
    fringe = colored_as_sky(POSES, TWIG.surface(5000, rng, off=0.012), sky)
    assert np.mean(share(twig, sky, mask) >= 0.7) > 0.99
    assert np.mean(share(fringe, sky, mask) < 0.7) > 0.9


@pytest.mark.parametrize("sky", SKIES)
def test_white_paint_stays_before_any_sky(sky):
    points = STEM.surface(20_000, np.random.default_rng(1))
    paint = PointCloud(points, np.tile(PAINT, (len(points), 1)))
    assert np.mean(share(paint, sky) >= 0.7) > 0.95


@pytest.mark.parametrize(
    "color", [(0.72, 0.74, 0.66), (0.80, 0.60, 0.36)], ids=["lichen", "sunlit"]
)
@pytest.mark.parametrize("sky", SKIES)
def test_light_twigs_stay_before_any_sky(sky, color):
    twig = replace(TWIG, color=color)
    cloud = colored_as_sky(POSES, TWIG.surface(400, np.random.default_rng(0)), sky)
    assert np.mean(share(cloud, sky, "twigs lost", rods=(twig, STEM)) >= 0.7) > 0.95


def test_a_mask_without_twigs_needs_the_photos_contrast():
    twig = colored_as_sky(POSES, TWIG.surface(200, np.random.default_rng(0)), "overcast")
    blind = replace(OPTIONS, twig_contrast=0.0)
    assert np.mean(share(twig, "overcast", "twigs lost", blind) >= 0.7) < 0.1
    assert np.mean(share(twig, "overcast", "exact", blind) >= 0.7) > 0.95


def test_without_clearance_the_cloud_s_error_costs_twigs():
    rng = np.random.default_rng(3)
    twig = colored_as_sky(POSES, TWIG.surface(400, rng, off=0.0015), "clear")
    strict = replace(OPTIONS, sky_clearance_px=0, twig_contrast=0.0)
    tolerant = replace(strict, sky_clearance_px=1)
    assert np.mean(share(twig, "clear", options=strict) >= 0.7) < 0.5
    assert np.mean(share(twig, "clear", options=tolerant) >= 0.7) > 0.95


def test_larger_photos_say_the_same():
    rng = np.random.default_rng(4)
    points = np.vstack([TWIG.surface(200, rng), TWIG.surface(200, rng, off=0.012)])

    def look(i):
        image, free = photo(i, (TWIG, STEM), "overcast")
        return image, free, np.zeros_like(free)

    def large(i):
        return tuple(np.repeat(np.repeat(each, 3, 0), 3, 1) for each in look(i))

    flat = pinhole(POSES)
    small = sky_evidence(points, POSES, flat, look, OPTIONS)
    options = replace(OPTIONS, max_image_size_px=373)  # times 1.5: the small photo's 560
    same = sky_evidence(points, POSES, lambda i, x: 3 * flat(i, x), large, options)
    for name in ("n_clear", "n_solid"):
        np.testing.assert_array_equal(getattr(small, name), getattr(same, name))


def test_noise_and_soft_clouds_are_no_twigs():
    rng = np.random.default_rng(5)
    clouds = cv2.GaussianBlur(rng.normal(0, 1, (300, 300)), (0, 0), 12)
    clouds = 200 + 40 * clouds / np.abs(clouds).max()
    all_sky = np.ones((300, 300), bool)
    for noise in (0.0, 3.0, 10.0):
        blue = np.clip(clouds + rng.normal(0, noise, clouds.shape), 0, 255)
        image = np.repeat(np.rint(blue).astype(np.uint8)[..., None], 3, axis=2)
        assert thin_structures(image, all_sky, 0.05).mean() < 0.02
        image[:, 150:152] -= 60
        assert thin_structures(image, all_sky, 0.05)[:, 150:152].mean() > 0.95


def test_the_blur_beside_a_twig_is_no_twig():
    image = np.full((80, 80), 230.0)
    image[:, 40:43] = 40
    image = np.rint(cv2.GaussianBlur(image, (0, 0), 1.5)).astype(np.uint8)
    thin = thin_structures(np.repeat(image[..., None], 3, axis=2), image > 220, 0.05)
    assert thin[:, 39:44].all() and not thin[:, :37].any() and not thin[:, 46:].any()


def test_kinds_of_pixels():
    sky = np.zeros((60, 60), bool)
    sky[:30] = True
    sky[10, 20] = False
    image = np.full((60, 60, 3), 200, np.uint8)
    kind, same = photo_evidence(image, sky, OPTIONS)
    assert np.array_equal(same, image)
    assert (kind[:28, 30:] == CLEAR).all() and (kind[9:12, 19:22] == SOLID).all()
    assert (kind[29:36] == SOLID).all() and (kind[36:] == AWAY).all()
    none, _ = photo_evidence(image, np.zeros_like(sky), OPTIONS)
    assert (none == AWAY).all()
