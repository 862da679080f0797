"""Render an orchard scene with Blender: photos with EXIF and their exact ground truth.

Writes FOLDER/photos/*.jpg and FOLDER/truth/ (poses.npz, skeleton.csv, cloud.ply, traits.json,
scene.json; with --maps also depth, normals and semantic masks of each photo). Photos that are
there already are kept, so a killed run goes on where it was.
Needs an environment of its own with Blender's Python module, which nothing else uses (see
envs/requirements-render.txt). The two shipped demo scans were made by

    python scripts/lab/render_scene.py --preset cherry_leader --output resources/demo/cherry_leader
    python scripts/lab/render_scene.py --preset cherry_vase --output resources/demo/cherry_vase

With --close_ups an orchard scene's photos look closely at its buds, which it must have:

    python scripts/lab/render_scene.py --orchard 9001 --forms cherry_leader --photos 24 --maps \\
        --chosen '{"buds_per_m": 30}' --close_ups 0.5 --output 9001
"""

import argparse
import json
import logging
import sys
import time
from pathlib import Path

import numpy as np

import lab_path  # noqa: F401
from cherrypicker.errors import StageError
from cherrypicker.progress import Progress
from cherrypicker_lab.orchard.render.blender import BlenderScene
from cherrypicker_lab.orchard.render.photo import (
    PhotoEffects,
    behind_all,
    compose,
    develop,
    distorted,
    lens_map,
    lens_margin,
    maps_through,
    write_jpeg,
    write_maps,
)
from cherrypicker_lab.orchard.scene.cameras import CameraModel, close_up_poses, numbered_poses
from cherrypicker_lab.orchard.scene.layout import generate_scene
from cherrypicker_lab.orchard.scene.presets import PRESETS
from cherrypicker_lab.orchard.scene.variety import FORMS, scene_camera, scene_options, scene_walk
from cherrypicker_lab.orchard.scene.walks import preset_poses, walk_poses
from cherrypicker_lab.orchard.truth import write_truth

logger = logging.getLogger("render_scene")

CLOSE_M = 2.2  # from the buds to those who photograph them


def missing_files(folder, poses, args):
    """Indices of the photos, and of the maps where those are wanted, that are not there yet."""
    photos, truth = Path(folder) / "photos", Path(folder) / "truth"

    def is_mapped(name):
        stem = Path(name).stem
        files = truth / "depth" / f"{stem}.npz", truth / "semantic" / f"{stem}.png"
        return all(file.is_file() for file in files)

    no_photo = [i for i in range(len(poses)) if not (photos / str(poses.names[i])).is_file()]
    no_maps = [i for i in range(len(poses)) if args.maps and not is_mapped(str(poses.names[i]))]
    return no_photo, no_maps


def render(scene, poses, camera, folder, args):
    """Render the photos and maps that are still missing."""
    no_photo, no_maps = missing_files(folder, poses, args)
    if not no_photo and not no_maps:
        logger.info("all photos are there")
        return
    effects = PhotoEffects(noise=args.noise)
    if args.orchard is not None:
        effects = PhotoEffects.random(scene.seed) if args.imperfect else PhotoEffects(noise=0.0)
    is_pinhole = camera.k1 == camera.k2 == 0.0
    wide = camera if is_pinhole else camera.widened(max(lens_margin(camera), 1.0))
    lens = None if is_pinhole else lens_map(wide, camera)
    wide_poses = poses if is_pinhole else numbered_poses(poses.cam_from_world, wide)
    photos = Path(folder) / "photos"
    photos.mkdir(parents=True, exist_ok=True)
    start = time.perf_counter()
    options = {"samples": args.samples, "threads": args.threads}
    distance = float(np.linalg.norm(poses.centers[:, :2], axis=1).mean())
    missing = sorted({*no_photo, *no_maps})
    with (
        BlenderScene(scene, wide, distance=distance, **options) as stage,
        Progress(len(missing), "photos") as bar,
    ):
        logger.info("scene built in %.0f s", time.perf_counter() - start)
        for i in missing:
            name, pose = str(poses.names[i]), poses.cam_from_world[i]
            if scene.wind_m > 0:
                stage.blow(i)
            if i in no_maps:  # before the photo: a photo that is there has its maps
                depth, normals, label, tree = stage.truth(pose)
                maps = [depth, normals, behind_all(label, scene, wide_poses, i), tree]
                maps = maps if lens is None else maps_through(lens, *maps)
                write_maps(Path(folder) / "truth", name, *maps)
            if i in no_photo:
                linear = compose(*stage.colors(pose), scene, wide_poses, i)
                if lens is not None:
                    linear = distorted(linear, lens)
                rng = np.random.default_rng([scene.seed, 81, i])
                write_jpeg(photos / name, develop(linear, rng, effects), camera)
            bar.step()


def parse_arguments():
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--preset", choices=sorted(PRESETS), help="a named scene")
    which.add_argument("--orchard", type=int, help="the scene of `snakemake orchard` of this seed")
    parser.add_argument("--output", required=True, help="folder of the scene, made if missing")
    parser.add_argument("--samples", type=int, default=4, help="Cycles samples a pixel (4)")
    parser.add_argument("--threads", type=int, default=2, help="render threads (2)")
    parser.add_argument("--noise", type=float, default=0.006, help="sensor noise, of 1 (0.006)")
    parser.add_argument("--forms", nargs="+", default=FORMS, help="for --orchard")
    parser.add_argument("--chosen", default="{}", help="JSON of options, for --orchard")
    parser.add_argument("--photos", type=int, default=48, help="photos, for --orchard (48)")
    parser.add_argument("--size", type=int, default=0, help="longer side, px, for --orchard (0)")
    parser.add_argument("--lens", type=int, default=1, help="0: pinholes, for --orchard")
    parser.add_argument(
        "--imperfect", type=int, default=1, help="0: perfect cameras, for --orchard"
    )
    parser.add_argument("--close_ups", type=float, default=0.0, help="size of their pixels, mm")
    parser.add_argument(
        "--maps",
        action="store_true",
        help="depth, normals and semantic mask of each photo, in truth/",
    )
    return parser.parse_args()


def main():
    """Write the truth, then the photos."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s", datefmt="%H:%M:%S")
    args = parse_arguments()
    if args.preset:
        preset = PRESETS[args.preset]
        scene, camera = generate_scene(**preset["scene"]), preset["camera"]
        poses = preset_poses(preset, scene)
        write_truth(Path(args.output) / "truth", scene, poses, name=args.preset)
    else:  # the orchard's rule writes the truth, but of close-ups
        chosen = json.loads(args.chosen)
        scene = generate_scene(args.orchard, **scene_options(args.orchard, args.forms, chosen))
        if args.close_ups:
            camera = CameraModel(1200, 800, 1000 * CLOSE_M / args.close_ups)
            poses = close_up_poses(scene, camera, args.photos, distance=CLOSE_M)
            write_truth(Path(args.output) / "truth", scene, poses, name=f"buds {args.orchard}")
        else:
            camera = scene_camera(args.orchard, distortion=bool(args.lens), size_px=args.size)
            poses = walk_poses(scene, camera, scene_walk(args.orchard, chosen), args.photos)
    render(scene, poses, camera, args.output, args)


if __name__ == "__main__":
    try:
        main()
    except StageError as error:
        sys.exit(error.describe())
