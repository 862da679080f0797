"""Affine SIFT features of every photo, written to a COLMAP database.

The shape of a spot is fitted to what it looks like (Mikolajczyk and Schmid 2004), so that photos
match which show it from sides 24 degrees apart and more. That takes 0.4 CPU s a photo more than
round spots, and on phone photos it took the worst camera from 21 mm off to 8 (docs/lab/cameras.md).
"""

import logging
import os
import sqlite3
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import pycolmap

from cherrypicker.files import temporary_folder, write_json
from cherrypicker.photos import photo_error
from cherrypicker.sfm.database import SCRATCH, feature_counts, publish_database, watched
from cherrypicker.sfm.photo_files import PLAIN_FIRST_MP, check_photos, group_by_camera, megapixels

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class SearchOptions:
    """How many features are sought and where; the fields are config keys of ``sfm``.

    COLMAP keeps whole levels of scale, which may be a third more than ``max_features``. Feature
    coordinates are those of the full photo, whatever the size at which they are sought.
    """

    max_features: int = 4000
    max_image_size_px: int = 2400


@dataclass(frozen=True)
class FeatureOptions(SearchOptions):
    """Which photos are searched, and their cameras; the fields are config keys of ``sfm``."""

    camera_mode: str = "folder"
    camera_model: str = "RADIAL"
    skip_unreadable: bool = False


class Search(NamedTuple):
    """What is sought in which photos."""

    photos: Path  # their folder
    options: SearchOptions
    # folder of prepared masks, ``{name}.png``: what is black gives no features
    masks: str | os.PathLike | None = None
    threads: int = 1


def extract_features(
    photos: Sequence[str | os.PathLike],
    database: str | os.PathLike,
    listing: str | os.PathLike,
    options: FeatureOptions,
    *,
    folder: str | os.PathLike = "",
    masks: str | os.PathLike | None = None,
    seed: int = 0,
    threads: int = 1,
) -> None:
    """Extract features of all photos of one folder into a new database.

    The listing is a JSON to write: per photo its size, EXIF camera, camera group, features, or its
    problem. Masks are as of `Search`. A `StageError` as of
    :func:`cherrypicker.sfm.photo_files.check_photos`, or, of ``folder``, where COLMAP finds no
    features in any photo.
    """
    pycolmap.set_random_seed(seed)
    infos = check_photos(
        photos, folder=folder, skip_unreadable=options.skip_unreadable, threads=threads
    )
    groups = group_by_camera(infos, options.camera_mode)
    group_of = {info.name: i for i, group in enumerate(groups) for info in group}
    logger.info("%d of %d photos usable, %d camera(s)", len(group_of), len(infos), len(groups))
    photo_folder = infos[0].path.parent
    with temporary_folder(Path(database).parent, SCRATCH) as scratch:
        working = scratch / "features.db"
        pycolmap.Database.open(working).close()
        reader = pycolmap.ImageReaderOptions()
        reader.camera_model = options.camera_model
        # In order, before the search: its threads would number the photos as they finish.
        for group in groups:
            pycolmap.import_images(
                working,
                photo_folder,
                camera_mode=pycolmap.CameraMode.SINGLE,
                image_names=[info.name for info in group],
                options=reader,
            )
        find_features(working, [*group_of], Search(photo_folder, options, masks, threads))
        counts = feature_counts(working)
        if not any(counts.values()):
            raise photo_error(
                "no photo shows any feature (blank or wholly blurred photos?)",
                folder or photo_folder,
            )
        publish_database(working, database)
    listed: dict[str, dict] = {}
    for info in infos:
        problem = info.problem
        if not problem and info.name not in counts:
            problem = "COLMAP could not read the photo"
            logger.warning("%s is left out: %s", info.name, problem)
        listed[info.name] = {
            "width": info.width,
            "height": info.height,
            "exif_camera": info.camera,
            "exif_focal_mm": info.focal_mm,
            "exif_orientation": info.orientation,
            "camera_group": group_of.get(info.name),
            "n_features": counts.get(info.name, 0),
            "problem": problem,
        }
    found = sorted(photo["n_features"] for photo in listed.values() if not photo["problem"])
    told = (f"{n:,}" for n in (found[0], found[len(found) // 2], found[-1]))
    logger.info("features per photo: least %s, median %s, most %s", *told)
    write_json(listing, {"n_photos": len(infos), "n_cameras": len(groups), "photos": listed})


def find_features(
    database: Path, names: Sequence[str], search: Search, *, pooled: bool = False
) -> None:
    """Search photos, in place of the features that they have; large ones enlarged only where few.

    The database changes in place; names that it does not have are passed over. Pooled, each feature
    is described over several sizes (Dong and Soatto 2015). The features stay the same, in the same
    order: matches between photos so described hold for their plain descriptors, too. It takes twice
    the time of the features.
    """
    options = search.options
    wanted = pycolmap.FeatureExtractionOptions()
    wanted.num_threads = search.threads
    wanted.max_image_size = options.max_image_size_px if options.max_image_size_px > 0 else -1
    wanted.sift.max_num_features = options.max_features
    # A second orientation of the same spot costs as much as a new spot and matches no better.
    wanted.sift.max_num_orientations = 1
    wanted.sift.estimate_affine_shape = True
    wanted.sift.domain_size_pooling = pooled
    reader = pycolmap.ImageReaderOptions()
    if search.masks is not None:
        reader.mask_path = search.masks
    ids, size_mp = {}, {}
    with pycolmap.Database.open(database) as opened:
        for image in opened.read_all_images():
            camera, ids[image.name] = opened.read_camera(image.camera_id), image.image_id
            size_mp[image.name] = megapixels(camera.width, camera.height, options.max_image_size_px)

    def n_described(opened: pycolmap.Database) -> int:
        return sum(map(opened.exists_descriptors, chosen.values()))

    left = [name for name in names if name in ids]
    # By COLMAP's first octave: large photos as they are, then all that have too few, enlarged
    for first_octave, least_mp in ((0, PLAIN_FIRST_MP), (-1, 0.0)):
        chosen = {name: ids[name] for name in left if size_mp[name] >= least_mp}
        if not chosen:
            continue
        wanted.sift.first_octave = first_octave
        with closing(sqlite3.connect(database)) as connection, connection:
            for table in ("keypoints", "descriptors"):  # COLMAP passes over photos that have them
                own = ((image_id,) for image_id in chosen.values())
                connection.executemany(f"DELETE FROM {table} WHERE image_id = ?", own)
        with watched(database, n_described, len(chosen), "features of photos"):
            pycolmap.extract_features(
                database,
                search.photos,
                image_names=[*chosen],
                camera_mode=pycolmap.CameraMode.PER_IMAGE,  # not heeded: the photos have cameras
                reader_options=reader,
                extraction_options=wanted,
                device=pycolmap.Device.cpu,
            )
        counts = feature_counts(database)
        left = [n for n in left if n not in chosen or counts[n] <= options.max_features]
