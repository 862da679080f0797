"""Work on a private copy of a COLMAP database, watch it grow, and publish it whole."""

from __future__ import annotations

import os
import shutil
import sqlite3
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from subprocess import PIPE, Popen

import pycolmap

from cherrypicker.errors import StageError
from cherrypicker.files import atomic_path
from cherrypicker.progress import Progress

# Prefix of the temporary folders beside the databases
SCRATCH = ".sfm."
# Between two counts of the rows of a table
POLL_INTERVAL_S = 1.0


def copy_database(source: str | os.PathLike, copy: Path) -> Path:
    """Copy a database: COLMAP changes even one that it only reads (journal mode, side files).

    Raises
    ------
    StageError
        If the file is missing or no COLMAP database.
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


def count_rows(database: Path, table: str) -> int:
    """Return the number of rows of one of COLMAP's tables; not while pycolmap has it open."""
    with closing(sqlite3.connect(_read_only(database), uri=True, timeout=5)) as connection:
        return connection.execute(f"SELECT COUNT(*) FROM {table}").fetchone()[0]


@contextmanager
def watched_table(database: Path, table: str, total: int, what: str) -> Iterator[None]:
    """Report progress while COLMAP fills ``table``; its own loops offer no callback.

    The rows are counted by a process of its own: pycolmap has its own copy of SQLite, and two
    copies in one process break each other's file locks, which ends in a crash.
    """
    before = count_rows(database, table)
    command = [sys.executable, "-c", _COUNTER, _read_only(database), table, str(POLL_INTERVAL_S)]

    def watch() -> None:
        for line in counter.stdout or ():
            step_to(int(line))

    def step_to(n_rows: int) -> None:
        bar.step(max(n_rows - before - bar.done, 0))

    with Progress(total, what) as bar:
        with Popen(command, stdin=PIPE, stdout=PIPE, text=True, bufsize=1) as counter:
            watcher = threading.Thread(target=watch, daemon=True)
            watcher.start()
            try:
                yield
            finally:
                counter.kill()
                watcher.join()
        step_to(count_rows(database, table))


# Ends with its parent, whose end closes its standard input.
_COUNTER = """
import select, sqlite3, sys
uri, table, interval = sys.argv[1:]
while not select.select([sys.stdin], [], [], float(interval))[0]:
    try:
        connection = sqlite3.connect(uri, uri=True, timeout=5)
        print(*connection.execute(f"SELECT COUNT(*) FROM {table}").fetchone(), flush=True)
        connection.close()
    except sqlite3.Error:
        pass
"""


def _read_only(database: Path) -> str:
    return f"{database.absolute().as_uri()}?mode=ro"


def rename_images(database: Path, new_names: dict[str, str]) -> None:
    """Rename photos in the database, all at once."""
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.executemany(
            "UPDATE images SET name = ? WHERE name = ?",
            [(new, old) for old, new in new_names.items()],
        )


def verified_pairs(
    database: pycolmap.Database, least: int = 1
) -> dict[tuple[int, int], pycolmap.TwoViewGeometry]:
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
    with closing(sqlite3.connect(database)) as connection:
        rows = connection.execute(
            "SELECT name, COALESCE(rows, 0) FROM images LEFT JOIN keypoints USING (image_id) "
            "ORDER BY name"
        ).fetchall()
    return dict(rows)
