"""Train the point cloud network on generated orchard scenes, and on labelled scans beside them.

Writes the weights and a JSON file with the schedule and the measures on held-out scenes. Goes on
from the checkpoint beside the weights where a run of the same settings was cut short. Example:

    python scripts/lab/train_segmentation.py --weights dgcnn.pt --metrics dgcnn.json \
        --workspace training --n_scenes 100
"""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import lab_path  # noqa: F401
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker.segmentation.dgcnn import choose_device
from cherrypicker.segmentation.inference import Sampling
from cherrypicker_lab.training.segmentation.scans import load_scans
from cherrypicker_lab.training.segmentation.scenes import HELD_OUT_SEED, FreshScenes, load_samples
from cherrypicker_lab.training.segmentation.schedule import Schedule
from cherrypicker_lab.training.segmentation.training import measure, train
from cherrypicker_lab.training.segmentation.weights import save_weights


def main(
    weights: Annotated[str, "weights to write"],
    metrics: Annotated[str, "JSON of schedule and measures to write"],
    workspace: Annotated[str, "folder of the scenes and the checkpoint"],
    trees: Annotated[Sequence[str], "skeletons from elsewhere, CSV, for --fresh"] = (),
    *,
    fresh: bool = False,
    n_scenes: int = 100,
    n_held_out: int = 10,
    scene_points: int = 250_000,
    schedule: Schedule,
    voxel_size_m: float = 0.02,
    sphere_radius_m: float = 0.7,
    sphere_points: int = 1536,
    reference_height_m: float = 3.5,
    width: int = 64,
    embedding: int = 192,
    k: int = 12,
    graph: str = "fixed",
    start: str | None = None,
    scans: str | None = None,
    threads: int = 2,
    gpu: int = 0,
):
    device = choose_device(threads, gpu)
    sampling = Sampling(
        voxel_size_m=voxel_size_m,
        reference_height_m=reference_height_m,
        sphere_radius_m=sphere_radius_m,
        sphere_points=sphere_points,
    )
    folder = Path(workspace)
    first = schedule.seed * n_scenes
    labelled = load_scans(scans) if scans else []
    if fresh:
        samples = FreshScenes(first, n_scenes, scene_points, skeletons=trees, more=labelled)
    else:
        samples = load_samples(range(first, first + n_scenes), folder / "scenes", scene_points)
        samples += labelled
    network, history = train(
        samples,
        schedule=schedule,
        sampling=sampling,
        checkpoint=folder / "checkpoint.pt",
        network_settings={"width": width, "embedding": embedding, "k": k, "graph": graph},
        start=start,
        device=device,
    )
    done = history[-1]
    meta = {"epochs": done["epoch"], "n_scenes": done["n_scenes"], "batches": done["n_batches"]}
    save_weights(weights, network, asdict(sampling), meta)
    held_out_seeds = list(range(HELD_OUT_SEED, HELD_OUT_SEED + n_held_out))
    measured = {}
    if held_out_seeds:
        held_out = load_samples(held_out_seeds, folder / "scenes", scene_points)
        measured = measure(network, held_out, sampling, device=device)
    write_json(
        metrics,
        {
            "schedule": asdict(schedule),
            "sampling": asdict(sampling),
            "network": network.settings,
            "training_scenes": [first, first + n_scenes * (done["epoch"] if fresh else 1) - 1],
            "labelled_scans": len(labelled),
            "held_out_seeds": held_out_seeds,
            "history": history,
            "held_out": measured,
        },
    )


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
