"""The runner as Snakemake and the command line use it: scripts in processes of their own."""

import importlib
import json
import os
import subprocess
import sys
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import pytest

from cherrypicker.batch.watched_modules import imported_modules
from cherrypicker.runner import add_options, options_of, stage_parser

SCRIPT = """
import logging, os, sys
from dataclasses import dataclass
sys.path.insert(0, {library!r})
from types import SimpleNamespace
from cherrypicker.errors import StageError
from cherrypicker.progress import Progress
from cherrypicker.runner import run, stage_parser

@dataclass
class Limits:
    least: float = 0.5
    most: tuple[float, ...] = (1.0,)

class Named(list):
    def __init__(self, **named):
        super().__init__(named.values())
        self.named = named
    def items(self):
        return self.named.items()

def main(cloud, out, k, photos, *, limits: Limits, threads: int = 1, missing: str = "default"):
    os.write(1, b"native output\\n")
    if k == 1:
        raise StageError("no wood found", file=cloud, key="segment.k")
    if k == 2:
        raise ZeroDivisionError("oops")
    logging.getLogger("cherrypicker.x").warning("look here")
    open(out, "w").write(f"{{threads}} {{k}} {{missing}} {{photos}} {{limits}}")

parser = stage_parser("Demo.")
for name in ("--cloud", "--out", "--k"):
    parser.add_argument(name, required=True)
parser.add_argument("--photos", nargs="*")
snakemake = SimpleNamespace(
    rule="segment_cloud", wildcards=dict({wildcards}), log=["logs/x.log"], threads=2,
    resources=dict(gpu=0), input=Named(cloud="a.ply", code=["b.py"], photos="c.jpg"),
    output=Named(out="o.txt"),
    params=Named(k={k}, least=None, most=[2.0]),
)
run(main, parser, snakemake)
"""


@pytest.fixture
def run_script(project, tmp_path):
    def run(k, wildcards="tree='T1'"):
        script = tmp_path / "script.py"
        given = {"library": str(project / "scripts"), "k": k, "wildcards": wildcards}
        script.write_text(textwrap.dedent(SCRIPT.format(**given)))
        return subprocess.run(
            [sys.executable, str(script)], cwd=tmp_path, capture_output=True, text=True, check=False
        )

    return run


def test_success_writes_the_output_and_leaves_no_status(run_script, tmp_path):
    done = run_script(0)
    assert done.returncode == 0
    assert (tmp_path / "o.txt").read_text() == "2 0 default ['c.jpg'] Limits(least=0.5, most=[2.0])"
    assert not list((tmp_path / "logs/status").rglob("*.json"))
    assert "native output" in (tmp_path / "logs/x.log").read_text()
    assert done.stderr.strip() == "[T1 segment_cloud] look here"


def test_a_stage_error_is_one_line_and_a_status(run_script, tmp_path):
    done = run_script(1)
    assert done.returncode == 1
    assert done.stderr.startswith("\n")  # another may have left a line of the stream half written
    (line,) = done.stderr.strip().splitlines()
    for part in ("tree=T1", "rule=segment_cloud", "no wood found", "a.ply", "segment.k", "x.log"):
        assert part in line
    status = json.loads((tmp_path / "logs/status/T1/segment_cloud.json").read_text())
    assert status["state"] == "failed"
    assert (status["cause"], status["file"]) == ("no wood found", "a.ply")
    assert "Traceback" in (tmp_path / "logs/x.log").read_text()


def test_the_failures_of_two_series_are_two_records(run_script, tmp_path):
    assert (
        "ERROR series=row3 rule=segment_cloud: no wood found"
        in run_script(1, "series='row3'").stderr
    )
    assert run_script(0, "series='row4'").returncode == 0
    (left,) = (tmp_path / "logs/status").rglob("*.json")
    assert json.loads(left.read_text())["series"] == "row3"


def test_a_bug_is_one_line_too_and_keeps_its_traceback(run_script, tmp_path):
    done = run_script(2)
    assert done.returncode == 1
    assert len(done.stderr.strip().splitlines()) == 1
    assert "unexpected ZeroDivisionError: oops" in done.stderr
    assert "ZeroDivisionError" in (tmp_path / "logs/x.log").read_text()


