"""Random training samples from photos with masks.

The paper augments by scaling, translation and elastic transform. Added here: flips, exposure,
colour, blur and compression, exchanged skies, and bare branches drawn over the photo.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from cherrypicker_lab.training.sky.data import SkyPhoto
from cherrypicker_lab.training.sky.orchards import random_orchard
from cherrypicker_lab.training.sky.synthesis import fractal_noise, random_branches, random_sky

#: Pixels with at least this much wood are labelled not-sky. Below one half on purpose: a twig
#: thinner than a pixel still spoils the depth and the colour of a point seen there.
TWIG_COVER = 0.35
#: Share of the drawn orchards that stand before a drawn sky, the others stand before the photo.
DRAWN_SKIES = 0.5


@dataclass(frozen=True)
class AugmentOptions:
    """Strength of the augmentation; the fields are config keys of ``train_sky``."""

    scale_range: tuple[float, float] = (0.5, 1.6)  # enlargement of the photo
    elastic_px: float = 4.0  # standard deviation of the elastic displacement, px of the sample
    # Shares of samples with drawn branches, an exchanged sky, colour changes, a drawn orchard
    branch_fraction: float = 0.45
    exchange_fraction: float = 0.35
    color_fraction: float = 0.9
    orchard_fraction: float = 0.0


def _coordinates(
    rng: np.random.Generator, shape: tuple[int, int], size: int, options: AugmentOptions
) -> tuple[np.ndarray, np.ndarray]:
    """Source coordinates of each sample pixel: scale, turn, flip, shift and elastic transform."""
    height, width = shape
    low, high = options.scale_range
    scale = np.exp(rng.uniform(np.log(low), np.log(high)))
    # A sample never spans more than the photo, else its border is mostly reflections.
    scale = max(scale, size / (1.25 * min(height, width)))
    angle = rng.normal(0, np.radians(6.0))
    if rng.random() < 0.06:
        angle += rng.choice([-1, 1]) * np.pi / 2
    span = size / scale
    centre_x = rng.uniform(min(span, width) / 2, width - min(span, width) / 2)
    centre_y = rng.uniform(min(span, height) / 2, height - min(span, height) / 2)
    x, y = np.meshgrid(np.arange(size), np.arange(size))
    x = (x - size / 2).astype(np.float32)
    y = (y - size / 2).astype(np.float32)
    if options.elastic_px > 0:
        x += options.elastic_px * 3.4 * (fractal_noise(rng, (size, size), 3) - 0.5)
        y += options.elastic_px * 3.4 * (fractal_noise(rng, (size, size), 3) - 0.5)
    if rng.random() < 0.5:
        x = -x
    cos, sin = np.cos(angle) / scale, np.sin(angle) / scale
    map_x = cos * x - sin * y + centre_x
    map_y = sin * x + cos * y + centre_y
    return map_x.astype(np.float32), map_y.astype(np.float32)


def _recolor(rng: np.random.Generator, image: np.ndarray) -> np.ndarray:
    """Exposure, white balance, contrast, gamma, grey, as a camera or another day would."""
    image = image * np.exp(rng.normal(0, 0.3))
    image = image * np.exp(rng.normal(0, 0.07, 3)).astype(np.float32)
    grey = image.mean(axis=2, keepdims=True)
    image = grey + (image - grey) * rng.uniform(0.3, 1.6)
    image = np.clip(image, 0, 1) ** np.exp(rng.normal(0, 0.2))
    middle = image.mean()
    return np.clip(middle + (image - middle) * np.exp(rng.normal(0, 0.15)), 0, 1)


def _degrade(rng: np.random.Generator, image: np.ndarray) -> np.ndarray:
    """Blur, noise and compression; returns uint8."""
    if rng.random() < 0.3:
        image = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.3, 1.5))
    if rng.random() < 0.5:
        noise = rng.standard_normal(image.shape, dtype=np.float32)
        image = image + np.float32(rng.uniform(0.003, 0.04)) * noise
    pixels = (np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)
    if rng.random() < 0.4:
        quality = int(rng.integers(35, 95))
        coded = cv2.imencode(".jpg", pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        pixels = cv2.imdecode(coded, cv2.IMREAD_COLOR)[..., ::-1]
    return pixels


def draw_sample(
    photo: SkyPhoto, size: int, options: AugmentOptions, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Make one random training sample from a photo.

    Returns the image (size, size, 3) uint8, the sky (size, size) float32, 1 sky and 0 not, and its
    weight, of the same shape and type, 0 where the label is doubtful.
    """
    map_x, map_y = _coordinates(rng, photo.sky.shape, size, options)

    def warp(array, how):
        return cv2.remap(array, map_x, map_y, how, borderMode=cv2.BORDER_REFLECT_101)

    image = warp(photo.image, cv2.INTER_LINEAR).astype(np.float32) / 255
    sky = (warp(photo.sky.astype(np.float32), cv2.INTER_LINEAR) > 0.5).astype(np.float32)
    weight = (warp(photo.certain.astype(np.uint8), cv2.INTER_NEAREST) > 0).astype(np.float32)
    is_orchard = rng.random() < options.orchard_fraction
    if rng.random() < (DRAWN_SKIES if is_orchard else options.exchange_fraction):
        if is_orchard or rng.random() < 0.25:  # nothing but sky: a crown seen from below
            sky, weight = np.ones_like(sky), np.ones_like(weight)
            image = random_sky(rng, sky.shape)
        elif sky.any():
            # Doubtful pixels would keep the old sky's colour, so they get the new one as well.
            soft = cv2.GaussianBlur(np.maximum(sky, 1 - weight), (0, 0), 0.6)[..., None]
            image = image * (1 - soft) + random_sky(rng, sky.shape) * soft
    elif rng.random() < 0.15:  # over-exposed walls and ground, which are not sky either
        gain = np.where(sky[..., None] > 0, 1.0, rng.uniform(1.3, 3.0)).astype(np.float32)
        image = np.clip(image * gain, 0, 1)
    if is_orchard or rng.random() < options.branch_fraction:
        draw = random_orchard if is_orchard else random_branches
        image, cover = draw(rng, image)
        sky = np.where(cover > TWIG_COVER, 0, sky).astype(np.float32)
        weight = np.where(cover > 0.5, 1, weight).astype(np.float32)
    if rng.random() < options.color_fraction:
        image = _recolor(rng, image)
    return _degrade(rng, image.astype(np.float32)), sky, weight
