"""Match the features of photo pairs and verify them by two-view geometry."""

import logging
import math
import os
import shutil
from collections.abc import Collection
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import pycolmap

from cherrypicker.errors import StageError
from cherrypicker.files import temporary_folder
from cherrypicker.photos import PHOTOS_COLUMN
from cherrypicker.progress import in_threads
from cherrypicker.sfm.database import (
    SCRATCH,
    copy_database,
    image_ids,
    publish_database,
    rename_images,
    verified_inliers,
    verified_pairs,
    watched,
)
from cherrypicker.sfm.features import Search, find_features
from cherrypicker.sfm.guided import MAX_RATIO, guided_matches, read_features
from cherrypicker.sfm.pairs import N_PARTNERS, retrieval_pairs, sequential_pairs

logger = logging.getLogger(__name__)

# Largest epipolar error of a verified match, px, and least matches of a verified pair
MAX_ERROR_PX = pycolmap.TwoViewGeometryOptions().ransac.max_error
MIN_INLIERS = pycolmap.TwoViewGeometryOptions().min_num_inliers


@dataclass(frozen=True)
class MatchingOptions:
    """How photos are matched; the fields are config keys of ``sfm``."""

    exhaustive_max_photos: int = 80


def match_features(
    features: str | os.PathLike,
    database: str | os.PathLike,
    options: MatchingOptions,
    *,
    seed: int = 0,
    threads: int = 1,
) -> None:
    """Copy the database of :func:`cherrypicker.sfm.features.extract_features`, and match in it.

    That adds matches and two-view geometries. A `StageError` where no pair can be verified.
    """
    pycolmap.set_random_seed(seed)
    with temporary_folder(Path(database).parent, SCRATCH) as scratch:
        working = copy_database(features, scratch / "database.db")
        ids = image_ids(working)
        if len(ids) <= options.exhaustive_max_photos:
            pairing, pairs = "exhaustive", {*combinations(range(len(ids)), 2)}
        else:  # look-alikes beside neighbours
            pairing, pairs = "retrieval", sequential_pairs(len(ids))
            with pycolmap.Database.open(working) as opened:
                found = [opened.read_descriptors(image_id).data for image_id in ids.values()]
            pairs |= retrieval_pairs(found, seed)
        n_all, names = math.comb(len(ids), 2), list(ids)
        logger.info("%s pairing: %d of %d pairs of photos", pairing, len(pairs), n_all)
        named = [(names[i], names[j]) for i, j in sorted(pairs)]
        _match_pairs(working, named, seed, threads)
        with pycolmap.Database.open(working) as opened:
            _, n_inliers = opened.read_two_view_geometry_num_inliers()
        n_verified = sum(n >= MIN_INLIERS for n in n_inliers)
        if n_verified == 0:
            raise StageError(
                f"no two of {len(ids)} photos match (no overlap, or blurred?)",
                file=features,
                key=f"{PHOTOS_COLUMN}, sfm.max_features",
            )
        logger.info(f"{pairing}: {len(n_inliers)} pairs share features, {n_verified} verified")
        publish_database(working, database)


def match_pooled(database: Path, names: Collection[str], search: Search, seed: int = 0) -> None:
    """Match some photos and their likely partners anew, by pooled descriptors and then guided.

    The database with verified matches changes in place: the features stay, and a pair takes the new
    matches where they are more. ``names`` are of photos that need more.
    """
    pairs = likely_partners(database, names)
    working = Path(shutil.copyfile(database, database.with_name("pooled.db")))
    both = sorted({name for pair in pairs for name in pair})
    find_features(working, both, search, pooled=True)
    with pycolmap.Database.open(working) as opened:
        opened.clear_matches()
        opened.clear_two_view_geometries()
    _match_pairs(working, pairs, seed, search.threads)
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = seed
    verification.ransac.max_error = width = 0.5 * MAX_ERROR_PX
    n_taken = 0
    with pycolmap.Database.open(working) as found, pycolmap.Database.open(database) as opened:
        verified = verified_pairs(found)
        wanted = sorted({image_id for pair in verified for image_id in pair})
        features = {image_id: read_features(found, image_id) for image_id in wanted}

        def guided(pair: tuple[int, int]) -> pycolmap.TwoViewGeometry:
            """A pair matched along wide epipolar bands, its geometry estimated again, then along
            bands half as wide: few matches guide badly. The first where that gives no more."""
            first, second = sides = features[pair[0]], features[pair[1]]
            wide = guided_matches(*sides, verified[pair], 2 * width, MAX_RATIO)
            if len(wide) < MIN_INLIERS:
                return verified[pair]
            again = pycolmap.estimate_two_view_geometry(
                first.camera, first.pixels, second.camera, second.pixels, wide, verification
            )
            if len(again.inlier_matches) < max(MIN_INLIERS, 0.5 * len(wide)):
                return verified[pair]  # which the second contradicts
            again.inlier_matches = guided_matches(*sides, again, width, MAX_RATIO)
            return max(again, verified[pair], key=lambda each: len(each.inlier_matches))

        results = in_threads(guided, verified, search.threads, "pairs matched again, guided")
        for pair, geometry in zip(verified, results):
            has = opened.exists_two_view_geometry(*pair)
            before = len(opened.read_two_view_geometry(*pair).inlier_matches) if has else 0
            if len(geometry.inlier_matches) > before:
                write = opened.update_two_view_geometry if has else opened.write_two_view_geometry
                write(*pair, geometry)
                n_taken += 1
    working.unlink()
    told = "pooled descriptors of %d photos: %d of %d pairs took their matches"
    logger.info(told, len(both), n_taken, len(pairs))


def likely_partners(database: Path, names: Collection[str]) -> list[tuple[str, str]]:
    """Pair photos with those that they share most matches with, then those next in name order."""
    order = list(image_ids(database))
    inliers = verified_inliers(database, 1)
    pairs: set[tuple[str, str]] = set()
    for name in names:
        found = inliers.get(name, {})
        place = order.index(name)
        near = sorted(
            (other for other in order if other != name),
            key=lambda other: (-found.get(other, 0), abs(order.index(other) - place), other),
        )
        pairs.update((min(name, other), max(name, other)) for other in near[:N_PARTNERS])
    return sorted(pairs)


def _match_pairs(database: Path, pairs: list[tuple[str, str]], seed: int, threads: int) -> None:
    """Let COLMAP match and verify pairs of names.

    Its list of pairs is split at blanks: names are numbers meanwhile.
    """
    aliases = {name: f"photo{i:06d}" for i, name in enumerate(image_ids(database))}
    listing = database.with_name("pairs.txt")
    listing.write_text("".join(f"{aliases[a]} {aliases[b]}\n" for a, b in pairs), encoding="utf-8")
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = listing
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = threads
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = seed
    count = pycolmap.Database.num_verified_image_pairs
    rename_images(database, aliases)
    with watched(database, count, len(pairs), "pairs of photos matched"):
        pycolmap.match_image_pairs(
            database, matching, pairing, verification, device=pycolmap.Device.cpu
        )
    rename_images(database, {alias: name for name, alias in aliases.items()})
