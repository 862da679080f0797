"""Measure how many buds are found in rendered close-ups, by the size of a pixel.

The scenes are folders of `render_scene.py --close_ups` of the same pixels, whose photos are halved
again and again; axes are the true ones. Writes a table. Example:

    python scripts/lab/measure_buds.py --scenes 9101 9102 --pixel_mm 0.5 --output buds.md
"""

import tempfile
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np

import lab_path  # noqa: F401
from cherrypicker.bearing.buds import find_buds
from cherrypicker.files import read_json, write_text
from cherrypicker.runner import run, stage_parser
from cherrypicker.skeleton import axes, read_skeleton_csv
from cherrypicker_lab.bearing.buds import close_ups, score_buds
from cherrypicker_lab.tables import markdown_table

HALVINGS = 4


def main(
    scenes: Annotated[Sequence[str], "folders of rendered close-ups"],
    pixel_mm: Annotated[float, "size of their pixels"],
    output: Annotated[str, "Markdown to write"],
) -> None:
    """Look at each scene with ever fewer pixels, and add up by how dense its buds are."""
    sums = defaultdict[float, np.ndarray](lambda: np.zeros((HALVINGS, 4)))
    for scene in map(Path, scenes):
        skeleton = read_skeleton_csv(scene / "truth" / "skeleton.csv")
        per_m = read_json(scene / "truth" / "scene.json")["options"]["buds"]
        for halvings in range(HALVINGS):
            with tempfile.TemporaryDirectory() as folder:
                buds = find_buds(skeleton, axes(skeleton), close_ups(scene, halvings, folder))
            sums[per_m][halvings] += list(score_buds(skeleton, buds, scene / "truth").values())
    header = ["pixel", *(f"{per_m:.0f} buds a metre" for per_m in sorted(sums))]
    rows = [
        [f"{pixel_mm * 2**halvings:g} mm"]
        + [
            f"{right:.0f} of {true:.0f} on {told:.1f} m, {false:.0f} false"
            for told, true, right, false in (sums[per_m][halvings] for per_m in sorted(sums))
        ]
        for halvings in range(HALVINGS)
    ]
    write_text(output, markdown_table(header, rows))


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
