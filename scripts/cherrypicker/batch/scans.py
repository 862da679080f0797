"""A tree's scan before anything is run: its size by headers, and what is wrong with it."""

import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path

from cherrypicker.batch.batch import Batch
from cherrypicker.batch.resources import ScanSize, asked_for, count_points, size_of_photos
from cherrypicker.batch.trees import Tree
from cherrypicker.errors import StageError
from cherrypicker.files import files_with
from cherrypicker.intake.kinds import are_plain, captures_in, list_captures
from cherrypicker.intake.prepare import is_too_large, size_of_capture
from cherrypicker.markers.references import check_scale
from cherrypicker.photos import PHOTOS_COLUMN


def sizes_of(captures: Iterable[Path]) -> list[tuple[int, int]]:
    """Return width and height of photos and of a film's frames, px, by their headers.

    One that is missing or no image is left out: to report it is the first stage's work.
    """
    found: list[tuple[int, int]] = []
    for path in captures:
        with suppress(OSError, StageError):
            width, height, seconds = size_of_capture(path)
            # A second of film gives a photo: a slow walk round a tree takes 40 s and gives 40
            found += [(width, height)] * max(round(seconds), 1)
    return found


def size_of_scan(row: Tree, settings: Mapping) -> ScanSize:
    """Return how large a scan is by its whole config; empty where no header can be read."""
    if not row.is_photo_scan:
        kind = "labelled" if row.has_labelled_cloud() else "unlabelled"
        kinds, n = ("clouds", kind, *asked_for(settings)), count_points(row.cloud) / 1e6
        return ScanSize(kinds, points_m=n, most_points_m=n, most_cropped_m=n)
    captures = captures_in(row.photos)
    sizes, limit = sizes_of(captures), settings["photos"]["max_size_px"]
    is_prepared = (
        bool(row.masks)
        or not are_plain(captures)
        or any(is_too_large(size, limit) for size in sizes)
    )
    return size_of_photos(sizes, settings, is_prepared=is_prepared)


class Scans:
    """What stands before each tree's first stage: its files, their size, what is wrong with them.

    Files that are missing are left out, for the first stage to report.
    """

    def __init__(self, batch: Batch) -> None:
        self._batch = batch
        self._size = cache(lambda scan: size_of_scan(batch.trees[scan], batch.settings_of[scan]))

    def size(self, tree: str) -> ScanSize:
        """Return how large the scan is that a tree is from."""
        return self._size(self._batch.scan_of(tree))

    def sizes(self) -> dict[str, ScanSize]:
        """Return how large each scan of the table is."""
        return {scan: self.size(scan) for scan in self._batch.trees}

    def captures(self, tree: str) -> list[str]:
        """Return what lies in the folder of photos."""
        return _plain(captures_in(self._batch.row(tree).photos))

    def photo_folder(self, tree: str) -> str:
        """Return the folder of the photos that stages read: a user's, or that of prepared ones."""
        is_prepared = self.size(tree).is_prepared
        prepared = f"results/{self._batch.scan_of(tree)}/photos"
        return prepared if is_prepared else self._batch.row(tree).photos

    def photos(self, tree: str) -> list[str]:
        """Return the photos that stages read, or the folder of prepared ones; none for a cloud."""
        if not self._batch.row(tree).is_photo_scan:
            return []
        return [self.photo_folder(tree)] if self.size(tree).is_prepared else self.captures(tree)

    def masks(self, tree: str) -> list[str]:
        """Return a tree's own masks."""
        return _plain(files_with(self._batch.row(tree).masks or "-", (".png",)))

    def cloud(self, tree: str) -> list[str]:
        """Return the ready cloud."""
        path = Path(self._batch.row(tree).cloud)
        return _plain([path]) if path.is_file() else []

    def problem(self, tree: str) -> dict:
        """Return what is wrong with a scan from photos, for its first stages to refuse it.

        These are the arguments of a `StageError`; {} if nothing is wrong.
        """
        row, scale = self._batch.row(tree), self._batch.settings_for(tree)["scale"]
        try:
            captures = list_captures(row.photos)
        except StageError as error:
            return error.arguments()
        odd = sorted({*map(str, captures)} - {*_plain(captures)})
        if odd:
            cause = "Snakemake cannot take a path with {name} or <name> in it; rename the photo"
            return {"cause": cause, "file": odd[0], "key": PHOTOS_COLUMN}
        columns = row.marker_dictionary, row.marker_sides_m
        try:
            check_scale(row.scale, scale["mode"], *columns, scale["references"])
        except StageError as error:
            is_column = not str(error.key).startswith("scale.")
            file = self._batch.settings["trees"] if is_column else None
            return error.arguments() | {"file": file}
        return {}


def _plain(paths: Iterable[Path]) -> list[str]:
    """Those that Snakemake takes as they are: it fills in {name} and <name>, with no way out."""
    from snakemake.io import contains_wildcard
    from snakemake.pathvars import PATHVAR_REGEX

    texts = map(str, paths)
    return [one for one in texts if not (contains_wildcard(one) or re.search(PATHVAR_REGEX, one))]
