"""Work on a private copy of a COLMAP database, watch it grow, and publish it whole."""

from __future__ import annotations

import os
import shutil
import sqlite3
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

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

    def watch(bar: Progress) -> None:
        for line in counter.stdout or ():
            done = int(line) - before
            if done > bar.done:
                bar.step(done - bar.done)

    with Progress(total, what) as bar:
        counter = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        watcher = threading.Thread(target=watch, args=(bar,), daemon=True)
        watcher.start()
        try:
            yield
        finally:
            counter.kill()
            counter.wait()
            watcher.join()
            for stream in (counter.stdin, counter.stdout):
                if stream is not None:
                    stream.close()
        bar.step(max(count_rows(database, table) - before - bar.done, 0))


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


def verified_inliers(database: Path, min_inliers: int) -> dict[str, dict[str, int]]:
    """Return, by photo, the photos it has a verified pair with and the matches of each pair."""
    result: dict[str, dict[str, int]] = {}
    with pycolmap.Database.open(database) as opened:
        names = {image.image_id: image.name for image in opened.read_all_images()}
        pair_ids, n_inliers = opened.read_two_view_geometry_num_inliers()
        for pair_id, n in zip(pair_ids, n_inliers):
            if n < min_inliers:
                continue
            first, second = (names[i] for i in pycolmap.pair_id_to_image_pair(pair_id))
            result.setdefault(first, {})[second] = int(n)
            result.setdefault(second, {})[first] = int(n)
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
