"""Render the photos of a scene of the synthetic orchard, with depth, normals and semantic masks.

Runs scripts/lab/render_scene.py with an interpreter that has Blender's module; goes on where it was
stopped. Writes rendered.json, the list of the photos. Example:

    python scripts/lab/render_orchard_scene.py --scene results/orchard/scenes/7/truth/scene.json \\
        --blender_python .venv-render/bin/python --rendered results/orchard/scenes/7/rendered.json
"""

import subprocess
from pathlib import Path
from typing import Annotated

import lab_path  # noqa: F401
from cherrypicker.errors import StageError
from cherrypicker.files import read_json, write_json
from cherrypicker.poses import read_poses
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.orchard.render.blender import INSTALL
from cherrypicker_lab.orchard.scene.variety import FORMS

RENDER = Path(__file__).with_name("render_scene.py")


def main(
    scene: Annotated[str, "truth/scene.json of the scene"],
    rendered: Annotated[str, "JSON to write, in the scene's folder"],
    seed: Annotated[int, "of the scene"],
    chosen: Annotated[str, "JSON of the config's orchard.chosen"] = "{}",
    *,
    blender_python: str = "",
    forms: tuple[str, ...] = FORMS,
    n_photos: int = 48,
    photo_size_px: int = 0,
    distortion: bool = True,
    effects: bool = True,
    threads: int = 2,
) -> None:
    """Render what is missing, then list the photos."""
    folder = Path(rendered).parent
    if read_json(scene)["seed"] != seed:
        raise StageError(f"the scene is not the one of seed {seed}", file=scene)
    if not blender_python:
        raise StageError(
            f"orchard.render needs a python with Blender's module bpy: {INSTALL}",
            key="orchard.blender_python",
        )
    command = [
        blender_python, str(RENDER), "--orchard", str(seed), "--forms", *forms, "--output",
        str(folder), "--photos", str(n_photos), "--threads", str(threads), "--maps",
        "--lens", str(int(distortion)), "--imperfect", str(int(effects)),
        "--size", str(photo_size_px), "--chosen", chosen,
    ]  # fmt: skip
    try:
        done = subprocess.run(command, check=False)
    except OSError as error:
        raise StageError(
            f"Blender's python cannot be started ({error}); {INSTALL}",
            key="orchard.blender_python",
        ) from error
    names = [str(name) for name in read_poses(folder / "truth" / "poses.npz").names]
    missing = [name for name in names if not (folder / "photos" / name).is_file()]
    if done.returncode != 0 or missing:
        raise StageError(
            f"rendering failed with {len(missing)} of {len(names)} photos missing, see the log",
            file=folder,
            key="orchard.blender_python",
        )
    write_json(rendered, {"seed": seed, "photos": names})


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