@dataclass
class Limits:
    """Limits of a demo."""

    least: float = 0.5
    most: float | None = None
    box: tuple[float, float] = (0.0, 1.0)


def demo(
    *,
    limits: Limits,
    skip: bool = True,
    names: tuple[str, ...] = (),
    weights: dict[str, float] | None = None,
    threads: int = 2,
):
    """A stage without files."""


def read(*arguments):
    parser = stage_parser("Demo.")
    add_options(parser, demo)
    return vars(parser.parse_args(arguments))


def test_the_files_of_a_stage_are_the_parameters_of_its_main():
    def main(
        cloud: Annotated[str, "cloud to read"],
        photos: Annotated[Sequence[str], "photos, if any"] = (),
        report: Annotated[str | None, "JSON to write"] = None,
        *,
        limits: Limits,
        **others: str,
    ) -> None:
        """A stage."""

    parser = stage_parser("Demo.", main)
    plain = {"cloud": "a.ply", "photos": (), "report": None}
    assert vars(parser.parse_args(["--cloud", "a.ply"])) == plain
    given = parser.parse_args(["--report", "r.json", "--photos", "b", "c", "--cloud", "a.ply"])
    assert vars(given) == plain | {"photos": ["b", "c"], "report": "r.json"}
    assert "photos, if any" in parser.format_help()
    with pytest.raises(SystemExit):
        parser.parse_args([])


def test_the_options_of_a_stage_come_from_its_typed_keywords():
    assert read() == {
        **{"least": 0.5, "most": None, "box": (0.0, 1.0), "skip": True, "names": ()},
        **{"weights": None, "threads": 2},
    }
    text = "--most 2 --box 1 3 --skip false --names a b --weights trunk:10,branch:1"
    given = {"most": 2.0, "box": [1.0, 3.0], "skip": False, "names": ["a", "b"]}
    assert read(*text.split()) == read() | given | {"weights": {"trunk": 10.0, "branch": 1.0}}
    assert read("--skip")["skip"] is True


@pytest.mark.parametrize("text", ["--skip maybe", "--weights trunk", "--least much", "--box 1"])
def test_a_value_of_another_type_is_refused(text):
    with pytest.raises(SystemExit):
        read(*text.split())


def test_two_options_of_one_name_are_refused():
    def main(*, limits: Limits, least: float = 1.0):
        """Two of a name."""

    with pytest.raises(TypeError, match="two options are named least"):
        options_of(main)


def test_the_help_tells_text_key_and_default():
    stage = importlib.import_module("grow_limbs")
    parser = stage_parser(stage.__doc__, stage.main)
    add_options(parser, stage.main)
    text = " ".join(parser.format_help().split())
    assert "Longest gap that missing data may leave beside a piece of wood" in text
    assert "[config key contract.gap_m, default 0.25]" in text


def test_the_code_of_a_stage_is_found_through_its_imports(project):
    library = project / "scripts"
    files = imported_modules(library / "import_cloud.py", library)
    names = {file.removeprefix(f"{library}/cherrypicker/") for file in files}
    assert {"intake/clouds.py", "pointcloud.py", "ply.py", "runner.py", "errors.py"} <= names
    assert "batch/trees.py" not in names


def test_every_stage_script_explains_itself(project):
    folder = project / "scripts"
    scripts = sorted([*folder.glob("*.py"), *folder.glob("lab/*.py")])
    scripts.remove(folder / "lab/lab_path.py")
    assert scripts
    for script in scripts:
        head = script.read_text()
        assert head.startswith('"""'), script
        assert "python scripts/" in head.split('"""')[1], f"{script.name} shows no example command"


def test_no_openblas_takes_more_threads_than_a_stage_is_granted(project, tmp_path):
    script = tmp_path / "stage.py"
    script.write_text(
        "import cv2, numpy, scipy.linalg\n"
        "from threadpoolctl import threadpool_info\n"
        "from cherrypicker.runner import run, stage_parser\n"
        "def main():\n"
        "    blas = [each for each in threadpool_info() if each['internal_api'] == 'openblas']\n"
        "    print(*[each['num_threads'] for each in blas])\n"
        "run(main, stage_parser('Demo.'))\n"
    )
    environment = os.environ | {"PYTHONPATH": str(project / "scripts"), "OPENBLAS_NUM_THREADS": "2"}
    command = [sys.executable, str(script)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == {"1"}
