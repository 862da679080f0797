"""Measure how far the vertical is off on the six walks, with and without photos' gravity.

Example:

    python scripts/lab/measure_up.py --shifts 0 500 --output up.json
"""

import logging
from collections.abc import Sequence
from typing import Annotated

import numpy as np

import lab_path  # noqa: F401
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.orchard.scene.presets import WALK_PRESETS
from cherrypicker_lab.up_direction import measure_walk

CASES = ("level", "level_gravity", "slope", "slope_gravity")


def main(
    output: Annotated[str, "JSON to write"],
    shifts: Annotated[Sequence[int], "added to the walks' seeds"] = (0,),
) -> None:
    """Measure each walk, save, say the root mean squares."""
    rows = [measure_walk(name, shift) for shift in shifts for name in sorted(WALK_PRESETS)]
    rms = {case: float(np.sqrt(np.mean([row[case] ** 2 for row in rows]))) for case in CASES}
    logging.getLogger("cherrypicker").info("degrees, RMS of %d walks: %s", len(rows), rms)
    write_json(output, {"rms_deg": rms, "walks": rows})


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
