"""SIFT features of every photo, written to a COLMAP database."""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from pathlib import Path

import pycolmap

from cherrypicker.errors import StageError
from cherrypicker.files import write_json
from cherrypicker.sfm.database import (
    feature_counts,
    image_ids,
    publish_database,
    scratch_folder,
    watched_table,
)
from cherrypicker.sfm.photo_check import PhotoInfo, check_photos, group_by_camera

logger = logging.getLogger(__name__)


def extract_features(
    photos: Sequence[str | os.PathLike],
    database: str | os.PathLike,
    listing: str | os.PathLike,
    *,
    folder: str | os.PathLike = "",
    camera_mode: str = "folder",
    camera_model: str = "SIMPLE_RADIAL",
    max_features: int = 4000,
    max_image_size_px: int = 2400,
    skip_unreadable: bool = False,
    seed: int = 0,
    threads: int = 1,
) -> dict:
    """Extract features of all photos into a new database.

    Parameters
    ----------
    photos : sequence of path-like
        Photos of one folder.
    database : path-like
        COLMAP database to write.
    listing : path-like
        JSON to write: per photo its size, EXIF camera, camera group, features, or its problem.
    folder : path-like
        Folder named in errors.
    camera_mode : {"folder", "auto", "per_image"}
        See :func:`cherrypicker.sfm.photo_check.group_by_camera`.
    camera_model : str
        COLMAP's name of the camera model. The focal length starts from EXIF where given.
    max_features : int
        Features kept per photo, the largest first; COLMAP keeps whole levels of scale, which may
        be a third more.
    max_image_size_px : int
        Longer side at which features are sought; 0 for the full photo. Feature coordinates are
        those of the full photo either way.
    skip_unreadable : bool
        Leave unreadable photos out instead of failing.
    seed : int
    threads : int

    Returns
    -------
    dict
        The content of ``listing``.

    Raises
    ------
    StageError
        As :func:`cherrypicker.sfm.photo_check.check_photos`, or if COLMAP finds no features in
        any photo.
    """
    pycolmap.set_random_seed(seed)
    infos = check_photos(photos, folder=folder, skip_unreadable=skip_unreadable, threads=threads)
    groups = group_by_camera(infos, camera_mode)
    logger.info(
        "%d of %d photos usable, %d camera(s)",
        sum(map(len, groups)),
        len(infos),
        len(groups),
    )
    with scratch_folder(database) as scratch:
        working = scratch / "features.db"
        pycolmap.Database.open(working).close()
        for group in groups:
            _import_group(working, group, camera_model)
        with watched_table(working, "descriptors", sum(map(len, groups)), "features of photos"):
            _extract(working, groups, max_features, max_image_size_px, threads)
        counts = feature_counts(working)
        if not any(counts.values()):
            raise StageError(
                "no photo shows any feature (blank or wholly blurred photos?)",
                file=folder or infos[0].path.parent,
                key="photos in trees.tsv",
            )
        content = _listing(infos, groups, counts, working)
        publish_database(working, database)
    write_json(listing, content)
    return content


def _import_group(database: Path, group: Sequence[PhotoInfo], camera_model: str) -> None:
    """Enter a group's photos and camera in order: threads would number them as they finish."""
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = camera_model
    pycolmap.import_images(
        database,
        group[0].path.parent,
        camera_mode=pycolmap.CameraMode.SINGLE,
        image_names=[info.name for info in group],
        options=reader,
    )


def _extract(database, groups, max_features, max_image_size_px, threads) -> None:
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.num_threads = threads
    options.max_image_size = max_image_size_px if max_image_size_px > 0 else -1
    options.sift.max_num_features = max_features
    # A second orientation of the same spot costs as much as a new spot and matches no better.
    options.sift.max_num_orientations = 1
    pycolmap.extract_features(
        database,
        groups[0][0].path.parent,
        image_names=[info.name for group in groups for info in group],
        camera_mode=pycolmap.CameraMode.PER_IMAGE,  # not heeded: the photos have cameras already
        extraction_options=options,
        device=pycolmap.Device.cpu,
    )


def _listing(
    infos: Sequence[PhotoInfo],
    groups: Sequence[Sequence[PhotoInfo]],
    counts: dict[str, int],
    database: Path,
) -> dict:
    """Describe each photo, and log what a reader wants to know."""
    group_of = {info.name: i for i, group in enumerate(groups) for info in group}
    ids = image_ids(database)
    photos = {}
    for info in infos:
        problem = info.problem
        if not problem and info.name not in ids:
            problem = "COLMAP could not read the photo"
            logger.warning("%s is left out: %s", info.name, problem)
        photos[info.name] = {
            "width": info.width,
            "height": info.height,
            "exif_camera": info.camera,
            "exif_focal_mm": info.focal_mm,
            "exif_orientation": info.orientation,
            "camera_group": group_of.get(info.name),
            "n_features": counts.get(info.name, 0),
            "problem": problem,
        }
    found = sorted(photo["n_features"] for photo in photos.values() if not photo["problem"])
    logger.info(
        "features per photo: least %s, median %s, most %s",
        f"{found[0]:,}",
        f"{found[len(found) // 2]:,}",
        f"{found[-1]:,}",
    )
    return {"n_photos": len(infos), "n_cameras": len(groups), "photos": photos}
