"""From rendered light to a photo: backdrop, lens, shutter, sensor, JPEG with EXIF; and its maps."""

import io
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from cherrypicker.files import atomic_path
from cherrypicker.geometry.directions import unit
from cherrypicker_lab.orchard.scene.appearance import encode_srgb
from cherrypicker_lab.orchard.scene.backdrop import backdrop

# in semantic masks: what stands in the background, sky, and the hills and houses at infinity
BACKGROUND_ID, SKY_ID, FAR_ID = 253, 254, 255
_LENS_ITERATIONS = 12
_ONE_SURFACE = 1.03  # depths of neighbouring pixels on one surface differ by less


@dataclass(frozen=True)
class PhotoEffects:
    """What a camera adds to the light. All 0: a perfect one."""

    noise: float = 0.006  # standard deviation of the noise of the encoded colours, of 1
    shot_noise: float = 0.0  # the same at white, growing with the square root of the light
    exposure_stops: float = 0.0  # standard deviation of the exposure from photo to photo, stops
    motion_px: float = 0.0  # longest smear of a moving hand, px; each photo draws its own up to it
    vignette: float = 0.0  # light lost in the corners, of 1

    @classmethod
    def random(cls, seed):
        """Draw a camera and a hand: from nearly perfect to plainly visible flaws."""
        rng = np.random.default_rng([int(seed), 431])
        return cls(
            noise=float(rng.uniform(0.003, 0.012)),
            shot_noise=float(rng.uniform(0.0, 0.02)),
            exposure_stops=float(rng.uniform(0.0, 0.25)),
            motion_px=float(rng.choice([0.0, 0.0, 1.0, 2.0])),
            vignette=float(rng.uniform(0.0, 0.35)),
        )


def pixel_rays(K, cam_from_world, width, height):
    """Unit viewing directions of all pixels, shape (height * width, 3)."""
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    pixels = np.stack([x.ravel(), y.ravel(), np.ones(width * height)])
    rays = (cam_from_world[:, :3].T @ np.linalg.inv(K) @ pixels).T
    return unit(rays)


