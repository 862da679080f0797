"""Train the point cloud network on generated orchard scenes.

Writes the weights and a JSON file with the schedule and the measures on held-out scenes. Goes on
from the checkpoint beside the weights where a run of the same settings was cut short. Example:

    python scripts/lab/train_segmentation.py --weights dgcnn.pt --metrics dgcnn.json \
        --workspace training --n-scenes 100
"""

from dataclasses import asdict
from pathlib import Path

import lab_path  # noqa: F401
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker.segmentation.dgcnn import choose_device, save_weights
from cherrypicker.segmentation.inference import Sampling
from cherrypicker.segmentation.refine import Smoothing
from cherrypicker_lab.training.segmentation.scenes import HELD_OUT_SEED, SceneFolders, load_samples
from cherrypicker_lab.training.segmentation.schedule import Schedule
from cherrypicker_lab.training.segmentation.training import measure, train


def main(
    weights,
    metrics,
    *,
    workspace,
    n_scenes,
    n_held_out,
    scene_points,
    epochs,
    batch_spheres,
    spheres_per_cloud,
    learning_rate,
    final_learning_rate,
    color_dropout,
    voxel_size_m,
    sphere_radius_m,
    sphere_points,
    reference_height_m,
    width,
    embedding,
    k,
    minutes,
    start,
    seed,
    threads,
    gpu,
    scenes=(),
    course="exponential",
    warmup=0,
    average=0.0,
    class_balance=0.5,
):
    device = choose_device(threads, gpu)
    schedule = Schedule(
        epochs,
        batch_spheres,
        spheres_per_cloud,
        learning_rate,
        final_learning_rate,
        color_dropout,
        seed,
        minutes,
        course,
        warmup,
        average,
        class_balance,
    )
    sampling = Sampling(
        voxel_size_m=voxel_size_m,
        reference_height_m=reference_height_m,
        sphere_radius_m=sphere_radius_m,
        sphere_points=sphere_points,
    )
    folder = Path(workspace)
    first = seed * n_scenes
    if scenes:
        samples = SceneFolders(scenes)
    else:
        samples = load_samples(range(first, first + n_scenes), folder / "scenes", scene_points)
    network, history = train(
        samples,
        schedule=schedule,
        sampling=sampling,
        checkpoint=folder / "checkpoint.pt",
        network_settings={"width": width, "embedding": embedding, "k": k},
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
        measured = measure(network, held_out, sampling, Smoothing(), device=device)
    write_json(
        metrics,
        {
            "schedule": asdict(schedule),
            "sampling": asdict(sampling),
            "network": network.settings,
            "training_scenes": [Path(f).name for f in samples.files]
            if scenes
            else [first, first + n_scenes - 1],
            "held_out_seeds": held_out_seeds,
            "history": history,
            "held_out": measured,
        },
    )


parser = stage_parser(__doc__)
parser.add_argument("--weights", required=True, help="weights to write")
parser.add_argument("--metrics", required=True, help="JSON of schedule and measures to write")
parser.add_argument("--workspace", required=True, help="folder of the scenes and the checkpoint")
parser.add_argument("--n-scenes", type=int, default=100)
parser.add_argument("--n-held-out", type=int, default=10, help="0 leaves the measuring out")
parser.add_argument("--scene-points", type=int, default=250_000)
parser.add_argument("--epochs", type=int, default=35)
parser.add_argument("--batch-spheres", type=int, default=16)
parser.add_argument("--spheres-per-cloud", type=int, default=8)
parser.add_argument("--learning-rate", type=float, default=0.003)
parser.add_argument("--final-learning-rate", type=float, default=3e-5)
parser.add_argument("--color-dropout", type=float, default=0.25)
parser.add_argument("--voxel-size-m", type=float, default=0.02)
parser.add_argument("--sphere-radius-m", type=float, default=0.7)
parser.add_argument("--sphere-points", type=int, default=1536)
parser.add_argument("--reference-height-m", type=float, default=3.5)
parser.add_argument("--width", type=int, default=64)
parser.add_argument("--embedding", type=int, default=192)
parser.add_argument("-k", "--k", type=int, default=12)
parser.add_argument("--minutes", type=float, help="stop after this time; the rate falls over it")
parser.add_argument("--start", help="weights to go on from")
parser.add_argument(
    "--scenes", nargs="*", default=(), help="folders of scenes to train on, which may be growing"
)
parser.add_argument("--course", choices=("exponential", "cosine"), default="exponential")
parser.add_argument("--warmup", type=int, default=0, help="batches over which the rate rises")
parser.add_argument(
    "--average", type=float, default=0.0, help="decay of the mean of the weights that is kept"
)
parser.add_argument(
    "--class-balance", type=float, default=0.5, help="0: points weigh alike; 1: classes do"
)
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--threads", type=int, default=2)
parser.add_argument("--gpu", type=int, default=0, help="1 to use an NVIDIA GPU")
run(main, parser, globals().get("snakemake"))
