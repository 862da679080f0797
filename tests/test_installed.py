"""The library as a wheel: what is in it, and that it works in an environment of its own."""

import os
import re
import subprocess
import sys
import tomllib
import zipfile

import pytest
from workspace import small_tree

from cherrypicker.pointcloud import write_cloud

FIVE_LINES = """
import numpy as np
from cherrypicker.api import skeletonize
rng = np.random.default_rng(0)
angle, z = rng.uniform(0, 2 * np.pi, 6000), rng.uniform(0, 1, 6000)
stem = np.column_stack([0.04 * np.cos(angle), 0.04 * np.sin(angle), z])
print(round(float(np.median(skeletonize(stem).radius)), 3))
"""


@pytest.fixture(scope="module")
def wheel(project, tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    options = ("--no-deps", "--no-build-isolation", "--quiet", "--wheel-dir", str(folder))
    call = [sys.executable, "-m", "pip", "wheel", *options, str(project)]
    subprocess.run(call, check=True, capture_output=True)
    (found,) = folder.glob("*.whl")
    return found


def test_the_wheel_holds_every_file_of_the_packages_and_what_they_read(project, wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    folders = ("scripts", "workflow", "profiles", "resources/weights")
    paths = [path for folder in folders for path in (project / folder).rglob("*")]
    paths = [path for path in paths if path.is_file() and "__pycache__" not in path.parts]
    assert len(paths) > 400
    for path in (path.relative_to(project).as_posix() for path in paths):
        package = re.match(r"scripts/(\w*cherrypicker(?:_lab)?/.*)", path)
        assert (package[1] if package else f"cherrypicker/project/{path}") in names, path
    assert "cherrypicker/project/Snakefile" in names
    assert "cherrypicker/py.typed" in names


def test_what_an_installation_asks_for_is_what_is_tested(project):
    """Each dependency is pinned, at a version that its bound allows."""
    described = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    pins = {}
    for name in ("requirements.txt", "constraints.txt", "torch.txt"):
        text = (project / "envs" / name).read_text(encoding="utf-8")
        pins |= {
            name.lower(): version for name, version in re.findall(r"^([\w.-]+)==(\S+)", text, re.M)
        }
    wanted = described["dependencies"] + described["optional-dependencies"]["workflow"]
    for each in wanted:
        name, _, least = each.partition(">=")
        numbers = [tuple(map(int, text.split("."))) for text in (pins[name], least)]
        assert numbers[0][: len(numbers[1])] >= numbers[1], each


NOTHING_ELSE = """
import sys
allowed = {*sys.stdlib_module_names, *sys.argv[1].split(",")}
class Finder:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] not in allowed and name[0] != "_":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Finder)
sys.path.insert(0, sys.argv[2])
import cherrypicker.api
from cherrypicker.skeleton import Skeleton, fold
line = Skeleton([[0, 0, 0], [0, 0, 1], [0, 0, 2]], [-1, 0, 1], [1, 1, 1], [1, 1, 1])
assert len(fold(line)) == 2
"""


def test_the_library_imports_with_nothing_but_its_dependencies(project):
    described = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    names = {name.partition(">=")[0].replace("-", "_") for name in described["dependencies"]}
    # Beside them what numba, PyYAML and robust-laplacian are made of
    modules = {"cherrypicker", "llvmlite", "yaml", "robust_laplacian_bindings", *names}
    call = [sys.executable, "-c", NOTHING_ELSE, ",".join(modules), str(project / "scripts")]
    done = subprocess.run(call, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def _environment(folder, wheel, extra=""):
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    python = str(folder / "bin/python")
    call = [python, "-m", "pip", "install", "--quiet", f"{wheel}{extra}"]
    subprocess.run(call, check=True)
    return python


def _own(tmp_path):
    """The environment of a user who has no clone and an empty cache."""
    return {**os.environ, "PYTHONPATH": "", "XDG_CACHE_HOME": str(tmp_path / "cache")}


@pytest.mark.slow
def test_five_lines_skeletonize_an_array_in_a_clean_environment(wheel, tmp_path):
    python = _environment(tmp_path / "venv", wheel)
    call = [python, "-c", FIVE_LINES]
    done = subprocess.run(
        call, cwd=tmp_path, env=_own(tmp_path), check=True, capture_output=True, text=True
    )
    assert done.stdout == "0.04\n"
    assert "compiling for this machine, once" in done.stderr
    assert not list((tmp_path / "venv").rglob("*.nbi"))


@pytest.mark.slow
def test_the_whole_workflow_runs_from_a_wheel(wheel, tmp_path):
    python = _environment(tmp_path / "venv", wheel, "[workflow]")
    write_cloud(tmp_path / "small.ply", small_tree())
    (tmp_path / "config").mkdir()
    (tmp_path / "config/config.yaml").write_text("{}\n", encoding="utf-8")
    (tmp_path / "config/trees.tsv").write_text("tree\tcloud\nsmall\tsmall.ply\n", encoding="utf-8")
    command = [str(tmp_path / "venv/bin/cherrypicker"), "run", "--cores", "1", "--plain"]
    subprocess.run(command, cwd=tmp_path, env=_own(tmp_path), check=True)
    assert (tmp_path / "results/small/report.html").is_file()
    assert python
