"""Pixel sizes of photos from their headers alone, remembered between runs."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Iterable
from pathlib import Path

from cherrypicker.errors import StageError
from cherrypicker.files import write_text
from cherrypicker.intake.prepare import size_of_capture

logger = logging.getLogger(__name__)

# Photos that a second of film gives: a slow walk round a tree takes 40 s and gives 40 (guess)
FRAMES_PER_S = 1.0
CACHE_FILE = Path(".snakemake/photo_sizes.json")


class PhotoSizes:
    """Width and height of photos, read once per file as long as the file does not change.

    A header costs an opened file, which on a network file system is a few milliseconds: with some
    thousand photos worth remembering.

    Parameters
    ----------
    cache_file : path-like, optional
        Where sizes are kept between runs; unreadable content is ignored, it is only a cache.
    """

    def __init__(self, cache_file: str | os.PathLike = CACHE_FILE) -> None:
        self._cache_file = Path(cache_file)
        self._known = self._load()
        self._has_news = False

    def of(self, photos: Iterable[str | os.PathLike]) -> list[tuple[int, int]]:
        """Return (width, height) in of all photos whose header can be read, and of a film's frames.

        A photo that is missing or no image is left out: to report it is the first stage's work.
        """
        found: list[tuple[int, int]] = []
        for photo in photos:
            if entry := self._entry_of(photo):
                width, height, seconds = entry[2:]
                n_frames = max(round(FRAMES_PER_S * seconds), 1)
                found += [(int(width), int(height))] * n_frames
        return found

    def save(self) -> None:
        """Write what was learnt; a folder that takes no file only loses the cache."""
        if not self._has_news:
            return
        try:
            write_text(self._cache_file, json.dumps(self._known, separators=(",", ":")) + "\n")
            self._has_news = False
        except OSError as error:
            logger.info("photo sizes are not remembered: %s", error)

    def _entry_of(self, photo: str | os.PathLike) -> list | None:
        try:
            stat = os.stat(photo)
            key = os.path.abspath(photo)
            stamp = [stat.st_mtime_ns, stat.st_size]
            entry = self._known.get(key)
            if not entry or entry[:2] != stamp:
                entry = [*stamp, *size_of_capture(photo)]
                self._known[key] = entry
                self._has_news = True
            return entry
        except (OSError, StageError):
            return None

    def _load(self) -> dict[str, list]:
        try:
            known = json.loads(self._cache_file.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        if not isinstance(known, dict):
            return {}
        return {path: entry for path, entry in known.items() if _is_entry(entry)}


def _is_entry(entry: object) -> bool:
    return (
        isinstance(entry, list)
        and len(entry) == 5
        and all(type(value) is int for value in entry[:4])
        and isinstance(entry[4], float)
        and 0.0 <= entry[4] <= entry[1]  # seconds, of so many bytes
    )
