"""Make one scene of the synthetic orchard: exact truth and the cloud "as seen", without photos.

Writes into FOLDER, all from the seed: truth/ (poses.npz, skeleton.csv, cloud.ply, traits.json,
scene.json) and as_seen.ply. Example:

    python scripts/lab/make_orchard_scene.py --seed 7 --as_seen results/orchard/scenes/7/as_seen.ply
"""

import json
from pathlib import Path
from typing import Annotated

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
    as_seen: Annotated[str, "PLY to write, in the scene's folder"],
    seed: Annotated[int, "of the scene"],
    chosen: Annotated[str, "JSON of the config's orchard.chosen"] = "{}",
    *,
    forms: tuple[str, ...] = FORMS,
    n_points: int = 200_000,
    surface_points: int = 150_000,
    extent_m: float = 3.0,
    n_photos: int = 48,
    photo_size_px: int = 0,
    distortion: bool = True,
) -> None:
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


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
