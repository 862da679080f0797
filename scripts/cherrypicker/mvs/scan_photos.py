"""The photos of a scan as witnesses: its cameras in some frame, and what each photo shows."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.mvs.backends.map_keys import GEOMETRIC
from cherrypicker.mvs.raster import read_raster
from cherrypicker.mvs.workspace import Workspace, view_of
from cherrypicker.poses import Poses

# What poses and the middle of a tube may be off at best, px. At half of it, one place in a thousand
# inside of wood was refuted by a photo on two scenes with truth, at this none
SLACK_PX = 1.0


class ScanPhotos(Workspace):
    """A dense workspace whose cameras stand in a frame of one's own, and what its photos show.

    Parameters
    ----------
    folder : path-like
        The dense workspace.
    rasters : path-like
        Folder of what each photo shows, see `cherrypicker.mvs.raster`.
    poses : Poses, optional
        Of the same photos, in another frame and unit; photos without one are left out. The
        workspace's own where none are given.
    several : bool, default False

    Raises
    ------
    StageError
        As `Workspace`, and when no photo has a pose.
    """

    def __init__(
        self,
        folder: str | os.PathLike,
        rasters: str | os.PathLike,
        poses: Poses | None = None,
        *,
        several: bool = False,
    ):
        super().__init__(folder, several=several)
        self._rasters = Path(rasters)
        # Of a depth map's unit, in that of the poses
        self.unit = 1.0
        self._turn, self._shift = np.eye(3), np.zeros(3)
        if poses is not None:
            own = self.poses
            row = {name: i for i, name in enumerate(poses.names.tolist())}
            kept = np.flatnonzero([name in row for name in own.names.tolist()])
            if not len(kept):
                raise StageError("no undistorted photo has a pose", file=folder)
            there = np.array([row[name] for name in own.names[kept].tolist()])
            self.poses = replace(
                own.select(kept),
                cam_from_world=poses.cam_from_world[there],
                error_px=poses.error_px[there],
            )
            self.unit = _spread(self.poses.centers) / max(_spread(own.centers[kept]), 1e-12)
            self._turn = self.poses.rotations[0].T @ own.rotations[kept[0]]
            self._shift = self.poses.centers[0] - self.unit * self._turn @ own.centers[kept[0]]
            self.views = [view_of(self.poses, i) for i in range(len(kept))]
        self.slack_px = SLACK_PX + np.nan_to_num(self.poses.error_px)

    def raster(self, i: int) -> np.ndarray:
        """What photo ``i`` shows, (height, width) uint8."""
        view = self.views[i]
        path = self._rasters / f"{Path(view.name).stem}.png"
        return read_raster(path, (view.height, view.width))

    def depth(self, i: int) -> np.ndarray | None:
        """Depth of photo ``i`` in the unit of its pose, (height, width), 0 where unknown."""
        view = self.views[i]
        if not self.depth_path(view, GEOMETRIC).exists():
            return None
        return self.unit * self.read_depth(view, GEOMETRIC)

    def placed(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 3) of the workspace's own frame in that of the poses."""
        return self.unit * points @ self._turn.T + self._shift


def _spread(centers: np.ndarray) -> float:
    return float(np.linalg.norm(centers - centers.mean(axis=0), axis=1).mean())
