"""The size of a tree's scan, from the headers of its photos or of its cloud."""

from __future__ import annotations

from collections.abc import Mapping

from cherrypicker.batch.photo_sizes import PhotoSizes
from cherrypicker.batch.resources import ScanSize, size_of_cloud, size_of_photos
from cherrypicker.batch.trees import Tree
from cherrypicker.errors import StageError
from cherrypicker.intake.kinds import are_plain, captures_in
from cherrypicker.intake.prepare import is_too_large


def size_of_tree(tree: Tree, settings: Mapping, known: PhotoSizes) -> ScanSize:
    """Return how large a tree's scan is.

    Parameters
    ----------
    settings : mapping
        The tree's whole config.
    known : PhotoSizes
        Reads headers, and remembers them.

    Raises
    ------
    StageError
        If its folder holds no photo that can be read.
    """
    if not tree.is_photo_scan:
        return size_of_cloud(tree.cloud)
    scan = size_of_photo_scan(tree, settings, known)
    if not scan.n_photos:
        raise StageError(
            f"tree {tree.tree}: the folder holds no photo that can be read",
            file=tree.photos,
            key="photos in trees.tsv",
        )
    return scan


def size_of_photo_scan(
    tree: Tree, settings: Mapping, known: PhotoSizes, *, stereo: str = "cpu"
) -> ScanSize:
    """Return how large a scan from photos is; empty where no photo can be read.

    Parameters
    ----------
    stereo : str
        The backend of its depth maps.
    """
    captures = captures_in(tree.photos)
    sizes, limit = known.of(captures), settings["photos"]["max_size_px"]
    is_prepared = (
        bool(tree.masks)
        or not are_plain(captures)
        or any(is_too_large(size, limit) for size in sizes)
    )
    return size_of_photos(sizes, settings, stereo=stereo, is_prepared=is_prepared)
