"""Make labelled clouds of generated scenes to train the point cloud network on.

Scenes that the folder already holds are kept, so that a run that was cut short goes on, and a
training that reads the folder (`train_segmentation.py --scenes`) may run beside it. Example:

    python scripts/lab/make_training_scenes.py --folder training/scenes --first_seed 30000 \
        --n_scenes 200 --things confusable
"""

import lab_path  # noqa: F401
from cherrypicker.errors import StageError
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.training.segmentation.scenes import HELD_OUT_SEED, THINGS, make_scenes


def main(folder, *, first_seed, n_scenes, scene_points, things, trees=()):
    if n_scenes < 1 or first_seed < 0 or first_seed + n_scenes > HELD_OUT_SEED:
        raise StageError(
            f"training seeds are 0 to {HELD_OUT_SEED - 1}, asked for {n_scenes} from {first_seed}",
            key="--first_seed",
        )
    seeds = range(first_seed, first_seed + n_scenes)
    make_scenes(seeds, folder, scene_points, things=things, skeletons=sorted(trees))


parser = stage_parser(__doc__)
parser.add_argument("--folder", required=True, help="folder of the scenes to write")
parser.add_argument("--first_seed", type=int, default=0)
parser.add_argument("--n_scenes", type=int, default=100)
parser.add_argument("--scene_points", type=int, default=160_000, help="of a cloud at most")
parser.add_argument(
    "--things",
    choices=THINGS,
    default="common",
    help="what stands about the trees; confusable: small signs beside markers, posts, rings; "
    "random: boards, solids, roofs and strangers' things of any kind; hard: wild trees, hollow "
    "boards, things at the stem; elsewhere: those around the trees of --trees",
)
parser.add_argument(
    "--trees", nargs="*", default=(), help="skeletons of trees, CSV id,parent,x,y,z,radius, m"
)
run(main, parser, globals().get("snakemake"))
