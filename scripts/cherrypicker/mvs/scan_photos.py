"""The photos of a scan as witnesses: its cameras in some frame, and what each photo shows."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.intake.masks import read_grey
from cherrypicker.mvs.depth_rasters import read_depth_raster
from cherrypicker.poses import Poses, View

# What poses and the middle of a tube may be off at best, px. At half of it, one place in a thousand
# inside of wood was refuted by a photo on two scenes with truth, at this none
SLACK_PX = 1.0


class ScanPhotos:
    """A scan's undistorted photos with their cameras in a frame of one's own, and what they show.

    The ``cameras`` of the undistorted photos are in COLMAP's frame, ``poses`` of the same photos in
    another frame and unit: photos without one are left out. Where none are given they are the
    cameras' own. What each photo shows lies in the folder ``evidence`` (`cherrypicker.mvs.raster`),
    how far that is in ``depth`` (`cherrypicker.mvs.depth_rasters`). ``read_photo`` takes a photo's
    name and its longer side, px, -1 for that which it is stored with, and returns it, (height,
    width, 3) uint8.

    Raises
    ------
    StageError
        When no photo has a pose.
    """

    def __init__(
        self,
        cameras: Poses,
        evidence: str | os.PathLike,
        poses: Poses | None = None,
        *,
        depth: str | os.PathLike | None = None,
        read_photo: Callable[[str, int], np.ndarray] | None = None,
    ):
        self._evidence, self._depth, self._read_photo = Path(evidence), depth, read_photo
        poses = cameras if poses is None else poses
        row = {name: i for i, name in enumerate(poses.names.tolist())}
        kept = np.flatnonzero([name in row for name in cameras.names.tolist()])
        if not len(kept):
            raise StageError("no undistorted photo has a pose", file=self._evidence)
        there = np.array([row[name] for name in cameras.names[kept].tolist()])
        self.poses = replace(
            cameras.select(kept),
            cam_from_world=poses.cam_from_world[there],
            error_px=poses.error_px[there],
        )
        # Of a depth's unit, in that of the poses
        self.unit = _spread(self.poses.centers) / max(_spread(cameras.centers[kept]), 1e-12)
        self._turn = self.poses.rotations[0].T @ cameras.rotations[kept[0]]
        self._shift = self.poses.centers[0] - self.unit * self._turn @ cameras.centers[kept[0]]
        self.views = list(self.poses)
        self.slack_px = SLACK_PX + np.nan_to_num(self.poses.error_px)

    def raster(self, i: int) -> np.ndarray:
        """What photo ``i`` shows, (height, width) uint8."""
        view = self.views[i]
        path = self._evidence / f"{Path(view.name).stem}.png"
        raster = read_grey(path, "what the photo shows")
        view.check_size(raster, path)
        return raster

    def photo(self, i: int) -> np.ndarray:
        """Photo ``i`` itself, (height, width, 3) uint8."""
        assert self._read_photo is not None
        view = self.views[i]
        photo = self._read_photo(view.name, max(view.width, view.height))
        view.check_size(photo, self._evidence)
        return photo

    def at_full_size(self, i: int) -> tuple[np.ndarray, np.ndarray, View]:
        """Photo ``i`` with all pixels that it is stored with, what it shows, and its camera."""
        assert self._read_photo is not None
        photo, pose = self._read_photo(self.views[i].name, -1), self.poses.select(np.array([i]))
        height, width = photo.shape[:2]
        raster = cv2.resize(self.raster(i), (width, height), interpolation=cv2.INTER_NEAREST)
        return photo, raster, pose.resized(np.array([width]), np.array([height]))[0]

    def depth(self, i: int) -> np.ndarray | None:
        """Depth of photo ``i`` in the unit of its pose, (height, width), 0 where unknown."""
        found = read_depth_raster(Path(self._depth), self.views[i].name) if self._depth else None
        return None if found is None else self.unit * found

    def placed(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 3) of the cameras' own frame in that of the poses."""
        return self.unit * points @ self._turn.T + self._shift


def _spread(centers: np.ndarray) -> float:
    return float(np.linalg.norm(centers - centers.mean(axis=0), axis=1).mean())
