"""Sky masks of photos: the network at a working size, then the photo's own detail.

The network sees a reduced photo, upright, as it is and at middle brightness: dusk and snow are not
what it was trained on. What it says is evened out where no edge divides the photo, and the photo's
own colours decide where it is in doubt. The probabilities are brought to full resolution by a
guided filter [1]_ whose linear models are fitted at the working size and applied to the full photo
[2]_, so that the mask follows edges that the network never saw. What is thin before the sky is then
told by `cherrypicker.sky.likeness`.

References
----------
.. [1] He, Sun, Tang, "Guided image filtering", PAMI 2013.
.. [2] He, Sun, "Fast guided filter", arXiv:1505.00996.
.. [3] Gastal, Oliveira, "Domain transform for edge-aware image and video processing",
   SIGGRAPH 2011.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from scipy.ndimage import gaussian_filter

from cherrypicker.photos import as_stored, upright
from cherrypicker.sky.likeness import tell_thin_things
from cherrypicker.sky.sizes import enlarge, in_strips, reduce_photo
from cherrypicker.sky.unet import MEAN, SkyUNet, to_tensor

#: The network is sure of sky above this probability, and of no sky below one minus it.
SURE = 0.9
#: Bins per channel of the colour histograms, and the share of pixels that counts as never seen.
COLOR_BINS = 32
COLOR_FLOOR = 1e-5
#: Limits of the network's probability and of the colours' log odds when the two are added.
LEAST_PROBABILITY = 0.005
COLOR_LIMIT = 4.0
#: How far sky reaches to make its neighbours sky, a share of the longer side; and the share of sky
#: around a pixel from which its colour counts in full.
SKY_REACH = 0.04
NEAR_SHARE = 0.1
#: How far ground reaches, and the share of it that counts in full: wood is thin.
GROUND_REACH = 0.01
GROUND_SHARE = 0.3
#: How far the network's log odds are evened out, a share of the longer side, and the difference in
#: colour that counts as an edge.
EVEN_REACH, EDGE_CONTRAST = 0.15, 0.3

#: Radius, px of the photo that the network sees, as [1]_ takes it to feather a mask, and variance
#: of colours of the guided filter. With 5 and 3e-4 F1 of sky is 0.940, not 0.954, on CamVid and
#: 0.910, not 0.927, on ADE20K, held out. 1e-6, as [1]_, and 3e-3 are 0.005 below at most; the less,
#: the more noise speckles a sky that is nearly of the ground's colour.
GUIDE_RADIUS_PX, GUIDE_EPSILON = 60, 1e-3


@dataclass(frozen=True)
class MaskOptions:
    """Settings of `sky_mask`; the fields are config keys of ``sky``."""

    working_side_px: int = 800
    color_weight: float = 0.5
    twig_contrast: float = 0.08


def sky_probability(net: SkyUNet, image: np.ndarray) -> np.ndarray:
    """Run the network on one upright photo of the working size: probability of sky (h, w), float32.

    The network is in evaluation mode, the photo (h, w, 3), uint8, RGB.
    """
    height, width = image.shape[:2]
    bottom, right = -height % net.stride, -width % net.stride
    padded = cv2.copyMakeBorder(image, 0, bottom, 0, right, cv2.BORDER_REPLICATE)
    with torch.inference_mode():
        x = to_tensor(padded[None]).contiguous(memory_format=torch.channels_last)
        logits = net.to(memory_format=torch.channels_last)(x)  # type: ignore[call-overload]
        probability = torch.sigmoid(logits)[0, 0, :height, :width]
    return probability.float().numpy().copy()


def at_middle_brightness(image: np.ndarray) -> np.ndarray:
    """Bring an image to the mean of the network by a power of its values: another exposure."""
    mean = (float(image.mean()) + 0.5) / 256  # neither 0 nor 1
    power = np.log(MEAN) / np.log(mean)
    table = np.rint(255 * (np.arange(256) / 255) ** power).astype(np.uint8)
    return table[image]


def photo_probability(net: SkyUNet, image: np.ndarray) -> np.ndarray:
    """Run the network on a photo as it is and at middle brightness, and take the mean.

    Parameters and result as of `sky_probability`; the mean is that of the log odds.
    """
    looks = [sky_probability(net, seen) for seen in (image, at_middle_brightness(image))]
    return _from_odds(np.mean([_log_odds(look) for look in looks], axis=0))


def _log_odds(probability: np.ndarray) -> np.ndarray:
    limited = np.clip(probability, LEAST_PROBABILITY, 1 - LEAST_PROBABILITY)
    return np.log(limited / (1 - limited))


def _from_odds(odds: np.ndarray) -> np.ndarray:
    return (1 / (1 + np.exp(-odds))).astype(np.float32)


def even_out(image: np.ndarray, probability: np.ndarray) -> np.ndarray:
    """Even the network's log odds out where no edge divides the photo.

    Grey clouds below bright ones, or a house above its dark windows, are of one piece. This is the
    domain transform, recursive form [3]_: a pixel's value spreads along rows and columns, less the
    more the photo's colours differ on the way. The image is (h, w, 3), uint8, the probability
    (h, w), float32.
    """
    # Noise would be edges, summed over the way
    calm = cv2.GaussianBlur(image, (3, 3), 0).astype(np.float32) / 255
    reach = EVEN_REACH * max(probability.shape)
    odds = _log_odds(probability).astype(np.float32)
    mode = cv2.ximgproc.DTF_RF
    return _from_odds(cv2.ximgproc.dtFilter(calm, odds, reach, EDGE_CONTRAST, mode=mode))


def guided_coefficients(guide: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Fit the guided filter's local linear models ``target = a . guide + b``.

    The guide is (h, w, 3), float32 in [0, 1], the target (h, w), float32. Returns a (three
    channels) and b, (h, w, 4) float32, each averaged over the windows that cover a pixel.
    """
    size = (2 * GUIDE_RADIUS_PX + 1,) * 2

    def mean(array: np.ndarray) -> np.ndarray:
        return cv2.blur(array, size, borderType=cv2.BORDER_REFLECT_101)

    guide_mean, target_mean = mean(guide), mean(target)
    covariance = mean(guide * target[..., None]) - guide_mean * target_mean[..., None]
    products = (guide[..., :, None] * guide[..., None, :]).reshape(*target.shape, 9)
    # cv2.blur takes any number of channels, but only four at a time quickly.
    second = np.concatenate([mean(products[..., k : k + 3]) for k in (0, 3, 6)], axis=2)
    sigma = second.reshape(*target.shape, 3, 3)
    sigma = sigma - guide_mean[..., :, None] * guide_mean[..., None, :]
    sigma = sigma + np.float32(GUIDE_EPSILON) * np.eye(3, dtype=np.float32)
    a = np.linalg.solve(sigma, covariance[..., None])[..., 0]
    b = target_mean - np.sum(a * guide_mean, axis=2)
    return np.dstack([mean(a.astype(np.float32)), mean(b.astype(np.float32))])


