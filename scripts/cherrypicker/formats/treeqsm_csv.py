"""TreeQSM's table of cylinders as CSV, with the column names of rTwig's data frame.

Ids are rows from 1, the first cylinder's parent and a tip's extension 0, orders count from 0 at the
stem. rTwig takes the file by ``update_cylinders(read.csv(file))``. References: Raumonen et al.,
Remote Sensing 5(2), 2013, and the manual of TreeQSM 2.4 (structure ``cylinder``); Morales and
MacFarlane, Forestry, 2024 (rTwig).
"""

import os

import numpy as np

from cherrypicker.files import write_text
from cherrypicker.formats.measured import MeasuredTree


def write_treeqsm_csv(path: str | os.PathLike, tree: MeasuredTree) -> None:
    """Write the cylinders of a tree.

    `SurfCov` is the share of the circumference that points cover, `mad` their robust distance to
    the fitted surface, `added` 1 where the skeleton bridges missing data, `UnmodRadius` the radius
    by the points alone.
    """
    rows, skeleton = tree.cylinders, tree.skeleton
    none = np.zeros(len(skeleton))
    arc, spread, gap = (
        skeleton.fields.get(name, none)[rows.node] for name in ("arc_deg", "residual", "gap")
    )
    goes_on = np.append(rows.branch[1:] == rows.branch[:-1], False)
    columns = {
        "radius": rows.radius,
        "length": rows.length,
        **dict(zip(("start.x", "start.y", "start.z"), rows.start.T)),
        **dict(zip(("axis.x", "axis.y", "axis.z"), rows.direction.T)),
        "parent": rows.parent + 1,
        "extension": np.where(goes_on, np.arange(len(rows.node)) + 2, 0),
        "added": gap,
        "UnmodRadius": tree.by_points.cylinders.radius,
        "branch": rows.branch + 1,
        "SurfCov": arc / 360.0,
        "mad": spread,
        "BranchOrder": rows.order,
        "PositionInBranch": rows.position + 1,
    }
    cells = [[f"{value:.9g}" for value in column.tolist()] for column in columns.values()]
    write_text(path, "\n".join([",".join(columns), *map(",".join, zip(*cells))]) + "\n")
