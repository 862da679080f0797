"""Pixel sizes of photos from their headers alone, remembered between runs."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Iterable
from pathlib import Path

from PIL import Image, UnidentifiedImageError

from cherrypicker.files import write_text

logger = logging.getLogger(__name__)

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
        """Return (width, height) in px of every photo whose header can be read.

        A photo that is missing or no image is left out: to report it is the first stage's work.
        """
        return [size for photo in photos if (size := self._size_of(photo)) is not None]

    def save(self) -> None:
        """Write what was learnt; a folder that takes no file only loses the cache."""
        if not self._has_news:
            return
        try:
            write_text(self._cache_file, json.dumps(self._known, separators=(",", ":")) + "\n")
            self._has_news = False
        except OSError as error:
            logger.info("photo sizes are not remembered: %s", error)

    def _size_of(self, photo: str | os.PathLike) -> tuple[int, int] | None:
        try:
            stat = os.stat(photo)
            key = os.path.abspath(photo)
            stamp = [stat.st_mtime_ns, stat.st_size]
            entry = self._known.get(key)
            if not entry or entry[:2] != stamp:
                with Image.open(photo) as image:
                    entry = [*stamp, *image.size]
                self._known[key] = entry
                self._has_news = True
            return entry[2], entry[3]
        except (
            OSError,
            UnidentifiedImageError,
            SyntaxError,
            ValueError,
            Image.DecompressionBombError,
        ):
            return None

    def _load(self) -> dict[str, list[int]]:
        try:
            known = json.loads(self._cache_file.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        if not isinstance(known, dict):
            return {}
        return {path: entry for path, entry in known.items() if _is_entry(entry)}


def _is_entry(entry: object) -> bool:
    return isinstance(entry, list) and len(entry) == 4 and all(type(i) is int for i in entry)