def decode_srgb(encoded):
    """sRGB in [0, 1] to linear light."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def compose(linear, alpha, scene, poses, i):
    """Put the backdrop behind rendered light of a photo `i`, (h, w, 3) float64.

    `linear` (h, w, 3) are the surfaces' linear colours, `alpha` (h, w) is their cover.
    """
    height, width = alpha.shape
    alpha, linear = alpha.reshape(-1), linear.reshape(-1, 3).copy()
    behind = np.flatnonzero(alpha < 1.0)
    rays = pixel_rays(poses.K[i], poses.cam_from_world[i], width, height)[behind]
    radiance, _ = backdrop(rays, scene.light.sky, scene.seed)
    a = alpha[behind, None]
    linear[behind] = a * linear[behind] + (1.0 - a) * radiance
    return linear.reshape(height, width, 3)


def behind_all(label, scene, poses, i):
    """Semantic mask of a photo `i`: what no surface covers is sky or far land.

    The map of classes, (h, w) uint8, is 255 where nothing is. The mask, of the same shape, has
    class ids, `BACKGROUND_ID`, `SKY_ID` and `FAR_ID`.
    """
    mask = label.copy().reshape(-1)
    free = np.flatnonzero(mask == 255)
    rays = pixel_rays(poses.K[i], poses.cam_from_world[i], *label.shape[::-1])[free]
    _, is_sky = backdrop(rays, scene.light.sky, scene.seed)
    mask[free] = np.where(is_sky, SKY_ID, FAR_ID)
    return mask.reshape(label.shape)


def lens_map(wide, camera):
    """Where in a wider pinhole image the pixels of a photo with radial distortion come from.

    `wide` is the pinhole that was rendered, of the same focal length and a larger frame; `camera`
    has `k1`, `k2` of COLMAP's RADIAL model. Returns x, y for `cv2.remap` (pixel centres at whole
    numbers), (h, w, 2) float32.
    """
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    target = np.stack([x - camera.width / 2, y - camera.height / 2], -1) / camera.focal_px
    source = target.copy()
    for _ in range(_LENS_ITERATIONS):
        r2 = (source**2).sum(-1, keepdims=True)
        source = target / (1 + camera.k1 * r2 + camera.k2 * r2**2)
    pixels = source * wide.focal_px + np.array([wide.width / 2, wide.height / 2])
    return (pixels - 0.5).astype(np.float32)


def lens_margin(camera):
    """How many times wider than a photo the pinhole image must be that it is cut from."""
    half = np.array([camera.width, camera.height]) / 2
    reach = np.abs(lens_map(camera, camera) + 0.5 - half).reshape(-1, 2).max(axis=0)
    return float(((reach + 2.0) / half).max())


def distorted(image, lens, *, nearest=False):
    """An image seen through a lens, see `lens_map`."""
    how = cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
    return cv2.remap(image, lens, None, how, borderMode=cv2.BORDER_REPLICATE)


def maps_through(lens, depth, normals, mask, tree):
    """Maps of a pinhole image at the pixel centres of a photo with distortion.

    The nearest pixel's values; the depth between four pixels of one surface is that of the plane
    through them (its inverse is linear in the image). The lens (h, w, 2) is of `lens_map`; depth,
    normals, mask and tree, (H, W, ...), come back in this order as (h, w, ...).
    """
    near = [distorted(values, lens, nearest=True) for values in (depth, normals, mask, tree)]
    height, width = depth.shape
    x, y = np.clip(lens[..., 0], 0, width - 1.001), np.clip(lens[..., 1], 0, height - 1.001)
    column, row = x.astype(np.int64), y.astype(np.int64)
    corners = [(row + r) * width + column + c for r in (0, 1) for c in (0, 1)]
    inverse = np.where(depth > 0, 1.0 / np.maximum(depth, 1e-6), 0.0).ravel()
    kind = (mask.astype(np.int32) * 256 + tree).ravel()
    at = np.stack([inverse[k] for k in corners])
    is_one = (at.min(axis=0) > 0) & (at.max(axis=0) < _ONE_SURFACE * at.min(axis=0))
    for k in corners[1:]:
        is_one &= kind[k] == kind[corners[0]]
    u, v = x - column, y - row
    weights = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v])
    blended = 1.0 / np.maximum((weights * at).sum(axis=0), 1e-9)
    near[0] = np.where(is_one, blended, near[0]).astype(np.float32)
    return near


def _smear(rng, linear, longest):
    """Motion blur along a random direction."""
    length, angle = rng.uniform(0, longest), rng.uniform(0, np.pi)
    size = 2 * int(np.ceil(longest / 2)) + 3
    kernel = np.zeros((size, size), np.float64)
    for t in np.linspace(-0.5, 0.5, 33):
        x, y = (
            (size // 2 + t * length * np.array([np.cos(angle), np.sin(angle)])).round().astype(int)
        )
        kernel[y, x] += 1.0
    return cv2.filter2D(linear, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE)


def develop(linear, rng, effects):
    """Linear light (h, w, 3) to an 8-bit photo with a camera's imperfections."""
    if effects.motion_px > 0:
        linear = _smear(rng, np.ascontiguousarray(linear), effects.motion_px)
    if effects.exposure_stops > 0:
        linear = linear * 2.0 ** rng.normal(0.0, effects.exposure_stops)
    if effects.vignette > 0:
        height, width = linear.shape[:2]
        y, x = np.mgrid[:height, :width]
        off = np.hypot(x + 0.5 - width / 2, y + 0.5 - height / 2) / np.hypot(width / 2, height / 2)
        linear = linear * (1.0 - effects.vignette * off**4)[..., None]
    photo = encode_srgb(linear)
    spread = effects.noise
    if effects.shot_noise > 0:
        spread = np.hypot(effects.noise, effects.shot_noise * np.sqrt(np.clip(linear, 0, 1)))
    photo = photo + rng.normal(size=linear.reshape(-1, 3).shape).reshape(linear.shape) * spread
    return np.round(255 * np.clip(photo, 0, 1)).astype(np.uint8)


def write_jpeg(path, photo, camera):
    """Write a photo with EXIF of the camera and its focal length; never leaves half a file."""
    exif = Image.Exif()
    exif[0x010F], exif[0x0110] = camera.make, camera.model
    details = exif.get_ifd(0x8769)
    details[0x920A] = IFDRational(round(100 * camera.focal_mm), 100)
    details[0xA405] = int(round(camera.focal_35mm))
    details[0xA002], details[0xA003] = camera.width, camera.height
    buffer = io.BytesIO()
    Image.fromarray(photo).save(
        buffer, "JPEG", quality=80, optimize=True, subsampling="4:2:0", exif=exif
    )
    with atomic_path(path) as partial:
        Path(partial).write_bytes(buffer.getvalue())


def write_maps(folder, name, depth, normals, mask, tree):
    """Write the truth of one photo: `depth/{stem}.npz` and `semantic/{stem}.png`.

    The folder is the scene's `truth`, the name the photo's file name. Depth (h, w) float32 is m
    along the optical axis, 0 where nothing is; normals (h, w, 3) are in the camera's frame. The
    mask (h, w) uint8 has class ids, `BACKGROUND_ID`, `SKY_ID`, `FAR_ID`; `tree` (h, w) uint8 is 0
    for the target, 1 and more for neighbours, 255 for none.
    """
    folder, stem = Path(folder), Path(name).stem
    for part in ("depth", "semantic"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    with atomic_path(folder / "semantic" / f"{stem}.png") as partial:
        Image.fromarray(mask).save(partial, "PNG")
    with atomic_path(folder / "depth" / f"{stem}.npz") as partial, open(partial, "wb") as file:
        # most of a map is smooth or empty: packed it is a third or less
        np.savez_compressed(
            file, depth=depth.astype(np.float32), normals=normals.astype(np.float16), tree=tree
        )
