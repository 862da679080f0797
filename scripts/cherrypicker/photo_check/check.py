"""The photos judge a skeleton: what of it is there, what is missing, how thick it is."""

import logging

import numpy as np
from scipy.spatial import cKDTree

from cherrypicker.classes import Label, wood_mask
from cherrypicker.evidence.existence import Existence
from cherrypicker.evidence.witnesses import THIN_PX
from cherrypicker.files import rounded
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.photo_check.again import where_to_stand
from cherrypicker.photo_check.missing import Missing, find_missing
from cherrypicker.photo_check.pictures import draw_verdict
from cherrypicker.photo_check.places import Places, ask_places, pieces_of
from cherrypicker.photo_check.widths import branch_diameters, silhouette_widths
from cherrypicker.pointcloud import PointCloud
from cherrypicker.progress import Progress
from cherrypicker.skeleton import axes, axis_of_node
from cherrypicker.skeleton.model import Skeleton

logger = logging.getLogger(__name__)

# Classes of radius in the report, m: twigs, thin and thick limbs
RADII_M = (0.0, 0.003, 0.006, 0.012, np.inf)
# Radius of the ball in which missing wood is looked for, in that of the ball around the skeleton's
# box (guess: a third of the height may be cut off)
AROUND = 1.3
# Wood that is missing where the photos have no sky to show it before, a share of the skeleton that
# stands there: the true recall of seven scans was within 0.055 of what follows
# (docs/lab/photo_check.md)
UNSEEN = 0.3


def check_photos(
    skeleton: Skeleton,
    cloud: PointCloud,
    photos: ScanPhotos,
    fused: np.ndarray,
    *,
    other_stems: np.ndarray,
    refuted: dict | None = None,
    seed: int = 0,
    threads: int = 1,
) -> tuple[dict, dict[str, np.ndarray]]:
    """Let the photos judge a skeleton.

    The labelled cloud, the photos and the points of the fused cloud (n_fused, 3), all wood that the
    photos agree on, are in the skeleton's frame. What stands nearer to the feet of other trees (n,
    2) than to the skeleton's root is theirs. What `drop_refuted` dropped of it before is
    ``refuted``.

    Returns the content of ``photo_check.json`` and the pictures ``worst`` and ``best``, (height,
    width, 3) uint8.
    """
    low, high = skeleton.points.min(axis=0), skeleton.points.max(axis=0)
    reach = AROUND * float(np.linalg.norm(high - low)) / 2
    fused = fused[np.linalg.norm(fused - (low + high) / 2, axis=1) <= reach]
    wood = cloud.points[wood_mask(cloud["label"])]
    places, witnesses = ask_places(skeleton, photos, wood, seed)
    tree = witnesses.tree
    others = _not_this_tree(cloud, skeleton, other_stems)
    missing = find_missing(photos, witnesses, places, fused, others, reach, threads)
    is_wrong, step = tree.probability < 0.5, places.step
    is_lost = cKDTree(wood).query(missing.points)[0] > THIN_PX * places.pixel
    before, dropped = _before(refuted)
    # Length before the sky that the skeleton has right in each photo, and wrong, (n_photos,)
    right = (tree.words > 0) @ (places.length * tree.probability) + missing.shown
    wrong = (tree.words < 0) @ (places.length * (1.0 - tree.probability)) + missing.lacking
    unsure = places.length * np.maximum(1.0 - tree.told, _doubt(tree.probability))
    report = _numbers(skeleton, places, tree, missing) | {
        "refuted_pieces": pieces_of(
            places.points[is_wrong], places.length[is_wrong], tree.probability[is_wrong], step
        ),
        "missing_from_cloud_length": rounded((missing.length * missing.probability)[is_lost].sum()),
        "before": before,
        "missing_pieces": pieces_of(missing.points, missing.length, missing.probability, step),
        "photos": [
            {
                "name": name,
                "share_right": _share(shown, shown + lacking),
                "word_of_clear_sky": rounded(word),
            }
            for name, shown, lacking, word in zip(
                photos.poses.names.tolist(), right, wrong, witnesses.clear_word, strict=True
            )
        ],
        "photograph_again": where_to_stand(
            photos,
            skeleton.points[0],
            np.vstack([places.points, missing.points]),
            np.concatenate([places.radius, missing.length]),
            np.concatenate([unsure, missing.length * _doubt(missing.probability)]),
        ),
        "axes": _axes(skeleton, places, tree),
        "branches": branch_diameters(skeleton, places, *_widths(photos, places)),
    }
    examples = {"worst": int(wrong.argmax()), "best": int((right - wrong).argmax())}
    report |= {name: photos.poses.names[row] for name, row in examples.items()}
    unjudged = report["length"] - report["judged_length"]
    logger.info(
        f"by the photos {report['photo_precision']:.3f} of {report['length']:.2f} {skeleton.unit} "
        f"of skeleton are there; they show {report['missing_length']:.2f} of thin wood that it "
        f"lacks, and {unjudged:.2f} of it are where they could not show any "
        f"(recall {report['photo_recall']:.3f})"
    )
    pictures = {
        name: draw_verdict(photos, row, places, tree, missing.points, dropped)
        for name, row in examples.items()
    }
    return report, pictures


