"""Work on a private copy of a COLMAP database, watch it grow, and publish it whole."""

import os
import shutil
import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pycolmap

from cherrypicker.errors import StageError
from cherrypicker.files import atomic_path
from cherrypicker.progress import Progress

# Prefix of the temporary folders beside the databases
SCRATCH = ".sfm."
# Between two counts of what is done
POLL_INTERVAL_S = 1.0

# Two-view geometries and their matches, by COLMAP's ids of the photos
PairGeometries = dict[tuple[int, int], pycolmap.TwoViewGeometry]


def copy_database(source: str | os.PathLike, copy: Path) -> Path:
    """Copy a database: COLMAP changes even one that it only reads (journal mode, side files).

    A `StageError` where the file is missing or no COLMAP database.
    """
    if not Path(source).is_file():
        raise StageError("the COLMAP database is missing", file=source)
    shutil.copyfile(source, copy)
    try:
        with closing(sqlite3.connect(copy)) as connection:
            connection.execute("SELECT COUNT(*) FROM images").fetchone()
    except (sqlite3.Error, UnicodeDecodeError) as error:
        raise StageError(f"not a COLMAP database ({error})", file=source) from error
    return copy


def publish_database(working: Path, final: str | os.PathLike) -> None:
    """Write the database to its final name in row order, without journal files, atomically."""
    with atomic_path(final) as temporary:
        temporary.unlink(missing_ok=True)
        with closing(sqlite3.connect(working)) as connection:
            connection.execute("VACUUM INTO ?", (str(temporary),))


@contextmanager
def watched(
    database: Path, count: Callable[[pycolmap.Database], int], total: int, what: str
) -> Iterator[None]:
    """Report progress by ``count`` while COLMAP fills a database: its loops offer no callback.

    pycolmap counts, not Python's sqlite3: two copies of SQLite in one process break each other's
    file locks, which ends in a crash.
    """
    finished = threading.Event()
    with Progress(total, what) as bar, pycolmap.Database.open(database) as opened:

        def watch() -> None:
            while not finished.wait(POLL_INTERVAL_S):
                bar.step(count(opened) - bar.done)

        watcher = threading.Thread(target=watch, daemon=True)
        watcher.start()
        try:
            yield
        finally:
            finished.set()
            watcher.join()
        bar.step(count(opened) - bar.done)


def rename_images(database: Path, new_names: dict[str, str]) -> None:
    """Rename photos in the database, all at once."""
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.executemany(
            "UPDATE images SET name = ? WHERE name = ?",
            [(new, old) for old, new in new_names.items()],
        )


def verified_pairs(database: pycolmap.Database, least: int = 1) -> PairGeometries:
    """Read the two-view geometries with ``least`` matches or more, by the ids of their photos."""
    pair_ids, geometries = database.read_two_view_geometries()
    return {
        pycolmap.pair_id_to_image_pair(pair_id): geometry
        for pair_id, geometry in zip(pair_ids, geometries)
        if len(geometry.inlier_matches) >= least
    }


def verified_inliers(database: Path, min_inliers: int) -> dict[str, dict[str, int]]:
    """Return, by photo, the photos it has a verified pair with and the matches of each pair."""
    names = {image_id: name for name, image_id in image_ids(database).items()}
    result: dict[str, dict[str, int]] = {}
    with pycolmap.Database.open(database) as opened:
        for pair, geometry in verified_pairs(opened, min_inliers).items():
            first, second = (names[i] for i in pair)
            n_matches = len(geometry.inlier_matches)
            result.setdefault(first, {})[second] = n_matches
            result.setdefault(second, {})[first] = n_matches
    return result


def image_ids(database: Path) -> dict[str, int]:
    """Return the COLMAP id of each photo in the database."""
    with closing(sqlite3.connect(database)) as connection:
        rows = connection.execute("SELECT name, image_id FROM images ORDER BY name").fetchall()
    return dict(rows)


def feature_counts(database: Path) -> dict[str, int]:
    """Return the number of features of each photo in the database."""
    with pycolmap.Database.open(database) as opened:
        count = opened.num_keypoints_for_image
        return {image.name: count(image.image_id) for image in opened.read_all_images()}


def forget_focal_lengths(database: Path) -> None:
    """Take for all cameras what COLMAP takes for photos whose EXIF data tell no focal length."""
    factor = pycolmap.ImageReaderOptions().default_focal_length_factor
    with pycolmap.Database.open(database) as opened:
        for known in opened.read_all_cameras():
            size = known.width, known.height
            guess = pycolmap.Camera.create_from_model_name(
                known.camera_id, known.model_name, factor * max(size), *size
            )
            opened.update_camera(guess)
