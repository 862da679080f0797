"""Measure what each part of the sky-silhouette filter takes from the clouds of rendered scenes.

Per scene reads results/TREE (cropped.ply, aligned_poses.npz, sfm/model, dense/, sky/ and
sky_colors.npz) and SCENE/truth; prints a table with the filter off, colour only, mask voting only
and both: sky-coloured fringe points removed, true branch points lost. The other filters are off
unless --other_filters is given. Definitions: cherrypicker_lab/training/sky/ablation.py. Example:

    python scripts/lab/ablate_sky.py --results results/cherry_leader results/cherry_vase \\
        --scenes resources/demo/cherry_leader resources/demo/cherry_vase --table ablation.md
"""

import logging
from functools import partial
from pathlib import Path

import numpy as np

import lab_path  # noqa: F401
from cherrypicker.denoising.denoise import GROUND_SHARE, DenoiseOptions
from cherrypicker.errors import StageError
from cherrypicker.evidence.existence import ask_points
from cherrypicker.files import atomic_path, temporary_folder
from cherrypicker.mvs.clear_sky import SkyMasks
from cherrypicker.mvs.raster import write_rasters
from cherrypicker.mvs.scan_photos import ScanPhotos
from cherrypicker.pointcloud import read_cloud
from cherrypicker.poses import read_poses
from cherrypicker.runner import run, stage_parser
from cherrypicker.sky.colors import read_sky_colors
from cherrypicker_lab.dense.scoring import place
from cherrypicker_lab.dense.truth import load_true_surface
from cherrypicker_lab.training.sky.ablation import ablate, markdown

logger = logging.getLogger(__name__)


def main(results, scenes, table, *, masks, other_filters):
    """Ablate scene by scene, print and save the table."""
    if len(results) != len(scenes) or (masks and len(masks) != len(scenes)):
        raise StageError(f"{len(results)} results and {len(scenes)} scenes must come in pairs")
    options = DenoiseOptions()
    if not other_filters:
        options = DenoiseOptions(use_statistical=False, min_view_ratio=0.0)
    tables = {}
    for k, (tree, scene) in enumerate(zip(map(Path, results), map(Path, scenes))):
        mask_folder = Path(masks[k]) if masks else tree / "sky"
        tables[scene.name] = ablate_scene(tree, scene, mask_folder, options)
        logger.info("%s\n%s", scene.name, markdown({scene.name: tables[scene.name]}))
    text = markdown(tables)
    print(text)
    if table:
        with atomic_path(table) as temporary:
            temporary.write_text(text, encoding="utf-8")


def ablate_scene(tree, scene, masks, options):
    """Load one scene's results and truth and return the table of its variants."""
    cloud, poses = read_cloud(tree / "cropped.ply"), read_poses(tree / "aligned_poses.npz")
    surface = load_true_surface(scene / "truth")
    placed, _ = place(cloud.points, tree / "aligned_poses.npz", scene / "truth", surface, "surface")
    ground = GROUND_SHARE * float(np.median(poses.centers[:, 2]))
    sky = read_sky_colors(tree / "sky_colors.npz")
    cameras = read_poses(tree / "dense/poses.npz")
    with temporary_folder(tree, "evidence") as rasters:
        sky_masks = SkyMasks(masks, tree / "sfm/model", cameras.names)
        write_rasters(tree / "dense/images", cameras, sky_masks, rasters)
        ask = partial(ask_points, ScanPhotos(cameras, rasters, poses))
        return ablate(cloud, placed, surface, sky, ask, options, ground)


parser = stage_parser(__doc__)
parser.add_argument("--results", nargs="+", required=True, help="results/TREE of each scene")
parser.add_argument("--scenes", nargs="+", required=True, help="folder of each scene")
parser.add_argument("--masks", nargs="*", default=[], help="other sky masks than results/TREE/sky")
parser.add_argument("--table", default="", help="Markdown to write")
parser.add_argument("--other_filters", action="store_true", help="run the other filters too")
run(main, parser, globals().get("snakemake"))
