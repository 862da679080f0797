"""Choose the target tree by its wood, and move it onto the axes of its limbs, or contract it as
published (S-LBC or LBC).

Reads segmented.ply and limbs.npz (and metric.json for a tree from photos, tree.json for one of
several in a scan), writes target.json, contracted.ply, contract.json and removed.ply: all points
that the stages up to here took out, with a field ``removed_by``
(:class:`cherrypicker.classes.Removal`). Example:

    python scripts/contract_cloud.py --segmented segmented.ply --limbs limbs.npz \
        --contracted contracted.ply --report contract.json --target target.json \
        --removed removed.ply --method slbc
"""

from typing import Annotated, Any

import numpy as np

from cherrypicker.contraction.contract_points import SkeletonOptions
from cherrypicker.contraction.contract_wood import contract_wood
from cherrypicker.files import read_json, write_json
from cherrypicker.limbs.files import read_orchard
from cherrypicker.placement.footprint import Footprint
from cherrypicker.pointcloud import read_cloud, write_cloud
from cherrypicker.runner import run, stage_parser
from cherrypicker.wood.removed import Earlier, read_removed_by, removed_points
from cherrypicker.wood.target import target_report
from cherrypicker.wood.thinned import GrowthOptions


def main(
    segmented: Annotated[str, "labelled cloud"],
    contracted: Annotated[str, "contracted points, PLY"],
    report: Annotated[str, "what was cut, and how it went, JSON"],
    target: Annotated[str, "which tree it is, and the others, JSON"],
    removed: Annotated[str, "points that were taken out, PLY"],
    metric: Annotated[str | None, "metric.json of a tree from photos, or a row's tree.json"] = None,
    limbs: Annotated[str | None, "limbs.npz of the cloud's trees; else they are grown"] = None,
    aligned: Annotated[str | None, "cloud before the crop"] = None,
    cropped: Annotated[str | None, "cloud after the crop"] = None,
    denoised_by: Annotated[str | None, "denoise.npz of the cropped cloud"] = None,
    *,
    target_xy: tuple[float, float] | None = None,
    wood: GrowthOptions,
    options: SkeletonOptions,
) -> None:
    cloud = read_cloud(segmented, required=("label",))
    scan: dict[str, Any] = {"unit": cloud.unit, "factor": 1.0, "region": None}
    if metric:
        scan |= read_json(metric)
        scan["region"] = Footprint.from_dict(scan["region"]) if scan["region"] else None
    place = scan.pop("target_xy", None)  # of a tree that was found among others
    if target_xy:
        place = scan["factor"] * np.array(target_xy)
    points, details = contract_wood(
        cloud,
        wood,
        options=options,
        target_xy=place,
        region=scan["region"],
        orchard=read_orchard(limbs) if limbs else None,
    )
    write_cloud(contracted, points)
    del details["limbs"]
    earlier = None
    if aligned and cropped and denoised_by:
        before = read_cloud(cropped)
        by = read_removed_by(denoised_by, before)
        earlier = Earlier(read_cloud(aligned), before, by, scan["factor"])
    taken = removed_points(cloud, details.pop("owner"), details["stem"], earlier)
    write_cloud(removed, taken, may_be_empty=True)
    scan["loose"] = details["wood"].pop("loose")
    write_json(target, target_report(details.pop("choice"), **scan))
    write_json(report, details)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
