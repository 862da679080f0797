"""Compare reconstructed clouds of rendered scenes with what the model "as seen" makes of them.

For each scene the cloud of the dense stage and the model's cloud, thinned to the same number of
points on the tree, are measured by the radius of the wood
(cherrypicker_lab/orchard/seen/as_seen_fit.py); writes the figures as JSON and a plot of both
side by side. Example, after `snakemake benchmark_dense`:

    python scripts/lab/compare_as_seen.py --scenes stereo_vase --poses '' \\
        --clouds results/benchmark/dense/stereo_vase/true/full/cpu/cloud.ply \\
        --truth results/benchmark/scenes/stereo_vase/truth --table fit.json --plot fit.png
"""

import json
from pathlib import Path

import numpy as np

import lab_path  # noqa: F401
from cherrypicker.files import atomic_path, write_json
from cherrypicker.pointcloud import read_cloud
from cherrypicker.poses import read_poses
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.dense.scoring import place
from cherrypicker_lab.dense.surface import judge_points
from cherrypicker_lab.dense.truth import load_true_surface
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.scene.presets import PRESETS
from cherrypicker_lab.orchard.seen.as_seen import AsSeen, see_scene
from cherrypicker_lab.orchard.seen.as_seen_fit import describe_cloud, plot_fit

MODEL_POINTS = 300_000


def main(scenes, clouds, poses, truth, table, *, plot="", options=(), most=150_000):
    """Measure both clouds of each scene, then write and plot."""
    options = list(options) or ["{}"] * len(scenes)
    report = {}
    for name, cloud, own, true, given in zip(scenes, clouds, poses, truth, options):
        surface = load_true_surface(true)
        found = read_cloud(cloud, required=("colors",))
        points, _ = place(found.points, own, true, surface, "surface" if own else "none")
        seen = see_scene(
            generate_scene(**PRESETS[name]["scene"]), MODEL_POINTS, np.random.default_rng(0),
            AsSeen(**json.loads(given)), extent=1.7, ground_share=0.15,
            poses=read_poses(Path(true) / "poses.npz"), look=False,
        )  # fmt: skip
        pairs = {"found": (points, found.colors), "model": (seen["points"], seen["colors"])}
        counts = [int(judge_points(p, surface).sum()) for p, _ in pairs.values()]
        n = min(*counts, most)
        report[name] = {"options": json.loads(given), "n_points": n}
        for (kind, (p, colors)), count in zip(pairs.items(), counts):
            keep = np.random.default_rng(1).random(len(p)) < n / count
            report[name][kind] = describe_cloud(p[keep], colors[keep], surface)
    write_json(table, report)
    if plot:
        with atomic_path(plot) as partial:
            plot_fit(report, partial)


parser = stage_parser(__doc__)
parser.add_argument("--scenes", nargs="+", required=True, help="presets of render_scene.py")
parser.add_argument("--clouds", nargs="+", required=True, help="reconstructed clouds, PLY")
parser.add_argument("--poses", nargs="+", required=True, help="poses NPZ of their frame; '': true")
parser.add_argument("--truth", nargs="+", required=True, help="SCENE/truth")
parser.add_argument("--options", nargs="+", default=(), help="JSON of AsSeen's fields, per scene")
parser.add_argument(
    "--most", type=int, default=150_000, help="points on the tree that are compared"
)
parser.add_argument("--table", required=True, help="JSON to write")
parser.add_argument("--plot", default="", help="PNG to write")
run(main, parser, globals().get("snakemake"))
