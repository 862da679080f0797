"""The size of a tree's scan, from the headers of its photos or of its cloud."""

from __future__ import annotations

from collections.abc import Mapping

from cherrypicker.batch.photo_sizes import PhotoSizes
from cherrypicker.batch.resources import ScanSize, size_of_cloud, size_of_photos
from cherrypicker.batch.trees import Tree
from cherrypicker.errors import StageError
from cherrypicker.photos import photos_in


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
    sizes = known.of(photos_in(tree.photos))
    if not sizes:
        raise StageError(
            f"tree {tree.tree}: the folder holds no photo that can be read",
            file=tree.photos,
            key="photos in trees.tsv",
        )
    return size_of_photos(sizes, settings)
