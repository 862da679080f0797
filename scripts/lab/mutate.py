"""Spoil the program one line at a time, and see whether the tests notice.

`mutants.yaml` beside this names for each mutant the `file`, the part of a `line` that stands in it
once, what it `becomes`, and the `tests` that are to fail then. In a copy of the tracked files all
of these must pass, then each mutant has its run. A mutant that `must` not live fails the check, as
does too small a share killed. Example:

    python scripts/lab/mutate.py --only cherrypicker/traits
"""

import ast
import os
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated

import yaml

import lab_path  # noqa: F401
from cherrypicker.errors import StageError
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.tracked import copy_tracked

LIST = Path(__file__).with_name("mutants.yaml")
PYTEST = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
PYTEST += ["-m", "not slow and not demo and not fuzz"]
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "NUMBA")}


def main(
    project: Annotated[str, "whose tracked files are copied"] = str(LIST.parents[2]),
    only: Annotated[str, "part of the path of the files to spoil"] = "",
    sample: Annotated[int, "so many mutants, drawn; 0: all"] = 0,
    seed: Annotated[int, "of the draw"] = 0,
    least: Annotated[float, "share that must be killed"] = 0.95,
) -> None:
    chosen = [each for each in yaml.safe_load(LIST.read_text("utf-8")) if only in each["file"]]
    if not chosen:
        raise StageError(f"no mutant's file has {only!r} in its path", key="--only")
    if 0 < sample < len(chosen):
        chosen = random.Random(seed).sample(chosen, sample)
    spoilt, lived = [(each, *_texts(Path(project), each)) for each in chosen], []
    with tempfile.TemporaryDirectory(prefix="mutants.") as folder:
        copy_tracked(Path(project), Path(folder))
        if _test(folder, sorted({test for each in chosen for test in each["tests"]}), None):
            raise StageError("the tests fail without a mutant", file=project)
        for each, text, mutant in spoilt:
            start, path = time.perf_counter(), Path(folder, each["file"])
            path.write_text(mutant, encoding="utf-8")
            code = _test(folder, each["tests"], subprocess.DEVNULL)
            path.write_text(text, encoding="utf-8")
            if code > 1:  # pytest's for tests that it could not even collect
                raise StageError(f"it does not run: {each['becomes']}", file=each["file"])
            lived += [] if code else [each]
            told = f"{'killed' if code else 'LIVED '} {time.perf_counter() - start:4.0f} s"
            print(f"{told}  {each['file']}: {each['becomes']}", flush=True)
    print(f"killed {len(chosen) - len(lived)} of {len(chosen)} mutants")
    if len(lived) > (1 - least) * len(chosen) or any(each.get("must") for each in lived):
        raise StageError("too many mutants live, or one that must not", file=LIST)


def _texts(project, each):
    """The file of a mutant as it is, and spoilt: other Python than before."""
    text = (project / each["file"]).read_text(encoding="utf-8")
    if (n := text.count(each["line"])) != 1:
        raise StageError(f"{n} times in the file, not once: {each['line']}", file=each["file"])
    mutant = text.replace(each["line"], each["becomes"])
    try:
        is_other = ast.dump(ast.parse(mutant)) != ast.dump(ast.parse(text))
    except SyntaxError:
        is_other = False
    if not is_other:
        raise StageError(f"no other Python: {each['becomes']}", file=each["file"])
    return text, mutant


def _test(folder, tests, out):
    own = ONE_THREAD | {"NUMBA_CACHE_DIR": str(Path(folder, ".numba"))}
    return subprocess.call([*PYTEST, *tests], cwd=folder, env=os.environ | own, stdout=out)


run(main, stage_parser(__doc__, main), globals().get("snakemake"))
