"""Photos at the working size of the sky network, and back at their own."""

from collections.abc import Iterator

import cv2
import numpy as np

#: Rows per strip at full resolution; bounds the memory, changes no result.
STRIP_ROWS = 512


def reduce_photo(image: np.ndarray, working_side: int) -> np.ndarray:
    """Reduce a photo to a longer side by area means; smaller photos stay as they are."""
    scale = working_side / max(image.shape[:2])
    if scale >= 1.0:
        return image
    size = (max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale)))
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def enlarge(small: np.ndarray, size: tuple[int, int], rows: slice) -> np.ndarray:
    """Return some rows of a small image enlarged to (width, height) ``size``."""
    fx, fy = small.shape[1] / size[0], small.shape[0] / size[1]
    # Pixel centres lie at (0.5, 0.5) in both grids, array indices at whole numbers.
    matrix = np.array([[fx, 0, 0.5 * fx - 0.5], [0, fy, (rows.start + 0.5) * fy - 0.5]])
    shape, flags = (size[0], rows.stop - rows.start), cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(small, matrix, shape, flags=flags, borderMode=cv2.BORDER_REPLICATE)


def in_strips(height: int) -> Iterator[slice]:
    """Yield the rows of a photo in strips."""
    for top in range(0, height, STRIP_ROWS):
        yield slice(top, min(top + STRIP_ROWS, height))
