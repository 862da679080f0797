"""Tell whether this machine can run the workflow, and what to install where it cannot.

Looks at Python, the pinned packages, system libraries, the networks' weights, GPU, cores, memory
and the work folder's disk. The exit status is 1 where something has to be done. Examples:

    cherrypicker doctor
    cherrypicker doctor -d WORK
"""

import argparse
import ctypes
import importlib
import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import psutil

from cherrypicker.batch.config import resolve_config
from cherrypicker.batch.forecast import forecast_jobs
from cherrypicker.batch.resources import size_of_photos
from cherrypicker.command.work_folder import check_writable, folder_parser
from cherrypicker.errors import StageError
from cherrypicker.files import PROJECT, load_yaml
from cherrypicker.runner import SCHEMA_FILE

_INSTALL = "make install, in the project"

parser = folder_parser(__doc__)


class Sign(NamedTuple):
    """One thing that was looked at."""

    name: str
    found: str
    remedy: str = ""  # what to do; empty where all is well
    is_needed: bool = True  # whether nothing runs without it; else it is to know


def main(args: argparse.Namespace) -> int:
    """Print what was found; return 0 where the workflow can run."""
    signs = [*_python(), *_packages(), *_libraries(), *_weights(), *_gpu(), *_machine()]
    for sign in signs:
        state = "ok  " if not sign.remedy else ("MISS" if sign.is_needed else "note")
        print(f"{state} {sign.name:22s} {sign.found}" + f"  -> {sign.remedy}" * bool(sign.remedy))
    return int(any(sign.remedy and sign.is_needed for sign in signs))


def _python() -> Iterator[Sign]:
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = project["requires-python"]
    low, high = (tuple(map(int, part.split("."))) for part in re.findall(r"\d+\.\d+", wanted))
    fits = low <= sys.version_info[:2] < high
    yield Sign("cherrypicker", f"{project['version']} in {PROJECT}")
    yield Sign("python", sys.version.split()[0], "" if fits else f"Python {wanted}")


def _packages() -> Iterator[Sign]:
    """Pinned packages that are missing or of another version, or their number."""
    pins = pinned_versions()
    installed = {_plain(each.name): each.version for each in importlib.metadata.distributions()}
    # README has a GPU's user install the one in the other's place
    installed.setdefault("pycolmap", installed.get("pycolmap-cuda12", ""))
    found = {name: installed.get(_plain(name), "").partition("+")[0] for name in pins}
    for name, wanted in pins.items():
        if not found[name]:
            yield Sign(name, "missing", _INSTALL)
        elif found[name] != wanted:
            yield Sign(name, f"{found[name]}, pinned is {wanted}", _INSTALL, is_needed=False)
    n_good = sum(found[name] == wanted for name, wanted in pins.items())
    yield Sign("packages", f"{n_good} of {len(pins)} as pinned")
    for name in ("open3d", "pycolmap", "cv2", "torch"):
        try:
            importlib.import_module(name)
        except Exception as error:  # a native library can fail in any way
            yield Sign(f"import {name}", f"{type(error).__name__}: {error}", _INSTALL)


def _plain(name: str) -> str:
    """A package's name as indexes compare it: a package may spell itself otherwise (PEP 503)."""
    return re.sub(r"[-_.]+", "-", name).lower()


def pinned_versions() -> dict[str, str]:
    """Return the versions that the project's requirements pin, by package."""
    files = PROJECT / "envs/requirements.txt", PROJECT / "envs/torch.txt"
    text = "\n".join(path.read_text(encoding="utf-8") for path in files)
    return dict(re.findall(r"^([\w.\-]+)==([\w.]+)", text, re.MULTILINE))


def _libraries() -> Iterator[Sign]:
    """System libraries of Open3D, by the list of what installs them."""
    script = (PROJECT / "envs/install_system_packages.sh").read_text(encoding="utf-8")
    listed = re.search(r'^libraries="(.*)"', script, re.MULTILINE)
    for pair in (listed[1] if listed else "").split():
        library, _, package = pair.partition(":")
        try:
            ctypes.CDLL(library)
        except OSError:
            yield Sign(library, "missing", f"sudo apt-get install {package}")
        else:
            yield Sign(library, "found")


def _weights() -> Iterator[Sign]:
    for name in ("sky_unet.npz", "dgcnn.pt"):
        path = PROJECT / "resources/weights" / name
        is_there = path.is_file() and path.stat().st_size > 0
        yield Sign(name, *(("found",) if is_there else ("missing", f"git restore {path}")))


def _gpu() -> Iterator[Sign]:
    """The GPU, and who of pycolmap and torch can use it; the CPU does without."""
    program = shutil.which("nvidia-smi")
    if program is None:
        yield Sign("GPU", "none by NVIDIA: the CPU's stereo is used")
        return
    query = [program, "--query-gpu=name,memory.total", "--format=csv,noheader"]
    told = subprocess.run(query, capture_output=True, text=True, check=False).stdout
    yield Sign("GPU", " / ".join(told.split("\n")).strip(" /") or "does not answer")
    for name in ("pycolmap", "torch"):
        try:
            module = importlib.import_module(name)
            uses = module.has_cuda if name == "pycolmap" else module.cuda.is_available()
        except Exception:  # told above
            uses = False
        found = "uses the GPU" if uses else "was built without CUDA"
        remedy = "" if uses else "README, section GPU"
        yield Sign(f"{name} on the GPU", found, remedy, is_needed=False)


def _machine() -> Iterator[Sign]:
    """Cores, and memory and disk beside what a tree of 100 photos of 12 megapixels needs."""
    # With the depth maps, which lie there while it is made
    settings = resolve_config(load_yaml(SCHEMA_FILE), {"keep": {"dense": True}})
    jobs = forecast_jobs({"a tree": size_of_photos([(4000, 3000)] * 100, settings)})
    needed_gb, disk_gb = max(job.memory_gb for job in jobs), sum(job.disk_gb for job in jobs)
    memory, free_gb = psutil.virtual_memory(), shutil.disk_usage(".").free / 1e9
    yield Sign("cores", str(os.cpu_count()))
    found = f"{memory.total / 1e9:.1f} GB, {memory.available / 1e9:.1f} GB free"
    remedy = "smaller mvs.max_image_size_px, or scripts/forecast.py tells what a batch needs"
    is_small = memory.total / 1e9 < needed_gb
    yield Sign("memory", found, remedy if is_small else "", is_needed=False)
    remedy = "" if free_gb >= disk_gb else f"a tree from photos takes {disk_gb:.0f} GB while made"
    yield Sign("disk", f"{free_gb:.1f} GB free in {Path.cwd()}", remedy, is_needed=False)
    try:
        check_writable(["results", "logs", "benchmarks"])
    except StageError as error:
        yield Sign("work folder", error.describe(), "a folder of your own, --directory")
