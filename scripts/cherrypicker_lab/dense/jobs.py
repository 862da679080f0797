"""Which runs the benchmark's configuration asks for, and where they go."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from cherrypicker.errors import StageError

ROOT = "results/benchmark"
CAMERAS = ("true", "sfm")


def scan_folders(config: Mapping) -> dict[str, Path]:
    """Return the folder of each scene and each folder of photos by name.

    Parameters
    ----------
    config : mapping
        The section ``benchmark``. A scene without a slash is a preset, rendered below
        ``results/benchmark/scenes``.

    Raises
    ------
    StageError
        If two have the same name, or a name that no file can bear.
    """
    folders: dict[str, Path] = {}
    for entry in [*config["scenes"], *config["photos"]]:
        is_preset = entry in config["scenes"] and is_preset_name(entry)
        folder = Path(ROOT, "scenes", entry) if is_preset else Path(entry)
        name = folder.name
        if name in folders or not name or "/" in name:
            raise StageError(
                f"two scans of the benchmark are called {name!r}",
                key="benchmark.scenes, benchmark.photos",
            )
        folders[name] = folder
    return folders


def is_preset_name(entry: str) -> bool:
    """Whether an entry of ``benchmark.scenes`` names a preset rather than a folder."""
    return "/" not in entry and "\\" not in entry


def benchmark_runs(config: Mapping, backends: Sequence[str]) -> list[str]:
    """Return the folders of all runs, relative to the working directory.

    Every scene with true cameras and cameras from SfM, every folder of photos with the latter,
    each with every backend at full size; the first scene with true cameras also at the smaller
    sizes, with the CPU backend.

    Parameters
    ----------
    config : mapping
        The section ``benchmark``.
    backends : sequence of str
        Those that can run here; others are left out.
    """
    chosen = [name for name in config["backends"] if name in backends]
    scenes = {Path(entry).name for entry in config["scenes"]}
    runs = []
    for scan in scan_folders(config):
        for cameras in CAMERAS if scan in scenes else ("sfm",):
            runs += [f"{ROOT}/dense/{scan}/{cameras}/full/{backend}" for backend in chosen]
    if config["scenes"] and "cpu" in chosen:
        first = Path(config["scenes"][0]).name
        runs += [f"{ROOT}/dense/{first}/true/{size:g}mp/cpu" for size in config["sizes_mp"]]
    return runs


def megapixels_of(size: str) -> float:
    """Return the megapixels of a size's name, "0.6mp" for instance; 0 for "full"."""
    return 0.0 if size == "full" else float(size.removesuffix("mp"))