def color_evidence(image: np.ndarray, probability: np.ndarray) -> np.ndarray:
    """Say by colour alone how much more likely each pixel is sky than not, within one photo.

    Histograms of the colours where the network is sure are the photo's own models of sky and of
    everything else: bark that the sun has bleached also stands before the ground, and the sky
    between twigs has the colour of the open sky. The image is (h, w, 3), uint8, the probability
    (h, w), float32. The log of the ratio of likelihoods, (h, w) float32, is 0 where the photo has
    no sure sky or no sure ground.
    """
    sure = [probability > SURE, probability < 1 - SURE]
    if min(np.count_nonzero(part) for part in sure) < COLOR_BINS**2:
        return np.zeros(probability.shape, np.float32)
    cells = (image // (256 // COLOR_BINS)).astype(np.int64)
    cells = (cells[..., 0] * COLOR_BINS + cells[..., 1]) * COLOR_BINS + cells[..., 2]
    logs = []
    for part in sure:
        counts = np.bincount(cells[part], minlength=COLOR_BINS**3).astype(np.float64)
        smooth = gaussian_filter(counts.reshape((COLOR_BINS,) * 3), 1.0, mode="nearest")
        logs.append(np.log(smooth.ravel() / counts.sum() + COLOR_FLOOR))
    return (logs[0] - logs[1])[cells].astype(np.float32)


def refine_probability(image: np.ndarray, probability: np.ndarray, weight: float) -> np.ndarray:
    """Let the photo's own colours decide where the network is in doubt.

    Log odds are added, each clipped, so that colour alone never overrules a sure network. The image
    is (h, w, 3), uint8, the probability (h, w), float32; a weight of the colours' log odds of 0
    leaves it as it is.
    """
    if weight <= 0:
        return probability
    odds = _log_odds(probability)
    evidence = np.clip(weight * color_evidence(image, probability), -COLOR_LIMIT, COLOR_LIMIT)
    # A white marker on the ground may have the colour of a cloud, a grey cloud that of a road:
    # colour makes sky only near sky, and something else only near something else.
    side, is_sky = max(probability.shape), (probability > 0.5).astype(np.float32)
    near = cv2.GaussianBlur(is_sky, (0, 0), SKY_REACH * side) / NEAR_SHARE
    away = cv2.GaussianBlur(1 - is_sky, (0, 0), GROUND_REACH * side) / GROUND_SHARE
    odds += evidence * np.clip(np.where(evidence > 0, near, away), 0, 1)
    return _from_odds(odds)


def sky_mask(
    net: SkyUNet, image: np.ndarray, options: MaskOptions, orientation: int = 1
) -> np.ndarray:
    """Make the sky mask of one photo at full resolution, (H, W) uint8: 255 = sky, 0 = not.

    The network is in evaluation mode. The image, (H, W, 3) uint8, RGB, holds the stored pixels; by
    the EXIF orientation the network sees it upright, and the mask comes as stored.
    """
    small = reduce_photo(image, options.working_side_px)
    seen = np.ascontiguousarray(upright(small, orientation))
    probability = photo_probability(net, seen)
    return mask_from_probability(image, as_stored(probability, orientation), options)


def mask_from_probability(
    image: np.ndarray, probability: np.ndarray, options: MaskOptions
) -> np.ndarray:
    """Bring the network's probability to the full resolution and the edges of its photo.

    The image is (H, W, 3), uint8, the probability of sky (h, w), float32, at the working size and
    in the photo's orientation. The mask is (H, W), uint8: 255 = sky, 0 = not.
    """
    height, width = image.shape[:2]
    mask = np.zeros((height, width), np.uint8)
    if probability.max() <= 1 - SURE:
        return mask
    small = reduce_photo(image, max(probability.shape))
    probability = even_out(small, np.ascontiguousarray(probability))
    probability = refine_probability(small, probability, options.color_weight)
    guide = small.astype(np.float32) / 255
    models = guided_coefficients(guide, probability)
    models[..., :3] /= 255
    for rows in in_strips(height):
        model = enlarge(models, (width, height), rows)
        value = np.einsum("ijk,ijk->ij", model[..., :3], image[rows], dtype=np.float32)
        mask[rows][value + model[..., 3] > 0.5] = 255  # likelier sky than not
    if options.twig_contrast > 0 and mask.any():
        mask = tell_thin_things(image, mask, probability, options.twig_contrast)
    return mask
