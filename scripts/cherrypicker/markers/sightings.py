"""Things seen in photos whose poses are known, one sighting a row."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Self

import numpy as np


@dataclass(kw_only=True)
class PosedSightings:
    """What sightings of all things have in common."""

    photos: np.ndarray  # (n,) int: index of the photo of each sighting
    cam_from_world: np.ndarray  # (n, 3, 4)
    focal: np.ndarray  # (n,): pixels per unit of normalised coordinates

    def __len__(self) -> int:
        return len(self.photos)

    def select(self, index: np.ndarray) -> Self:
        """The sightings of a mask or an index array."""
        return type(self)(**{each.name: getattr(self, each.name)[index] for each in fields(self)})

    @property
    def centers(self) -> np.ndarray:
        """Camera centres, (n, 3)."""
        rotation, shift = self.cam_from_world[:, :, :3], self.cam_from_world[:, :, 3]
        return -np.einsum("nji,nj->ni", rotation, shift)

    def rays_through(self, places: np.ndarray) -> np.ndarray:
        """Unit directions in the world through normalised places (n, k, 2), (n, k, 3)."""
        homogeneous = np.concatenate([places, np.ones((*places.shape[:2], 1))], axis=2)
        world = np.einsum("nji,nkj->nki", self.cam_from_world[:, :, :3], homogeneous)
        return world / np.linalg.norm(world, axis=2, keepdims=True)

    def depths(self, point: np.ndarray) -> np.ndarray:
        """Distance of a point (3,) along each camera's axis, (n,)."""
        return self.cam_from_world[:, 2, :3] @ point + self.cam_from_world[:, 2, 3]
