"""A skeleton as even samples of its wood: what two dates are compared by."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cherrypicker.geometry.lines import Line
from cherrypicker.geometry.similarity import moved
from cherrypicker.skeleton import Axis, Skeleton, axes

STEP_M = 0.01  # of the samples, as the graph stage sets its nodes
PIECE_M = 0.12  # of wood that says one thing: its noise is one, a scan misses it as one (guess)


@dataclass
class Wood:
    """Samples of a skeleton, parents before children."""

    points: np.ndarray  # (n, 3) float64, metres
    radius: np.ndarray  # (n,) float64, metres
    length: np.ndarray  # (n,) float64: of the stretch from the parent to the sample, metres
    parent: np.ndarray  # (n,) int64: sample towards the root, -1 for the first
    axis: np.ndarray  # (n,) int64: as `skeleton.axes` lists them
    along: np.ndarray  # (n,) float64: way along its axis from what it hangs on, metres
    at_node: np.ndarray  # (n_nodes,) int64: the sample at each node of the skeleton

    def __len__(self) -> int:
        return len(self.points)

    def moved(self, frame: np.ndarray) -> Wood:
        """The same wood in another frame; `frame` has shape (4, 4)."""
        return replace(self, points=moved(self.points, frame))

    @property
    def feet(self) -> np.ndarray:
        """Place that each axis hangs on, (n_axes, 3), for the trunk its foot."""
        first = np.flatnonzero(np.diff(self.axis, prepend=-1))
        return self.points[np.maximum(self.parent[first], 0)]

    @property
    def volume(self) -> np.ndarray:
        """Volume of each sample's stretch, (n,) float64, cubic metres."""
        return np.pi * self.radius**2 * self.length


def sample_wood(skeleton: Skeleton, axis_list: list[Axis] | None = None) -> Wood:
    """Sample a skeleton evenly along its axes, by its own radii where they are not given."""
    parts: list[tuple] = []
    nearest = np.zeros(len(skeleton), dtype=np.int64)  # the sample at a node of the skeleton
    n_samples = 0
    for number, axis in enumerate(axis_list or axes(skeleton)):
        line = Line(skeleton.points[axis.way])
        way = line.along
        n_steps = max(round(way[-1] / STEP_M), 1)
        first = 0 if axis.attach < 0 else 1  # what it hangs on is another axis's
        at = way[-1] * np.arange(n_steps + 1) / n_steps
        points, radius = line.at(at), skeleton.radius[axis.wood]
        parent = n_samples + np.arange(n_steps + 1) - first - 1
        parent[first] = nearest[axis.attach] if first else -1
        nearest[axis.nodes] = (
            n_samples - first + np.rint(way[first:] / way[-1] * n_steps).clip(first)
            if way[-1] > 0
            else n_samples
        )
        parts.append(
            (
                points[first:],
                np.interp(at, way, radius)[first:],
                np.append(0.0, np.diff(at))[first:],
                parent[first:],
                np.full(n_steps + 1 - first, number),
                at[first:],
            )
        )
        n_samples += n_steps + 1 - first
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return Wood(*[*columns, nearest])
