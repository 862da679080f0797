"""Compiling is told once, and what is compiled lies in the user's cache, not beside the code."""

import os
import subprocess
import sys

import pytest

from cherrypicker import compiled

ONE = (
    "import numpy as np; from cherrypicker.geometry.tree_walks import sum_from_root;"
    "print(sum_from_root(np.array([-1, 0, 1]), np.ones(3)))"
)


def test_of_runs_at_once_one_compiles_and_tells_and_the_others_load(project, tmp_path):
    places = {"NUMBA_CACHE_DIR": "", "XDG_CACHE_HOME": str(tmp_path)}
    call = [sys.executable, "-c", ONE]

    def run(n, scripts):
        """What each of some processes at once prints and tells."""
        environment = os.environ | places | {"PYTHONPATH": str(scripts)}
        running = [
            subprocess.Popen(call, env=environment, stdout=-1, stderr=-1, text=True)
            for _ in range(n)
        ]
        told = [process.communicate() for process in running]
        assert not any(process.returncode for process in running)
        return zip(*told)

    printed, told = run(2, project / "scripts")
    (told,) = filter(None, told)
    assert told.count("compiling for this machine, once") == 1
    assert f"kept in {tmp_path}/cherrypicker\n" in told
    assert list(tmp_path.glob("cherrypicker/geometry.tree_walks-*/*.nbi"))
    assert printed[0] == printed[1]
    # An installation elsewhere loads as well
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere/cherrypicker").symlink_to(project / "scripts/cherrypicker")
    assert list(run(1, tmp_path / "elsewhere")) == [printed[:1], ("",)]


@pytest.mark.parametrize(
    ("edited", "is_compiled_anew"),
    [("kernel", True), ("called", True), ("limits", True), ("around", False)],
)
def test_an_edit_is_compiled_with_what_it_is_compiled_into(
    tmp_path, monkeypatch, edited, is_compiled_anew
):
    texts = {
        "kernel": "from cherrypicker.called import (\n    add,\n)\n"
        "from cherrypicker.around import plan\n",
        "called": "from cherrypicker.compiled import compiled\n"
        "from cherrypicker.limits import MOST\n",
        "limits": "MOST = 3\n",
        "around": "def plan(): ...\n",
    }
    digests = []
    for suffix in ("", "# edited\n"):
        texts[edited] += suffix
        scripts = tmp_path / f"scripts{len(digests)}"
        (scripts / "cherrypicker").mkdir(parents=True)
        for name, text in texts.items():
            (scripts / f"cherrypicker/{name}.py").write_text(text, encoding="utf-8")
        monkeypatch.setattr(compiled, "ROOT", scripts)
        digests.append(compiled.digest_of_compiled(scripts / "cherrypicker/kernel.py"))
    assert (digests[0] != digests[1]) == is_compiled_anew
