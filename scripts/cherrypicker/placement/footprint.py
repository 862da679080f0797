"""The region of interest seen from above: a disc, or a box where no common place is looked at."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cherrypicker.errors import StageError
from cherrypicker.files import read_json


@dataclass(frozen=True)
class Footprint:
    """Vertical shadow of a region of interest."""

    center_xy: np.ndarray  # (2,): below what the cameras look at
    radius: float  # of the disc; of a box half its longer side
    # ndarray of shape (2, 2) or None: lower and upper x/y corner where the region is a box; None
    # for the disc
    box: np.ndarray | None = None

    @classmethod
    def of_box(cls, places: npt.ArrayLike) -> Footprint:
        """The footprint of the box around places, (n, 2)."""
        box = np.stack([np.min(places, axis=0), np.max(places, axis=0)]).astype(np.float64)
        return cls(box.mean(axis=0), float(np.ptp(box, axis=0).max()) / 2, box)

    @classmethod
    def from_dict(cls, content: Mapping) -> Footprint:
        """What `as_dict` wrote, or the content of crop.json, aligned frame."""
        box = None if content.get("source") == "region" else content.get("box")
        try:
            return cls(
                np.asarray(content["center_xy"], dtype=np.float64).reshape(2),
                float(content["radius"]),
                None if box is None else np.stack([box["x"], box["y"]], axis=1).astype(np.float64),
            )
        except (TypeError, ValueError) as error:
            raise StageError(
                f"the region of interest is none: {error}", key="crop.margin_fraction"
            ) from error

    def as_dict(self) -> dict:
        """Content for JSON: ``center_xy``, ``radius``, and ``box`` (None for a disc)."""
        box = None if self.box is None else {"x": self.box[:, 0], "y": self.box[:, 1]}
        return {"center_xy": self.center_xy, "radius": self.radius, "box": box}

    def limits(self) -> np.ndarray:
        """Lower and upper x/y corner of what encloses the footprint, (2, 2)."""
        if self.box is not None:
            return self.box
        return np.stack([self.center_xy - self.radius, self.center_xy + self.radius])

    def inward(self, xy: np.ndarray) -> np.ndarray:
        """How far places (n, 2) lie within the border, (n,); negative outside."""
        if self.box is not None:
            return np.minimum(xy - self.box[0], self.box[1] - xy).min(axis=1)
        return self.radius - self.from_center(xy)

    def from_center(self, xy: np.ndarray) -> np.ndarray:
        """Horizontal distance of places (n, 2) from the centre, (n,)."""
        return np.linalg.norm(xy - self.center_xy, axis=1)

    def widened(self, fraction: float) -> Footprint:
        """Widened on each side by a fraction of its extent; narrowed by a negative one."""
        if self.box is not None:
            return Footprint.of_box(self.box + fraction * np.ptp(self.box, axis=0) * [[-1], [1]])
        return Footprint(self.center_xy, self.radius * (1.0 + 2.0 * fraction))

    def scaled(self, factor: float) -> Footprint:
        """The footprint in a frame that is scaled about its origin."""
        box = None if self.box is None else factor * self.box
        return Footprint(factor * self.center_xy, factor * self.radius, box)


def read_region(path: str | os.PathLike | None) -> Footprint | None:
    """The region of interest that metric.json holds; None without a file or a region."""
    content = read_json(path)["region"] if path else None
    return Footprint.from_dict(content) if content else None
