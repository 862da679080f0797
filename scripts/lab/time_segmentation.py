"""Measure CPU time and memory of the segmentation over the number of points, with a plot.

Thins a cloud at random, or fills it up with copies of its points 1.5 mm off, to each size asked
for; each is read, labelled and written in a process of its own. Example:

    python scripts/lab/time_segmentation.py --weights resources/weights/dgcnn.pt \
        --cloud results/cherry_vase/metric.ply --output time.json --figure time.png
"""

import logging
import multiprocessing
import resource
import tempfile
from pathlib import Path

import numpy as np

import lab_path  # noqa: F401
from cherrypicker.files import atomic_path, write_json
from cherrypicker.pointcloud import PointCloud, read_cloud, write_cloud
from cherrypicker.runner import run, stage_parser
from cherrypicker.segmentation.dgcnn import choose_device
from cherrypicker.segmentation.inference import Sampling, segment_cloud

COPY_OFF_M = 0.0015
logger = logging.getLogger("cherrypicker")


def main(weights, cloud, *, output, figure, sizes, seed, threads):
    whole, rows = read_cloud(cloud), []
    with tempfile.TemporaryDirectory() as folder:
        for n in sorted(sizes):
            path = Path(folder) / "cloud.ply"
            write_cloud(path, _of_size(whole, n, np.random.default_rng(seed)))
            with multiprocessing.get_context("spawn").Pool(1) as pool:
                cpu, peak = pool.apply(_label, (str(path), str(weights), seed, threads))
            rows.append({"n_points": n, "cpu_s": cpu, "peak_gb": peak})
            logger.info("%d points: %.1f CPU s, %.2f GB", n, cpu, peak)
    slope, start = np.polyfit([row["n_points"] for row in rows], [row["cpu_s"] for row in rows], 1)
    logger.info("%.1f CPU s and %.2f more a million points", start, 1e6 * slope)
    if output:
        write_json(output, {"rows": rows, "start_s": float(start), "s_per_point": float(slope)})
    if figure:
        _plot(figure, rows, slope, start)


def _of_size(cloud, n, rng):
    copies, rest = divmod(n, len(cloud))
    index = np.concatenate(
        [np.tile(np.arange(len(cloud)), copies), rng.permutation(len(cloud))[:rest]]
    )
    points = cloud.points[index]
    points[len(cloud) :] += rng.normal(0.0, COPY_OFF_M, points[len(cloud) :].shape)
    return PointCloud(points, colors=None if cloud.colors is None else cloud.colors[index])


def _label(path, weights, seed, threads):
    """CPU seconds and peak memory in GB of one process that does the whole stage."""
    device = choose_device(threads, 0)
    cloud = read_cloud(path)
    result, _ = segment_cloud(cloud, weights, sampling=Sampling(), seed=seed, device=device)
    write_cloud(Path(path).with_name("segmented.ply"), result)
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024**2


def _plot(path, rows, slope, start):
    from matplotlib.figure import Figure

    n, cpu, peak = (np.array([row[k] for row in rows]) for k in ("n_points", "cpu_s", "peak_gb"))
    figure = Figure(figsize=(6, 3.8), layout="constrained")
    ax = figure.subplots()
    ax.plot(n / 1e6, cpu, "o", color="#3b5bab", label="CPU s")
    at = np.array([0.0, n.max()])
    line = f"{start:.0f} s and {1e6 * slope:.1f} s a million points"
    ax.plot(at / 1e6, start + slope * at, "-", color="#9db2dd", label=line)
    ax.set_xlabel("million points")
    ax.set_ylabel("CPU s")
    ax.set_ylim(0, None)
    other = ax.twinx()
    other.plot(n / 1e6, peak, "s", color="#c2571a", label="peak memory")
    other.set_ylabel("peak memory, GB")
    other.set_ylim(0, None)
    handles = [h for a in (ax, other) for h in a.get_legend_handles_labels()[0]]
    ax.legend(handles=handles, loc="lower right", fontsize=8)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=110, format="png")


parser = stage_parser(__doc__)
parser.add_argument("--weights", required=True)
parser.add_argument("--cloud", required=True, help="PLY, metric")
parser.add_argument("--output", default="", help="JSON to write")
parser.add_argument("--figure", default="", help="PNG of the plot to write")
parser.add_argument(
    "--sizes", type=int, nargs="+", default=[250_000, 1_000_000, 4_000_000], help="points"
)
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--threads", type=int, default=2)
run(main, parser, globals().get("snakemake"))
