"""Take one tree out of a scan of several.

Reads the scan's segmented.ply, limbs.npz, trees.json, owners.npz (and, from photos, metric.json),
writes the tree's segmented.ply, limbs.npz and tree.json, which says where it stands. Files that the
scan has for all its trees (shared) are linked beside them. Example:

    python scripts/split_scan.py --segmented row/segmented.ply --grown row/limbs.npz \
        --trees row/trees.json --owners row/owners.npz --tree row_2 --cloud row_2/segmented.ply \
        --limbs row_2/limbs.npz --place row_2/tree.json
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from cherrypicker.errors import StageError
from cherrypicker.files import read_json, read_npz, write_json
from cherrypicker.limbs.files import read_orchard, write_orchard
from cherrypicker.pointcloud import read_cloud, write_cloud
from cherrypicker.runner import run, stage_parser
from cherrypicker.wood.row import rows_of_tree, scan_of_tree


def main(
    segmented: Annotated[str, "labelled cloud of the scan"],
    grown: Annotated[str, "limbs.npz of the scan"],
    trees: Annotated[str, "trees.json of the scan"],
    owners: Annotated[str, "owners.npz of the scan"],
    tree: Annotated[str, "name of the tree, one of trees.json"],
    cloud: Annotated[str, "labelled cloud of the tree to write"],
    limbs: Annotated[str, "its limbs to write"],
    place: Annotated[str, "JSON to write: where it stands"],
    metric: Annotated[str | None, "metric.json of a scan from photos"] = None,
    shared: Annotated[Sequence[str], "files of the scan to link beside the cloud"] = (),
) -> None:
    found = read_json(trees)
    names = [one["tree"] for one in found["trees"]]
    if tree not in names:
        raise StageError(
            f"tree {tree!r} is none of the {len(names)} trees of the scan",
            file=trees,
            key="crop.target_xy",
        )
    scan = read_cloud(segmented, required=("label",))
    owner = read_npz(owners, required=("owner",))["owner"]
    frame: dict[str, Any] = {"unit": scan.unit, "factor": 1.0, "region": None}
    frame |= read_json(metric) if metric else {}
    number = names.index(tree) + 1
    rows = rows_of_tree(scan.points, owner, number, found["trees"][number - 1]["foot"])
    for file in shared:
        link = Path(cloud).with_name(Path(file).name)
        link.unlink(missing_ok=True)
        link.symlink_to(os.path.relpath(file, link.parent))
    write_cloud(cloud, scan.select(rows))
    write_orchard(limbs, read_orchard(grown).select(rows))
    write_json(place, scan_of_tree(found, number, frame))


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
