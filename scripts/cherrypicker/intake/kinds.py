"""Which files of a folder are pictures, of which kind, and which of them show the same."""

import os
from collections.abc import Iterable
from enum import IntEnum
from pathlib import Path

from cherrypicker.files import files_with
from cherrypicker.photos import PHOTO_SUFFIXES, list_photos


class Kind(IntEnum):
    """Kinds of picture files; of files of one name the lowest is taken."""

    PLAIN = 0  # what COLMAP reads itself
    HEIF = 1
    RAW = 2
    VIDEO = 3


SUFFIXES = {
    Kind.PLAIN: PHOTO_SUFFIXES,
    Kind.HEIF: (".heic", ".heif", ".hif"),
    Kind.RAW: (
        *(".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw"),
        ".raw",
    ),
    Kind.VIDEO: (".mp4", ".mov", ".m4v", ".avi", ".mkv"),
}
_KIND_OF = {suffix: kind for kind, suffixes in SUFFIXES.items() for suffix in suffixes}


def kind_of(path: str | os.PathLike) -> Kind | None:
    """Return the kind of a picture file by its suffix; None for other files."""
    return _KIND_OF.get(Path(path).suffix.lower())


def captures_in(folder: str | os.PathLike) -> list[Path]:
    """Return a folder's pictures and videos, sorted by name; none if it is missing.

    Hidden files are left out, and so is the twin of a picture: of files that share a name but for
    the suffix, a raw beside its JPEG or the film of a phone's live photo, the plainest is taken.
    Plain photos of one name are all kept, for the stages to refuse.
    """
    return [path for path, plainer in _with_twins(folder) if plainer is None]


def twins_in(folder: str | os.PathLike) -> dict[str, str]:
    """Return the names of pictures that are left out, each with that of its plainer twin."""
    return {path.name: plainer.name for path, plainer in _with_twins(folder) if plainer}


def list_captures(folder: str | os.PathLike) -> list[Path]:
    """Return what `captures_in` does.

    Raises
    ------
    StageError
        If the folder is missing or holds neither photo nor video.
    """
    kinds = SUFFIXES[Kind.PLAIN] + SUFFIXES[Kind.HEIF] + SUFFIXES[Kind.VIDEO] + (".dng",)
    wanted = f"no photo and no video ({', '.join(kinds)} or another raw)"
    return list_photos(folder, captures_in, wanted)


def are_plain(captures: Iterable[Path]) -> bool:
    """Whether every stage can read these as they are, but for their size."""
    return all(kind_of(path) is Kind.PLAIN for path in captures)


def _with_twins(folder: str | os.PathLike) -> list[tuple[Path, Path | None]]:
    """Pictures of a folder by name, each with the plainer one of its name, if there is one."""
    kind = {path: _KIND_OF[path.suffix.lower()] for path in files_with(folder, _KIND_OF)}
    # The first of the plainest comes last, and stays
    plainest = {path.stem.lower(): path for path in sorted(kind, key=kind.__getitem__)[::-1]}
    pairs = [(path, plainest[path.stem.lower()]) for path in kind]
    return [(path, best if kind[path] > kind[best] else None) for path, best in pairs]
