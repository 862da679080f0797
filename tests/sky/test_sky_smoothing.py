"""Evening out, the second look at middle brightness, and the scores of bare crowns."""

import numpy as np
import pytest

from cherrypicker.sky.masks import (
    at_middle_brightness,
    even_out,
    photo_probability,
    refine_probability,
)
from cherrypicker.sky.unet import MEAN
from cherrypicker_lab.training.sky.metrics import CrownScores


@pytest.mark.parametrize("mean", [30, 90, 200])
def test_every_exposure_is_brought_to_the_middle(mean):
    flat = np.full((8, 8, 3), mean, np.uint8)
    assert at_middle_brightness(flat).mean() == pytest.approx(255 * MEAN, abs=2)
    black = at_middle_brightness(np.zeros((4, 4, 3), np.uint8))
    assert not black.any()


class Bright:
    """A network that calls sky what is brighter than the middle."""

    stride = 1

    def to(self, **_):
        return self

    def __call__(self, x):
        return 6.0 * x.mean(dim=1, keepdim=True)


def test_the_second_look_finds_the_sky_of_a_dark_photo():
    image = np.full((40, 60, 3), 8, np.uint8)
    image[:20] = 80
    probability = photo_probability(Bright(), image)
    assert probability[:20].min() > probability[20:].max() + 0.2
    same = photo_probability(Bright(), np.full((4, 4, 3), 115, np.uint8))
    assert same == pytest.approx(0.5, abs=0.1)


def test_doubtful_clouds_follow_the_sky_that_they_are_part_of():
    image = np.full((100, 160, 3), 200, np.uint8)
    image[70:] = 40
    probability = np.full((100, 160), 0.95, np.float32)
    probability[40:70, 60:100] = 0.35  # a patch in doubt, with no edge around it
    probability[70:] = 0.05
    even = even_out(image, probability)
    assert even[:68].min() > 0.6 and even[72:].max() < 0.2


def test_colour_makes_ground_only_near_ground():
    """A grey cloud of a road's colour stays sky, a twig of that colour's ground does not."""
    rng = np.random.default_rng(2)
    image = np.full((200, 300, 3), 210, np.uint8)
    image[120:] = 95
    image[20:80, 100:200] = 95  # the cloud
    image = np.clip(image + rng.integers(-4, 5, image.shape), 0, 255).astype(np.uint8)
    probability = np.full((200, 300), 0.97, np.float32)
    probability[120:] = 0.02
    probability[20:80, 100:200] = 0.6
    refined = refine_probability(image, probability, 0.5)
    assert refined[30:70, 110:190].min() > 0.5
    probability[112:120, 50:250] = 0.6  # ground that the network is not sure of
    image[112:120, 50:250] = 95
    assert refine_probability(image, probability, 0.5)[115:120, 60:240].max() < 0.5


def test_crown_scores_of_a_known_crown():
    exact = np.ones((60, 60), bool)
    exact[:, 30:33] = False  # a twig 3 px wide
    exact[45:] = False  # the ground is no twig
    mask = exact.copy()
    mask[:10, 30:33] = True  # lost for 10 of 45 rows
    mask[20:25, 26:30] = False  # part of the gap beside it is not found
    scores = CrownScores()
    scores.add(mask, exact)
    summary = scores.summary()
    assert summary["twigs_called_sky"] == pytest.approx(10 / 45, abs=0.03)
    assert summary["n_twig_pixels"] == pytest.approx(3 * 45, abs=9)
    assert summary["gap_recall"] == pytest.approx(1 - 20 / (8 * 45), abs=0.02)
    assert CrownScores().summary()["gap_recall"] == 1.0
