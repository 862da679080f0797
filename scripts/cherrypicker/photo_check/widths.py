"""How thick: the width of a branch's silhouette before the sky.

A branch is as wide as its edges lie apart: where half of the light is lost that it takes at most
along a line across it, however blurred the photo is. On the side that the sun lights bark may be as
bright as a cloud, but not of its colour: red, green and blue then have their edges elsewhere, and
such a place is not asked. Across a branch thinner than some pixels no pixel is all wood, but what
it takes of the sky's light adds up. What wood takes is learnt from the photo's own wider branches.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from cherrypicker.evidence.witnesses import THIN_PX
from cherrypicker.files import rounded
from cherrypicker.geometry.robust import robust_sigma
from cherrypicker.mvs.raster import CLEAR_BELOW, HIDDEN
from cherrypicker.photo_check.places import Places
from cherrypicker.photos import linear_light
from cherrypicker.poses import View
from cherrypicker.skeleton import axes, axis_of_node
from cherrypicker.skeleton.model import Skeleton

# Samples of a line across a branch, and how far it runs beyond the branch's edge, px
SAMPLE_PX = 0.5
BESIDE_PX = 5.0
# Its ends, px, lie on clear sky, or the width is not asked
SKY_PX = 1.5
# Pixels that the edges' distances in red, green and blue differ by at most. Wood of 7 px and more
# is off by -2.7 px (mean) before broken clouds in the sun, by -0.2 where they agree; in five scans
# of two generators under other skies by -0.4 to 0.1 both
AGREE_PX = 1.0
# So many places whose edges tell their width tell what wood takes of a photo's light
LEAST_WIDE = 20
# Photos that a place's width needs, and what all of them may be wrong by, px: axes are off by 0.23
# to 0.49 (root mean square) in seven scans, by 0.8 and 0.9 in a sunny and in a blurred one
LEAST_PHOTOS = 4
SHARED_PX = 0.4


class Across(NamedTuple):
    """Lines of a photo across places of a skeleton, from clear sky to clear sky."""

    rows: np.ndarray  # (n,) int64: the places
    pixel: np.ndarray  # (n,) float64: size of a pixel there, in the skeleton's unit
    direction: np.ndarray  # (n, 2) float64: of the lines in the photo
    # (3, n, m) float32: share of the sky's red, green and blue light that is lost at samples
    # `SAMPLE_PX` apart, the places in their middle
    lost: np.ndarray


def light_of(photo: np.ndarray) -> Sequence[np.ndarray]:
    """Linear red, green and blue of a photo (height, width, 3) uint8, (height, width) float32."""
    return cv2.split(cv2.LUT(photo, linear_light(np.arange(256)).astype(np.float32)))


def lines_across(
    light: Sequence[np.ndarray],
    raster: np.ndarray,
    view: View,
    places: Places,
    beside: np.ndarray,
) -> Across:
    """Sample lines across places in a photo, of which there is `light_of`, before the sky.

    The raster (height, width), uint8, holds what it shows, see `cherrypicker.mvs.raster`. The lines
    go on ``beside``, (n_places,), px, what is as thick as the places. Left out are places that the
    photo does not show between clear sky.
    """
    in_camera = places.points @ view.R.T + view.t
    along = places.along @ view.R.T
    depth, focal = in_camera[:, 2], float(view.K[0, 0])
    uv, _ = view.project(places.points)
    moved = along[:, :2] - along[:, 2:] * in_camera[:, :2] / np.where(depth > 0, depth, 1)[:, None]
    across = np.stack([-moved[:, 1], moved[:, 0]], axis=1)
    across /= np.maximum(np.linalg.norm(across, axis=1), 1e-12)[:, None]
    reach = places.radius * focal / np.maximum(depth, 1e-9) + beside
    size = np.array(raster.shape[::-1])
    inside = ((uv > reach[:, None]) & (uv < size - reach[:, None])).all(axis=1)
    rows = np.flatnonzero((depth > 0) & inside)
    n_samples = int(np.ceil(reach[rows].max(initial=0) / SAMPLE_PX))
    offset = SAMPLE_PX * np.arange(-n_samples, n_samples + 1)
    at = uv[rows, None] + offset[:, None] * across[rows, None]
    seen = np.stack([_sampled(color, at, cv2.INTER_LINEAR) for color in light])
    kind = _sampled(raster, at, cv2.INTER_NEAREST)
    is_sky = kind < CLEAR_BELOW
    is_used = np.abs(offset) <= reach[rows, None]
    is_end = is_used & (np.abs(offset) > reach[rows, None] - SKY_PX)
    free = (is_sky | ~is_end).all(axis=1) & ~is_sky[:, n_samples]  # and wood in the middle
    free &= ~((kind == HIDDEN) & is_used).any(axis=1)
    sky = (seen * is_end).sum(axis=2) / is_end.sum(axis=1)
    lost = np.where(is_used, 1 - seen / np.maximum(sky, 1e-6)[..., None], 0)[:, free]
    rows = rows[free]
    return Across(rows, depth[rows] / focal, across[rows], lost)


def silhouette_widths(
    photo: np.ndarray, raster: np.ndarray, view: View, places: Places
) -> tuple[np.ndarray, np.ndarray]:
    """Measure the silhouettes of places in a photo, as of `lines_across`.

    Returns widths and sizes of a pixel there, (n_places,) float64 each, in the skeleton's unit; NaN
    where the photo does not tell.
    """
    width, pixel = np.full((2, len(places.points)), np.nan)
    beside = np.full(len(places.points), BESIDE_PX)
    rows, size, _, lost = lines_across(light_of(photo), raster, view, places, beside)
    colors = np.stack([_between_edges(each) for each in lost]) * SAMPLE_PX
    agrees = np.ptp(colors, axis=0) <= AGREE_PX
    shown, edges = rows[agrees], colors[1, agrees]  # JPEG halves the others' resolution
    area = np.where(edges > 0, lost[1, agrees].sum(axis=1) * SAMPLE_PX, 0.0)
    is_wide = edges >= THIN_PX
    if np.count_nonzero(is_wide) >= LEAST_WIDE:
        wood = np.median(area[is_wide] / edges[is_wide])
        pixel[shown] = size[agrees]
        width[shown] = np.where(is_wide, edges, area / wood) * size[agrees]
    return width, pixel


def _between_edges(lost: np.ndarray) -> np.ndarray:
    """How many samples of lines (n, m) lie between the first and last half of their maximum.

    None where nothing is lost.
    """
    rows, level = np.arange(len(lost)), lost.max(axis=1, initial=1e-6) / 2
    takes = (lost >= level[:, None]).any(axis=1)

    def first(line: np.ndarray) -> np.ndarray:
        at = np.maximum((line >= level[:, None]).argmax(axis=1), 1)
        before, there = line[rows, at - 1], line[rows, at]
        return at - np.clip((there - level) / np.maximum(there - before, 1e-6), 0.0, 1.0)

    return np.where(takes, lost.shape[1] - 1 - first(lost[:, ::-1]) - first(lost), 0.0)


def branch_diameters(
    skeleton: Skeleton, places: Places, width: np.ndarray, pixel: np.ndarray
) -> list[dict]:
    """Mean diameter of every axis that the photos show between clear sky.

    By widths and pixels (n_photos, n_places) of `silhouette_widths`: ``branch_id``, ``diameter``
    and its standard error ``diameter_se`` in the skeleton's unit, ``tube_diameter``, the skeleton's
    at the same places, ``width_px``, ``n_photos`` and ``length``, that of the places measured;
    ``widths``, a diameter a node of the axis, None where no place of its edge was measured. The
    error is what the photos differ by, and what they share.
    """
    enough = np.isfinite(width).sum(axis=0) >= LEAST_PHOTOS
    typical = np.full(len(enough), np.nan)
    typical[enough] = np.nanmedian(width[:, enough], axis=0)
    enough &= typical > 0  # else half the photos see no light taken: no silhouette
    axis_list = axes(skeleton)
    axis = axis_of_node(skeleton, axis_list)[places.node]
    weight = np.where(enough, places.length, 0.0)
    sums = np.bincount(places.node, weight * np.nan_to_num(typical), len(skeleton))
    with np.errstate(invalid="ignore"):
        by_node = sums / np.bincount(places.node, weight, len(skeleton))
    found = []
    for one in np.unique(axis[enough]):
        rows = np.flatnonzero(enough & (axis == one))
        own, length = width[:, rows], places.length[rows]
        own = own[np.isfinite(own).any(axis=1)]
        middle = typical[rows]
        diameter = float(np.average(middle, weights=length))
        share = np.nanmedian(own / middle, axis=1)  # of the whole, by photo
        size = float(np.nanmedian(pixel[:, rows]))
        spread = robust_sigma(share - np.median(share)) / np.sqrt(len(share))
        found.append(
            {
                "branch_id": int(one),
                "diameter": rounded(diameter),
                "diameter_se": rounded(np.hypot(diameter * spread, SHARED_PX * size)),
                "tube_diameter": rounded(np.average(2 * places.radius[rows], weights=length)),
                "width_px": round(diameter / size, 2),
                "n_photos": len(own),
                "length": rounded(length.sum()),
                "widths": [
                    None if np.isnan(each) else rounded(each)
                    for each in by_node[axis_list[one].nodes]
                ],
            }
        )
    return found


def _sampled(image: np.ndarray, at: np.ndarray, how: int) -> np.ndarray:
    """Values of an image at pixels (n, m, 2), pixel centres at (0.5, 0.5)."""
    x, y = np.ascontiguousarray(np.moveaxis(at - 0.5, 2, 0), dtype=np.float32)
    if not len(x):
        return np.zeros(x.shape, dtype=image.dtype)
    most = np.iinfo(np.int16).max - 1  # rows that OpenCV samples at a time
    blocks = [slice(first, first + most) for first in range(0, len(x), most)]
    parts = [
        cv2.remap(image, x[rows], y[rows], how, borderMode=cv2.BORDER_REPLICATE) for rows in blocks
    ]
    return np.concatenate(parts)
