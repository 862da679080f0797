"""Find the trees of one scan, and which wood is whose.

Reads segmented.ply and limbs.npz (and, for a scan from photos, metric.json), writes trees.json and
owners.npz: ``owner`` int16 a point, the number of its tree, 0 for other wood, -1 for what is none.
Example:

    python scripts/find_trees.py --segmented segmented.ply --limbs limbs.npz --trees trees.json \
        --owners owners.npz --target_xy all
"""

from collections.abc import Sequence
from typing import Annotated, Any

from cherrypicker.files import read_json, write_json, write_npz
from cherrypicker.limbs.files import read_orchard
from cherrypicker.placement.footprint import Footprint
from cherrypicker.pointcloud import read_cloud
from cherrypicker.runner import run, stage_parser
from cherrypicker.wood.row import ALL, find_trees, read_places


def main(
    segmented: Annotated[str, "labelled cloud"],
    limbs: Annotated[str, "limbs.npz of the scan"],
    trees: Annotated[str, "the trees, and what else stands there, JSON to write"],
    owners: Annotated[str, "the tree of each point, NPZ to write"],
    metric: Annotated[str | None, "metric.json of a scan from photos"] = None,
    scan: Annotated[str, "name of the scan, from which its trees have theirs"] = "scan",
    *,
    target_xy: Sequence[str] = ALL,
) -> None:
    cloud = read_cloud(segmented, required=("label",))
    frame: dict[str, Any] = read_json(metric) if metric else {"factor": 1.0, "region": None}
    places = read_places(target_xy)
    found = find_trees(
        cloud,
        read_orchard(limbs),
        places if isinstance(places, str) else frame["factor"] * places,
        region=Footprint.from_dict(frame["region"]) if frame["region"] else None,
    )
    write_npz(owners, owner=found.owner)
    write_json(trees, found.report(scan, factor=frame["factor"], unit=cloud.unit))


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
