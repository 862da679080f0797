"""A finished tree as other tools take it: its skeleton with the radii that its traits report."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from cherrypicker.errors import StageError
from cherrypicker.files import read_json, read_table
from cherrypicker.skeleton import Axis, Skeleton, axes, read_skeleton
from cherrypicker.traits.photo_diameters import with_photos


@dataclass
class Cylinders:
    """One cylinder an edge of the skeleton, an axis's one after the other, as volume goes."""

    start: np.ndarray  # start, end: (n, 3) float64, in the skeleton's unit
    end: np.ndarray
    radius: np.ndarray  # (n,) float64: that of the same volume as the cone between the two nodes
    # (n,) int64: row of the cylinder that it goes on from, always an earlier one; -1 for the first
    parent: np.ndarray
    # branch, order, position: (n,) int64: ``branch_id``, its order, and the place along it, from 0
    branch: np.ndarray
    order: np.ndarray
    position: np.ndarray
    node: np.ndarray  # (n,) int64: the skeleton's node at the cylinder's end

    @property
    def length(self) -> np.ndarray:
        """Length of each cylinder, (n,) float64."""
        return np.linalg.norm(self.end - self.start, axis=1)

    @property
    def direction(self) -> np.ndarray:
        """Unit vector from start to end, (n, 3) float64; up where both are one place."""
        steps, length = self.end - self.start, self.length[:, None]
        up = np.zeros_like(steps) + [0.0, 0.0, 1.0]
        return np.divide(steps, length, out=up, where=length > 0)


@dataclass
class MeasuredTree:
    """A skeleton with its axes, and what the traits say of each."""

    name: str  # of the tree
    skeleton: Skeleton  # radii by points and photos (`cherrypicker.traits.photo_diameters`)
    axis_list: list[Axis]  # the place in the list is the ``branch_id``
    made: str = ""  # when the skeleton was, ISO date and time, UTC
    folder: Path = Path()  # of the tree's results

    @property
    def by_points(self) -> MeasuredTree:
        """The tree with the radii that the points alone tell, by which its axes were found."""
        radius = self.skeleton.fields.get("radius_by_points", self.skeleton.radius)
        return replace(self, skeleton=replace(self.skeleton, radius=radius))

    def axis_radii(self, axis: int) -> np.ndarray:
        """Radii along an axis from the node that it hangs on, (n,) float64: its own."""
        return self.skeleton.radius[self.axis_list[axis].wood]

    def axis_points(self, axis: int) -> np.ndarray:
        """Places along an axis from the node that it hangs on, (n, 3) float64."""
        return self.skeleton.points[self.axis_list[axis].way]

    @cached_property
    def cylinders(self) -> Cylinders:
        """The tree as cylinders."""
        # An edge ends at each node of an axis, but for the root
        ends = [axis.nodes[int(axis.attach < 0) :] for axis in self.axis_list]
        counts = list(map(len, ends))
        node, branch = np.concatenate(ends), np.repeat(np.arange(len(ends)), counts)
        if not len(node):
            raise StageError(f"tree {self.name}: the skeleton has no edge", key="graph")
        above = self.skeleton.parent[node]
        position = np.arange(len(node)) - np.repeat(np.cumsum(counts) - counts, counts)
        # What hangs on the root itself goes on from the first cylinder, as there is one root
        row_of = np.zeros(len(self.skeleton), dtype=np.int64)
        row_of[node] = np.arange(len(node))
        parent = row_of[above]
        parent[0] = -1
        points, radius = self.skeleton.points, self.skeleton.radius
        is_first = (position == 0) & np.array([axis.attach >= 0 for axis in self.axis_list])[branch]
        thick, thin = radius[np.where(is_first, node, above)], radius[node]
        return Cylinders(
            start=points[above],
            end=points[node],
            radius=np.sqrt((thick**2 + thick * thin + thin**2) / 3.0),
            parent=parent,
            branch=branch,
            order=np.array([axis.order for axis in self.axis_list])[branch],
            position=position,
            node=node,
        )


def read_measured_tree(folder: str | os.PathLike) -> MeasuredTree:
    """Read ``skeleton.graphml``, ``branches.csv`` and what photos told of a tree's results.

    Raises
    ------
    StageError
        If one is missing, or they are not of one run.
    """
    folder = Path(folder)
    skeleton = read_skeleton(folder / "skeleton.graphml")
    axis_list = axes(skeleton)
    table = folder / "branches.csv"
    rows = read_table(table, required=("branch_id", "photo_diameter_m"))
    if len(rows) != len(axis_list):
        raise StageError(
            f"tree {folder.name}: {len(rows)} branches in the table, {len(axis_list)} axes in the "
            "skeleton; run measure_traits again",
            file=table,
        )
    # What is left of photos that this tree is no longer from tells nothing
    if told := [branch for branch, (_, row) in enumerate(rows) if row["photo_diameter_m"]]:
        check = folder / "photo_check.json"
        seen = read_json(check)["branches"]
        n_widths = {each["branch_id"]: len(each.get("widths", ())) for each in seen}
        if n_widths != {branch: len(axis_list[branch].nodes) for branch in told}:
            cause = f"tree {folder.name}: not of one run with the skeleton and its branches; "
            raise StageError(f"{cause}run check_photos and measure_traits again", file=check)
        skeleton = with_photos(skeleton, axis_list, seen)
    made = time.gmtime((folder / "skeleton.graphml").stat().st_mtime)
    stamp = time.strftime("%Y-%m-%dT%H:%M:%SZ", made)
    return MeasuredTree(folder.resolve().name, skeleton, axis_list, stamp, folder)
