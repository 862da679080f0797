"""Make one scene of the synthetic orchard: exact truth and the cloud "as seen", without photos.

Writes into FOLDER, all from the seed: truth/ (poses.npz, skeleton.csv, cloud.ply, traits.json,
scene.json) and as_seen.ply. Example:

    python scripts/lab/make_orchard_scene.py --seed 7 --as_seen results/orchard/scenes/7/as_seen.ply
"""

import json
from pathlib import Path

import numpy as np

import lab_path  # noqa: F401
from cherrypicker.pointcloud import write_cloud
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.scene.variety import FORMS, scene_camera, scene_options, scene_walk
from cherrypicker_lab.orchard.scene.walks import walk_poses
from cherrypicker_lab.orchard.seen.as_seen import AsSeen
from cherrypicker_lab.orchard.seen.sampling import sample_scene
from cherrypicker_lab.orchard.truth import write_truth


def main(
    as_seen, *, seed, forms=FORMS, n_points=200_000, surface_points=150_000, extent_m=3.0,
    n_photos=48, photo_size_px=0, distortion=True, chosen="{}",
):  # fmt: skip
    """Write the truth, then the cloud."""
    folder = Path(as_seen).parent
    chosen = json.loads(chosen)
    scene = generate_scene(seed, **scene_options(seed, forms, chosen))
    camera = scene_camera(seed, distortion=distortion, size_px=photo_size_px)
    poses = walk_poses(scene, camera, scene_walk(seed, chosen), n_photos)
    write_truth(
        folder / "truth", scene, poses, n_points=surface_points, extent=extent_m,
        name=f"orchard {seed}", camera=camera,
    )  # fmt: skip
    rng = np.random.default_rng([seed, 419])
    cloud = sample_scene(
        scene, n_points, rng=rng, as_seen=AsSeen.random(rng), extent=extent_m, poses=poses
    )
    write_cloud(as_seen, cloud)


parser = stage_parser(__doc__)
parser.add_argument("--as_seen", required=True, help="PLY to write, in the scene's folder")
parser.add_argument("--seed", type=int, required=True)
parser.add_argument("--forms", nargs="+", default=FORMS, help="forms of trees to draw from")
parser.add_argument("--n_points", type=int, default=200_000, help="of the cloud as seen")
parser.add_argument("--surface_points", type=int, default=150_000, help="of the exact cloud")
parser.add_argument("--extent_m", type=float, default=3.0, help="radius of the clouds, m")
parser.add_argument("--n_photos", type=int, default=48)
parser.add_argument("--photo_size_px", type=int, default=0, help="longer side, 0: the cameras' own")
parser.add_argument("--chosen", default="{}", help="JSON of the config's orchard.chosen")
parser.add_argument("--distortion", type=int, default=1, help="0: pinholes")
run(main, parser, globals().get("snakemake"))
