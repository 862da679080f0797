"""Compiling is told once, and what is compiled lies in the user's cache, not beside the code."""

import os
import subprocess
import sys

ONE = (
    "import numpy as np; from cherrypicker.geometry.tree_walks import sum_from_root;"
    "print(sum_from_root(np.array([-1, 0, 1]), np.ones(3)))"
)


def test_of_runs_at_once_one_compiles_and_tells_and_the_others_load(project, tmp_path):
    places = {"NUMBA_CACHE_DIR": "", "XDG_CACHE_HOME": str(tmp_path)}
    call = [sys.executable, "-c", ONE]
    environment = os.environ | places | {"PYTHONPATH": str(project / "scripts")}

    def run(n):
        """What each of some processes at once prints and tells."""
        running = [
            subprocess.Popen(call, env=environment, stdout=-1, stderr=-1, text=True)
            for _ in range(n)
        ]
        told = [process.communicate() for process in running]
        assert not any(process.returncode for process in running)
        return zip(*told)

    printed, told = run(2)
    (told,) = filter(None, told)
    assert told.count("compiling for this machine, once") == 1
    assert f"kept in {tmp_path}/cherrypicker/" in told
    assert list(tmp_path.glob("cherrypicker/*/**/*.nbi"))
    assert list(run(1)) == [printed[:1], ("",)]
    assert printed[0] == printed[1]