def _widths(photos: ScanPhotos, places: Places) -> tuple[np.ndarray, np.ndarray]:
    """Widths and sizes of a pixel, see `silhouette_widths`, in all photos."""
    width, pixel = np.empty((2, len(photos.views), len(places.points)), dtype=np.float32)
    with Progress(len(photos.views), "photos asked how thick wood is") as bar:
        for i, view in enumerate(photos.views):
            width[i], pixel[i] = silhouette_widths(photos.photo(i), photos.raster(i), view, places)
            bar.step()
    return width, pixel


def _doubt(probability: np.ndarray) -> np.ndarray:
    """How far photos contradict one another about places, (n,): 1 for even odds."""
    return 1.0 - np.abs(2.0 * probability - 1.0)


def _axes(skeleton: Skeleton, places: Places, tree: Existence) -> list[dict]:
    """How probable each axis is, and how far the photos can tell, means over its length."""
    axis = axis_of_node(skeleton, axes(skeleton))[places.node]
    length = np.bincount(axis, places.length)
    there, told = (
        np.bincount(axis, places.length * each) / np.maximum(length, 1e-12)
        for each in (tree.probability, tree.told)
    )
    return [
        {"branch_id": int(one), "p_exists": rounded(there[one]), "told": rounded(told[one])}
        for one in np.flatnonzero(length)
    ]


def _not_this_tree(cloud: PointCloud, skeleton: Skeleton, other_stems: np.ndarray) -> np.ndarray:
    """Points of signs, posts, other trees and the like, (n, 3)."""
    label = cloud["label"]
    is_wood = wood_mask(label)
    is_other = ~is_wood & (label != Label.GROUND) & (label != Label.UNLABELLED)
    if len(other_stems):
        stems = np.vstack([skeleton.points[:1, :2], other_stems])
        apart = np.linalg.norm(cloud.points[:, None, :2] - stems[None], axis=2)
        is_other |= is_wood & (apart.argmin(axis=1) > 0)
    return cloud.points[is_other]


def _numbers(skeleton: Skeleton, places: Places, tree: Existence, missing: Missing) -> dict:
    """The numbers of ``photo_check.json`` but those of single photos and branches."""
    length, there = float(places.length.sum()), places.length * tree.probability
    judged, lacking = places.length @ tree.told, missing.length @ missing.probability
    unseen = UNSEEN * (length - judged)
    orders = [str(order) for order in range(places.order.max() + 1)]
    rank = np.searchsorted(RADII_M, places.radius, side="right") - 1
    classes = [f"{1e3 * low:g}-{1e3 * high:g}" for low, high in zip(RADII_M, RADII_M[1:])]
    low, high = skeleton.points[:, 2].min(), skeleton.points[:, 2].max()
    inside = np.clip(missing.points[:, 2], low, high)  # the outer layers are open
    by_height = {"range": (low, high), "weights": missing.length * missing.probability}
    lost, edges = np.histogram(inside, **by_height)
    return {
        "unit": skeleton.unit,
        "photo_precision": _share(there.sum(), length),
        "photo_recall": _share(there.sum(), there.sum() + lacking + unseen),
        "photo_confirmed": _share(there @ tree.told, length + lacking + unseen),
        "n_photos": len(missing.shown),
        "photo_sky_share": _share(judged, length),
        "length": rounded(length),
        "judged_length": rounded(judged),
        "refuted_length": rounded(length - there.sum()),
        "missing_length": rounded(lacking),
        "unseen_length": rounded(unseen),
        "by_order": _groups(places, tree, places.order, orders),
        "by_radius_mm": _groups(places, tree, rank, classes),
        "missing_by_height": [
            {"from": rounded(a), "to": rounded(b), "length": rounded(each)}
            for a, b, each in zip(edges[:-1], edges[1:], lost, strict=True)
        ],
    }


def _before(refuted: dict | None) -> tuple[dict | None, np.ndarray]:
    """What was dropped: numbers, and the edges as drawn, lower end, upper end, radius, (n, 7)."""
    if refuted is None:
        return None, np.empty((0, 7))
    edges = [np.array(piece["edges"]) for piece in refuted["pieces"]]
    pieces = [
        {name: value for name, value in piece.items() if name != "edges"}
        | {"at": [rounded(value) for value in np.median(edge[:, 3:6], axis=0)]}
        for piece, edge in zip(refuted["pieces"], edges, strict=True)
    ]
    return {
        "photo_precision": _share(refuted["expected_length"], refuted["length"]),
        "length": refuted["length"],
        "dropped_length": refuted["dropped_length"],
        "dropped_pieces": pieces,
    }, np.concatenate([np.empty((0, 7)), *edges])


def _groups(places: Places, tree: Existence, group: np.ndarray, names: list[str]) -> dict:
    """Length, what of it the photos can judge, and what is expected not to be there."""
    found = {}
    for one, name in enumerate(names):
        length = np.where(group == one, places.length, 0.0)
        found[name] = {
            "length": rounded(length.sum()),
            "judged": rounded(length @ tree.told),
            "refuted": rounded(float(length @ (1.0 - tree.probability))),
        }
    return found


def _share(part: float, whole: float) -> float | None:
    return rounded(part / whole) if whole > 0 else None
