"""What is thin before the sky, told by likeness to the sky around it.

Twigs thinner than a pixel of the network's working size are taken out of its sky, and gaps that it
took for wood are put in: both are a matter of the colours that the sky has right there.
"""

import cv2
import numpy as np

from cherrypicker.sky.sizes import enlarge, in_strips

#: Weight of red above blue against blue.
WARMTH = 2.0
#: Photos larger than so many working sizes are smoothed: noise would pass for contrast (a guess).
FINE = 3.0
#: The sky around a pixel is what lies in a square of this width, pixels of the working size, if it
#: is this share of the square at least; a twig is bluer by so many grey values at most. With half
#: and twice of each the F1 of 38 photos of four sets moves by 0.005 at most.
AROUND_PX, AROUND_SHARE, BLUER = 31, 0.01, 8
#: The edge of the sky, as wide as this many pixels, is no example of it: it is mixed with wood.
EDGE_PX = 3
#: What is like the sky around is sky where the network leaves that much of a doubt, a white post is
#: none, and where it is narrower than this share of the longer side: a gap, not a wall (measured:
#: docs/lab/sky.md).
DOUBT, GAP_SHARE = 0.01, 0.01
#: The second look sees a sky without the twigs that the first has found.
N_LOOKS = 2


def tell_thin_things(
    image: np.ndarray, mask: np.ndarray, probability: np.ndarray, contrast: float
) -> np.ndarray:
    """Take twigs out of a sky mask and put narrow gaps in, (H, W) uint8, 255 = sky.

    What is darker in blue or yellower than the sky around, and not bluer, is no sky: a twig, the
    edge of a limb. A gap between clouds is darker than the clouds as well, but bluer, and stays.
    The image is (H, W, 3), uint8, the probability of sky (h, w), float32, at the working size. From
    a ``contrast``, a share of white, on a colour is another.
    """
    (height, width), doubt = mask.shape, (probability > DOUBT).astype(np.uint8)
    gap = max(3, round(GAP_SHARE * max(height, width)) | 1)
    for _ in range(N_LOOKS):
        around = sky_around(image, mask, doubt.shape[::-1])
        taken, alike = mask.copy(), np.zeros_like(mask)
        for rows in in_strips(height):
            strip = _calm(image, rows) if max(mask.shape) > FINE * max(doubt.shape) else image[rows]
            local = enlarge(around, (width, height), rows)
            color, known = np.rint(local[..., :3]).astype(np.uint8), local[..., 3] > AROUND_SHARE
            darker = cv2.subtract(_cold(color), _cold(strip)) > 255 * contrast
            bluer = _blueness(strip) > np.maximum(_blueness(color), 0) + BLUER
            taken[rows][known & darker & ~bluer] = 0
            is_open = enlarge(doubt, (width, height), rows) > 0
            near = cv2.absdiff(strip, color).max(axis=2) < 255 * contrast
            alike[rows][known & near & ~darker & is_open] = 255
        alike[mask > 0] = 0
        wide = cv2.morphologyEx(alike, cv2.MORPH_OPEN, np.ones((gap, gap), np.uint8))
        taken[(alike > 0) & (wide == 0)] = 255
        mask = taken
    return mask


def _calm(image: np.ndarray, rows: slice) -> np.ndarray:
    """Rows of an image, each pixel the mean of three by three."""
    above, below = max(0, rows.start - 1), min(len(image), rows.stop + 1)
    return cv2.blur(image[above:below], (3, 3))[rows.start - above : rows.stop - above]


def _blueness(image: np.ndarray) -> np.ndarray:
    """Blue less red, (H, W) int16."""
    return image[..., 2].astype(np.int16) - image[..., 0]


def _cold(image: np.ndarray) -> np.ndarray:
    """Blue, less what red is more: uint8 as the image.

    Blue separates wood from sky best: even lit bark holds less blue than a clear or white sky.
    Before a grey cloud it may hold as much, but more red.
    """
    blue, red = (np.ascontiguousarray(image[..., k]) for k in (2, 0))
    return cv2.addWeighted(blue, 1.0, cv2.subtract(red, blue), -WARMTH, 0.0)


def sky_around(image: np.ndarray, sky: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return the mean colour of the sky around every pixel of a smaller image of a size (w, h).

    The image is (H, W, 3), uint8, and the sky (H, W), uint8, 255 there; its edge is left out. The
    result, (h, w, 4) float32, is red, green, blue, and the share of the surroundings that is sky.
    """
    inside = cv2.erode(sky, np.ones((EDGE_PX, EDGE_PX), np.uint8))
    examples = cv2.bitwise_and(image, image, mask=inside)
    sums = [cv2.resize(part, size, interpolation=cv2.INTER_AREA) for part in (examples, inside)]
    color, share = (cv2.blur(part.astype(np.float32), (AROUND_PX,) * 2) for part in sums)
    share = share / 255
    return np.dstack([color / np.maximum(share, 1e-4)[..., None], share])
