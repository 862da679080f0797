"""Sky masks as files: PNG with one channel, in the pixels of the photo as stored.

255 is sky, 0 is not, and `HIDDEN` is what a user's mask keeps from being looked at: neither.
"""

from pathlib import Path

import cv2
import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.files import atomic_path
from cherrypicker.intake.masks import read_grey

#: Value of a pixel that the user hides: below half, so that who asks for sky alone gets none
HIDDEN = 64


def write_mask(path: Path, mask: np.ndarray) -> None:
    """Write a mask, (H, W) uint8, as PNG with one channel."""
    with atomic_path(path) as tmp:
        # Level 1: masks are large flat areas, more effort costs seconds and saves kilobytes.
        if not cv2.imwrite(str(tmp), mask, [cv2.IMWRITE_PNG_COMPRESSION, 1]):
            raise StageError("the mask cannot be written", file=path)


def read_masks(path: Path, shape: tuple[int, int] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Read what of a photo is sky and what the user hides, each (H, W) bool.

    It raises as `read_grey` does.
    """
    mask = read_grey(path, "the sky mask", shape)
    return mask > 127, mask == HIDDEN
