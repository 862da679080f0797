"""Compiling is told once, and what is compiled lies in the user's cache, not beside the code."""

import os
import subprocess
import sys

SHORT = (
    "import numpy as np; from cherrypicker.geometry.tree_walks import fill_reach, sum_from_root;"
    "parent, ones = np.array([-1, 0, 1]), np.ones(3);"
    "print(sum_from_root(parent, ones), fill_reach(parent, ones))"
)


def test_the_first_run_tells_that_it_compiles_and_the_second_loads(project, tmp_path):
    places = {"NUMBA_CACHE_DIR": "", "XDG_CACHE_HOME": str(tmp_path)}
    call = [sys.executable, "-c", SHORT]
    environment = os.environ | places | {"PYTHONPATH": str(project / "scripts")}
    first, second = (
        subprocess.run(call, env=environment, check=True, capture_output=True, text=True)
        for _ in range(2)
    )
    assert first.stderr.count("compiling for this machine, once") == 1
    assert f"kept in {tmp_path}/cherrypicker/" in first.stderr
    assert list(tmp_path.glob("cherrypicker/*/**/*.nbi"))
    assert second.stderr == ""
    assert second.stdout == first.stdout
