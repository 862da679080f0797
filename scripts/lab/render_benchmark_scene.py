"""See to it that a scene of the benchmark is rendered, every photo of it.

Renders the preset with an interpreter that has Blender's module where photos are missing; writes
rendered.json, the list of the photos. Example:

    python scripts/lab/render_benchmark_scene.py --preset stereo_vase \\
        --blender_python render/bin/python \\
        --rendered results/benchmark/scenes/stereo_vase/rendered.json
"""

import subprocess
from pathlib import Path

import lab_path  # noqa: F401
from cherrypicker.errors import StageError
from cherrypicker.files import write_json
from cherrypicker.poses import read_poses
from cherrypicker.runner import run, stage_parser

RENDER = Path(__file__).with_name("render_scene.py")


def main(rendered, preset, *, blender_python: str = "", threads: int = 2):
    """Render what is missing, then list the photos."""
    folder = Path(rendered).parent
    command = ["--preset", preset, "--output", str(folder), "--threads", str(threads)]
    if missing(folder):
        if not blender_python:
            raise StageError(
                f"the scene {preset} is not rendered: install envs/requirements-render.txt in an "
                f"environment of its own, then name its python, or run there: python {RENDER.name} "
                + " ".join(command),
                file=folder,
                key="benchmark.blender_python",
            )
        done = subprocess.run([blender_python, str(RENDER), *command], check=False)
        if done.returncode != 0 or missing(folder):
            raise StageError(
                f"rendering {preset} failed, see the log",
                file=folder,
                key="benchmark.blender_python",
            )
    names = [str(name) for name in read_poses(folder / "truth" / "poses.npz").names]
    write_json(rendered, {"preset": preset, "photos": names})


def missing(folder):
    """Whether the truth or a photo is not there yet."""
    poses = folder / "truth" / "poses.npz"
    if not poses.is_file():
        return True
    return any(not (folder / "photos" / str(name)).is_file() for name in read_poses(poses).names)


parser = stage_parser(__doc__)
parser.add_argument("--preset", required=True, help="name of the scene")
parser.add_argument("--rendered", required=True, help="JSON to write, in the scene's folder")
run(main, parser, globals().get("snakemake"))
