"""Model a cloud of wood with PyTLidar, which is TreeQSM in Python, as cylinders.

Runs in that program's own Python (docs/lab/skeleton.md makes one), so it imports nothing of
this project. Reads points from an NPZ file; writes the cylinders as NPZ, and what they cost as
JSON. The sizes of its patches are those that it estimates itself from the cloud. Example:

    PEER/bin/python scripts/lab/run_pytlidar.py --cloud cloud.npz --cylinders cylinders.npz \
        --report report.json
"""

import argparse
import json
import resource
import time
from importlib.metadata import version

import numpy as np

SEED = 0  # of the random order in which it lays its patches


def main(cloud, cylinders, report):
    """Load, model twice, save the second: the first compiles and loads its functions."""
    from PyTLidar import build_inputs, run_qsm  # here, so that --help works without it

    with np.load(cloud, allow_pickle=False) as stored:
        points = stored["points"].astype(np.float64)
    inputs = build_inputs(points, savetxt=0, savepdf=0)[0]
    for _ in range(2):
        np.random.seed(SEED)  # noqa: NPY002 (it draws from the global one)
        start = time.process_time()
        models, _ = run_qsm(points, inputs)
        cpu_s = time.process_time() - start
    if not models:
        raise RuntimeError("no cylinder was fitted")
    model = models[0]["cylinder"]
    start_of = np.asarray(model["start"], np.float64)
    end = start_of + np.asarray(model["axis"]) * np.asarray(model["length"])[:, None]
    np.savez(
        cylinders,
        start=start_of,
        end=end,
        radius=np.asarray(model["radius"], np.float64),
        parent=np.asarray(model["parent"], np.int64),
        branch=np.asarray(model["branch"], np.int64),
    )
    patches = ("PatchDiam1", "PatchDiam2Min", "PatchDiam2Max", "BallRad1", "BallRad2")
    details = {
        "version": version("PyTLidar"),
        "n_points": len(points),
        "patches_m": {name: float(inputs[name][0]) for name in patches},
        "cpu_s": cpu_s,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }
    with open(report, "w", encoding="utf-8") as stream:
        json.dump(details, stream, indent=2)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cloud", required=True, help="NPZ with points (N, 3), metres, z up")
    parser.add_argument("--cylinders", required=True, help="NPZ to write")
    parser.add_argument("--report", required=True, help="JSON to write")
    main(**vars(parser.parse_args()))
