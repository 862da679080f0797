"""Measure whether the photos' verdict follows the truth, on finished scans spoilt on purpose.

Reads results/TREE of a scan from photos and SCENE/truth (poses.npz, skeleton.csv). The scan as it
is and spoilt in the ways and sizes of `cherrypicker_lab.spoilt_skeletons` is judged by its photos;
beside it stand true precision and recall at a centimetre, as it is and after what the photos
refute is dropped, and how much of what was added is left. Example, half a minute of a core each:

    python scripts/lab/measure_photo_check.py --results results/cherry_vase \\
        --truth resources/demo/cherry_vase/truth --output verdicts.json

    python scripts/lab/measure_photo_check.py --tables verdicts.json others.json
"""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import lab_path  # noqa: F401
from cherrypicker.files import read_json, write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.photo_verdicts import FinishedScan, markdown
from cherrypicker_lab.spoilt_skeletons import SIZES, spoil

logger = logging.getLogger("cherrypicker")


def main(
    results: Annotated[str, "results/TREE"] = "",
    truth: Annotated[str, "SCENE/truth"] = "",
    output: Annotated[str, "JSON to write"] = "",
    tables: Annotated[Sequence[str], "such JSONs, to print together"] = (),
    kinds: Annotated[Sequence[str], "what to do"] = ("as it is", *SIZES),
    *,
    seed: int = 0,
    threads: int = 1,
) -> None:
    """Judge one scan, spoilt in every way, or join the tables of several."""
    reports = [read_json(path) for path in tables]
    if not tables:
        rows = measure(FinishedScan(Path(results), Path(truth), threads), kinds, seed)
        reports = [{"tree": Path(results).name, "rows": rows}]
        if output:
            write_json(output, reports[0])
    logger.info("%s", markdown(reports), extra={"console": True})


def measure(scan, kinds, seed):
    """Rows of the scan as it is and of every kind and size that it has room for."""
    rows = []
    if "as it is" in kinds:
        rows.append({"kind": "as it is", "size": 0.0, **scan.judge(scan.as_it_is)})
    for kind in kinds:
        for size in SIZES.get(kind, ()):
            try:
                spoilt = spoil(scan.skeleton, scan.cloud, kind, size, seed)
            except ValueError as error:
                logger.warning("%s", error)
                continue
            rows.append({"kind": kind, "size": size, **scan.judge(spoilt)})
            logger.info("%s", rows[-1])
    return rows


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
