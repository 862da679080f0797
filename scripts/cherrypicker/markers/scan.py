"""The registered photos of a tree, and the search for known lengths in them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.lens import read_of_camera
from cherrypicker.markers.layouts import Sightings
from cherrypicker.poses import camera_centers
from cherrypicker.progress import in_threads
from cherrypicker.sfm.export import registered_photos

S = TypeVar("S", bound=Sightings)


@dataclass
class Scan:
    """The registered photos and what else a known length may be looked for in."""

    photos: list[str | Path]
    cameras: list[Any]  # pycolmap.Camera of each
    cam_from_world: np.ndarray  # (n_photos, 3, 4)
    cloud: np.ndarray | None = None  # (n, 3): denoised cloud, aligned frame
    min_images: int = 2  # photos that must agree on a marker or on a board
    side: str = "square"  # as `by` of :func:`cherrypicker.markers.marker_scales.locate_marker`
    threads: int = 1
    seed: int = 0

    @classmethod
    def of(cls, photos: Sequence[str | Path], reconstruction: Any, **options: Any) -> Scan:
        """Of those photos that a pycolmap.Reconstruction holds, by name.

        Raises
        ------
        StageError
            If they are fewer than two.
        """
        paths = {Path(path).name: path for path in photos}
        images = [each for each in registered_photos(reconstruction) if each.name in paths]
        if len(images) < 2:
            raise StageError(
                f"only {len(images)} of the photos are registered in the sparse model",
                key="sfm.min_registered_fraction",
            )
        return cls(
            [paths[image.name] for image in images],
            [reconstruction.cameras[image.camera_id] for image in images],
            np.array([image.cam_from_world().matrix() for image in images]),
            **options,
        )

    @property
    def centers(self) -> np.ndarray:
        """Camera centres, (n_photos, 3)."""
        return camera_centers(self.cam_from_world)

    def search(
        self, find: Callable[[np.ndarray, Any], list[tuple]], what: str, kind: type[S], row: str
    ) -> S:
        """What `find` sees in the photos, in their order, as sightings of a kind.

        It takes a photo's grey values and its camera, and returns a tuple a find: numbers of
        NumPy's types in ``row``, in the order of the fields of the kind from ``places`` on.
        ``what`` is looked for, for the report of progress.

        Raises
        ------
        StageError
            If a photo cannot be read or does not have the size of its camera.
        """

        def search(index: int) -> list[tuple]:
            camera = self.cameras[index]
            photo = read_of_camera(self.photos[index], camera)
            return find(cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY), camera)

        what = f"photos searched for {what}"
        found = list(in_threads(search, range(len(self.photos)), max(1, self.threads), what))
        photos = np.repeat(np.arange(len(found)), [len(each) for each in found])
        focal = np.array([camera.mean_focal_length() for camera in self.cameras])
        table = np.array([one for each in found for one in each], row)
        columns = [table[name] for name in table.dtype.names or ()]
        return kind(photos, self.cam_from_world[photos], focal[photos], *columns)
