"""Agreement of sky masks with reference masks."""

from __future__ import annotations

import cv2
import numpy as np

#: Something before the sky narrower than this is a twig; sky this near to one is a gap; pixels.
TWIG_PX, GAP_PX = 7, 4


class CrownScores:
    """How masks fare in bare crowns before the sky, by pixel counts over any number of photos."""

    def __init__(self) -> None:
        self.counts = np.zeros(4, np.int64)

    def add(self, mask: np.ndarray, exact: np.ndarray) -> None:
        """Add one photo: its mask and the exact one, (H, W) bool, True = sky."""
        other = (~exact).astype(np.uint8)
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (TWIG_PX, TWIG_PX))
        square = np.ones((2 * GAP_PX + 1, 2 * GAP_PX + 1), np.uint8)
        is_thin = (other > 0) & (cv2.morphologyEx(other, cv2.MORPH_OPEN, disc) == 0)
        twigs = is_thin & (cv2.dilate(exact.astype(np.uint8), square) > 0)
        gaps = exact & (cv2.dilate(twigs.astype(np.uint8), square) > 0)
        found = [mask & gaps, gaps, mask & twigs, twigs]
        self.counts += [np.count_nonzero(part) for part in found]

    def summary(self) -> dict[str, float]:
        """Return ``gap_recall``, ``twigs_called_sky`` (shares) and the counts of both."""
        found, gaps, wrong, twigs = self.counts.tolist()
        return {
            "gap_recall": found / gaps if gaps else 1.0,
            "twigs_called_sky": wrong / twigs if twigs else 0.0,
            "n_gap_pixels": gaps,
            "n_twig_pixels": twigs,
        }


class Confusion:
    """Pixel counts of sky and ground over any number of masks.

    Both F1 scores follow from the counts over all pixels, not from a mean over photos. The Dice
    coefficient of the sky is the same number as its F1; the paper's "DICE loss 0.830" is ambiguous,
    so the soft Dice of the probabilities is kept beside it.
    """

    def __init__(self) -> None:
        self.counts = np.zeros((2, 2), np.int64)
        self._soft = np.zeros(2)

    def add(self, probability: np.ndarray, sky: np.ndarray) -> None:
        """Add a photo's probability, (H, W) float in [0, 1], and its reference, (H, W) bool."""
        probability = np.asarray(probability, np.float64)
        sky = np.asarray(sky, bool)
        found = probability > 0.5
        pair = 2 * sky.astype(np.int64) + found
        self.counts += np.bincount(pair.ravel(), minlength=4).reshape(2, 2)
        self._soft += 2 * probability[sky].sum(), probability.sum() + sky.sum()

    def summary(self) -> dict[str, float]:
        """Return ``f1_sky``, ``f1_ground``, ``dice_soft``, ``accuracy``; 1 where both are empty."""
        (ground, wrong_sky), (missed, sky) = self.counts.tolist()

        def ratio(a: float, b: float) -> float:
            return float(a) / float(b) if b else 1.0

        return {
            "f1_sky": ratio(2 * sky, 2 * sky + wrong_sky + missed),
            "f1_ground": ratio(2 * ground, 2 * ground + wrong_sky + missed),
            "dice_soft": ratio(*self._soft),
            "accuracy": ratio(ground + sky, self.counts.sum()),
        }
