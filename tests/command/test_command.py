"""The command: its subcommands but serve and check, each as a user calls it."""

import csv
import importlib.metadata
import io
import json
import os
import re
import subprocess
import sys
from types import SimpleNamespace

import pytest
import yaml
from finished_tree import write_finished_tree
from PIL import Image
from rich.console import Console
from workspace import small_tree

from cherrypicker.batch.config import read_config_file, resolve_config
from cherrypicker.batch.trees import read_trees
from cherrypicker.command import doctor, run
from cherrypicker.command.main import SUBCOMMANDS, main
from cherrypicker.command.time_left import TimeLeft
from cherrypicker.files import load_yaml, read_json, write_json
from cherrypicker.formats.table import FORMATS
from cherrypicker.pointcloud import PointCloud, write_cloud
from cherrypicker.progress import duration
from cherrypicker.runner import SCHEMA_FILE
from cherrypicker.traits.branches import branches_csv, read_branches
from snakemake_logger_plugin_cherrypicker import SEPARATOR


@pytest.fixture
def work(tmp_path, monkeypatch):
    """A work folder with one finished tree; the current folder comes back."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "work"
    (folder / "config").mkdir(parents=True)
    (folder / "config/trees.tsv").write_text("tree\tcloud\nsmall\tnone.ply\n")
    (folder / "config/config.yaml").write_text("{}\n")
    return folder


def test_every_subcommand_has_help(capsys):
    assert main([]) == 0
    shown = capsys.readouterr().out
    for name in SUBCOMMANDS:
        assert f"  {name} " in shown
        with pytest.raises(SystemExit) as end:
            main([name, "--help"])
        assert end.value.code == 0
    assert "usage: cherrypicker" in capsys.readouterr().out
    assert main(["prune"]) == 2


def test_the_command_of_a_clone_starts_that_clone(project, tmp_path):
    clone = tmp_path / "my clone"
    (clone / ".venv/bin").mkdir(parents=True)
    (clone / "scripts").symlink_to(project / "scripts")
    launcher = clone / ".venv/bin/cherrypicker"
    launcher.write_bytes((project / "envs/cherrypicker").read_bytes())
    launcher.chmod(0o755)
    python = clone / ".venv/bin/python"
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n')
    python.chmod(0o755)
    (tmp_path / "link").symlink_to(launcher)
    (tmp_path / "yaml.py").write_text("raise SystemExit('a file of the work folder was imported')")
    done = subprocess.run(
        [tmp_path / "link", "export", "a b", "--to", "mtg"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": ""},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1 and "error: tree a b" in done.stderr, done.stderr


def photo(path, taken=""):
    path.parent.mkdir(parents=True, exist_ok=True)
    exif = Image.Exif()
    if taken:
        exif.get_ifd(0x8769)[0x9003] = taken
    Image.new("RGB", (8, 6)).save(path, exif=exif)


@pytest.mark.parametrize(
    ("photos", "masks"),
    [("a/photos", "a/masks"), ("a", "a/masks"), ("photos/a", "masks/a"), ("a", "a_masks")],
)
def test_init_takes_masks_for_masks(tmp_path, photos, masks):
    for i in range(3):
        photo(tmp_path / photos / f"IMG_{i}.jpg", "2026:02:11 10:00:00")
        path = tmp_path / masks / (f"IMG_{i}.png" if i else "IMG_0.jpg.png")
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("L", (8, 6)).save(path)
        coloured = tmp_path / "b" / f"IMG_{i}.png"
        coloured.parent.mkdir(exist_ok=True)
        Image.new("RGB", (8, 6)).save(coloured)
    assert main(["init", str(tmp_path)]) == 0
    rows = read_trees(tmp_path / "config/trees.tsv")
    assert {(row.photos, row.masks) for row in rows} == {(photos, masks), ("b", "")}


def test_init_finds_scans_by_sub_folder(tmp_path, capsys):
    for place in ("row 1/tree07/photos", "row 2/tree07", "few"):
        for i in range(2 if place == "few" else 3):
            photo(tmp_path / place / f"{i}.jpg", "2026:02:11 10:00:00")
    (tmp_path / "film").mkdir()
    (tmp_path / "film/walk.MOV").touch()
    (tmp_path / '"lidar"').mkdir()
    (tmp_path / '"lidar"/old.laz').touch()
    marker = ["--marker_dictionary", "DICT_4X4_50", "--marker_sides_m", "7:0.20"]
    assert main(["init", str(tmp_path), *marker]) == 0
    rows = {row.tree: row for row in read_trees(tmp_path / "config/trees.tsv")}
    assert list(rows) == ["old", "film", "tree07", "row_2_tree07"]
    assert rows["film"].photos == "film" and rows["film"].date == ""
    assert rows["tree07"].photos == "row 1/tree07/photos" and rows["tree07"].date == "2026-02-11"
    assert rows["tree07"].marker_sides_m == "7:0.20" and rows["old"].cloud == '"lidar"/old.laz'
    settings = read_config_file(tmp_path / "config/config.yaml")
    assert settings == {"method": "default"}
    assert main(["init", str(tmp_path)]) == 1
    assert "nothing was written" in capsys.readouterr().err


def test_init_follows_links_once_and_never_upward(tmp_path, capsys):
    elsewhere, work = tmp_path / "card/DCIM/100", tmp_path / "work"
    for i in range(3):
        photo(elsewhere / f"{i}.jpg")
        photo(work / "own" / f"{i}.jpg")
    for name, target in (("tree", elsewhere), ("again", work / "own"), ("up", tmp_path)):
        (work / name).symlink_to(target)
    assert main(["init", str(work)]) == 0
    rows = read_trees(work / "config/trees.tsv")
    assert [(row.tree, row.photos) for row in rows] == [("own", "own"), ("tree", "tree")]
    assert "nothing found" not in capsys.readouterr().out


def test_init_says_what_it_looked_for(tmp_path, capsys):
    photo(tmp_path / "few/1.jpg")
    assert main(["init", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert f"nothing found below {tmp_path}: looked for folders with 3 photos" in shown
    assert ".laz" in shown


def test_check_of_an_empty_table_says_so(work, capsys):
    (work / "config/trees.tsv").write_text("tree\tcloud\n")
    assert main(["check", "-d", str(work)]) == 1
    assert "the table has no tree" in capsys.readouterr().err


def test_check_refuses_a_cloud_whose_unit_is_wrong(work, capsys):
    write_cloud(work / "a.ply", PointCloud(1000 * small_tree().points))
    (work / "config/trees.tsv").write_text("tree\tcloud\tcloud_unit\na\ta.ply\t\nb\ta.ply\tmm\n")
    assert main(["check", "a", "-d", str(work), "b"]) == 1  # on both sides of an option
    refused, key, taken = capsys.readouterr().out.splitlines()
    assert refused == "a: cannot run" and "m high" in key and "cloud_unit" in key
    assert taken.startswith("b: go, a ready cloud of") and "1.2" in taken


def test_every_key_of_the_commented_config_is_one(tmp_path):
    assert main(["init", str(tmp_path)]) == 0
    text = (tmp_path / "config/config.yaml").read_text()
    keys = yaml.safe_load(re.sub(r"^#(?= *[a-z_]+:)", "", text, flags=re.MULTILINE))
    assert len(keys) > 5
    resolve_config(load_yaml(SCHEMA_FILE), keys)


def test_export_writes_beside_the_results(work, capsys):
    write_finished_tree(work / "results/small")
    assert main(["export", "small", "-d", str(work), "--to", *FORMATS]) == 0
    written = {path.name for path in (work / "results/small/export").iterdir()}
    assert written == {f"small{kind.suffix}" for kind in FORMATS.values()}
    own = work / "own.mtg"
    assert main(["export", "small", "-d", str(work), "--to", "mtg", "-o", str(own)]) == 0
    packed = work / "own.laz"
    assert main(["export", "small", "-d", str(work), "--to", "las", "-o", str(packed)]) == 0
    assert own.is_file() and packed.is_file()
    assert main(["export", "small", "-d", str(work), "--to", "mtg", "-o", str(packed)]) == 1
    assert "a file of mtg ends in .mtg; file: " in capsys.readouterr().err
    assert main(["export", "none", "-d", str(work), "--to", "mtg"]) == 1
    assert "tree none" in capsys.readouterr().err


def test_repeat_tells_how_far_two_scans_differ(work, capsys):
    heights, results = {"noon": 1.40, "dusk": 1.43}, work / "results"
    for name, height in heights.items():
        write_finished_tree(results / name)
        traits = read_json(results / name / "traits.json") | {"height_m": height}
        traits["height_m_ci90"] = [height - 0.01, height + 0.01]
        write_json(results / name / "traits.json", traits)
    rows = read_branches(results / "dusk/branches.csv")
    rows[2]["length_m"] += 0.2
    (results / "dusk/branches.csv").write_text(branches_csv(rows))
    assert main(["repeat", "noon", "dusk", "-d", str(work)]) == 0
    with (results / "repeat/repeat.csv").open(newline="") as stream:
        rows = {row["trait"]: row for row in csv.DictReader(stream)}
    height = {name: float(rows["height_m"][name] or "nan") for name in ("bias", "within_sd")}
    assert height == pytest.approx({"bias": 0.03, "within_sd": 0.03 / 2**0.5}, rel=1e-4)
    assert (rows["height_m"]["n_intervals"], rows["height_m"]["n_covered"]) == ("1", "0")
    assert float(rows["total_length_m"]["within_cv"]) == 0
    assert int(rows["branch_length_m"]["n_pairs"]) == 5
    assert float(rows["branch_length_m"]["bias"]) == pytest.approx(0.2 / 5, rel=1e-3)
    assert int(rows["branch_angle_deg"]["n_pairs"]) == 4  # the stem hangs on nothing
    page = (results / "repeat/repeat.html").read_text()
    assert "noon, branch 2: " in page and "141.5 cm" in page
    for wrong, why in (
        (["noon", "dusk", "dawn"], "no pairs"),
        (["noon", "noon"], "agrees with itself"),
        (["noon", "dawn"], "tree dawn"),
        (["noon", "dusk", "--difference", "0"], "--difference"),
    ):
        assert main(["repeat", *wrong, "-d", str(work)]) == 1
        assert why in capsys.readouterr().err


def test_view_wants_a_page(work, capsys):
    assert main(["view", "small", "-d", str(work)]) == 1
    assert "report.html" in capsys.readouterr().err


def test_run_passes_its_options_and_shows_a_dry_run(work, capfd):
    assert main(["run", "-d", str(work), "--dry-run", "--cores", "1", "--quiet", "rules"]) == 0
    shown = capfd.readouterr().out
    assert "--dry-run --cores 1 --quiet rules" in shown.splitlines()[0]
    assert "import_cloud" in shown and "dry-run" in shown


SNAKEFILE = r"""
import json, pathlib
onstart:
    pathlib.Path("results/traits.csv").touch()
    pathlib.Path("logs/status/bad").mkdir(parents=True)
    told = {"cause": "no points", "file": "bad.ply", "key": "cloud in trees.tsv"}
    told |= {"state": "failed", "log": "logs/import_cloud/bad.log"}
    pathlib.Path("told.json").write_text(json.dumps(told))
wildcard_constraints:
    tree=r"\w+",
rule all:
    input: expand("{tree}.txt", tree=TREES)
rule measure_traits:
    output: "traits/{tree}.txt"
    message: "{wildcards.tree}: measure the traits"
    shell: "echo '[{wildcards.tree} measure_traits] half' >&2; touch {output}"
rule import_cloud:
    input: "traits/{tree}.txt"
    output: "{tree}.txt"
    log: "logs/import_cloud/{tree}.log"
    message: "{wildcards.tree}: import the ready cloud"
    shell:
        "case {wildcards.tree} in "
        "bad) cp told.json logs/status/bad/import_cloud.json; exit 1 ;; "
        "full) echo 'ERROR tree=full rule=import_cloud: no room; log: x' >&2; exit 1 ;; "
        "killed) kill -9 $$ ;; "
        "twice) test -e once || {{ touch once; exit 1; }} ;; "
        "esac; touch {output}"
"""


def run_of(work, monkeypatch, capsys, *trees, options=()):
    """Run a small workflow over these trees; return the exit status and what was shown."""
    (work / "Snakefile").write_text(f"TREES = {list(trees)}\n{SNAKEFILE}")
    (work / "results").mkdir()
    table = "tree,status,failed_stage,cause,height_m\ngood,done,,,1.2\nbad,failed,stage,none,\n"
    (work / "results/traits.csv").write_text(table)
    (work / "logs/status/killed").mkdir(parents=True)
    earlier = {"state": "failed", "cause": "of an earlier run"} | dict.fromkeys(
        ("file", "key", "log")
    )
    write_json(work / "logs/status/killed/import_cloud.json", earlier)
    monkeypatch.setattr(run, "PROJECT", work)
    status = main(["run", "-d", str(work), "--cores", "1", "--keep-going", *options])
    return status, capsys.readouterr().out


def test_run_tells_a_line_a_job_and_a_failure(work, capsys, monkeypatch):
    status, shown = run_of(work, monkeypatch, capsys, "good", "bad", "full", "killed")
    assert status == 1
    assert re.search(r"^\[\d/9\] good: measure the traits, \d+ s; about .* left$", shown, re.M)
    assert sorted(line for line in shown.splitlines() if "FAILED" in line) == [
        "FAILED bad import_cloud: no points; file: bad.ply; change: cloud in trees.tsv; "
        "log: logs/import_cloud/bad.log",
        "FAILED full import_cloud: no room; log: x",
        "FAILED killed import_cloud: it ended without a word (killed, or out of memory?); "
        "log: logs/import_cloud/killed.log",
    ]
    assert "[good measure_traits] half" in shown
    assert ".snakemake.log" in shown and "1.2" in shown and "stage: none" in shown
    assert "Select jobs" not in shown and "RuleException" not in shown


def test_a_job_that_is_tried_again_is_told(work, capsys, monkeypatch):
    status, shown = run_of(work, monkeypatch, capsys, "twice", options=["--retries", "1"])
    assert status == 0
    told = [line for line in shown.splitlines() if "import the ready" in line or "FAILED" in line]
    assert told[0].startswith("FAILED twice import_cloud: it ended without a word")
    assert told[1] == "again: twice: import the ready cloud" and told[2].startswith("[2/3]")
    assert len(told) == 3 and "[3/3] all" in shown, "a failure of an earlier run is not told"


def test_a_quiet_run_still_tells_of_failures(work, capsys, monkeypatch):
    _, shown = run_of(work, monkeypatch, capsys, "bad", options=["--quiet", "all"])
    assert "FAILED bad import_cloud: no points; file: bad.ply" in shown
    assert "Building DAG" not in shown


def test_the_jobs_and_the_cores_are_counted():
    left = TimeLeft({})
    view = run._View(Console(file=io.StringIO()), left)
    stats = {"a_b": 3, "all": 1, "total": 4}
    for told in ({"event": "run_info", "stats": stats}, {"event": "resources_info", "cores": 4}):
        view.take(SEPARATOR + json.dumps(told | {"level": 20}))
    assert left.waiting == {"a_b": 3, "all": 1} and left.cores == 4


def test_what_a_short_job_says_before_snakemake_tells_of_it_is_told():
    shown = io.StringIO()
    view = run._View(Console(file=shown, width=120, markup=False), TimeLeft({}))
    job = {"event": "job_info", "level": 20, "jobid": 1, "rule_name": "import_cloud"}
    job |= {"rule_msg": "full: import", "wildcards": {"tree": "full"}, "log": []}
    view.take("[full import_cloud] half")
    view.take("[other import_cloud] half")
    view.take("ERROR tree=full rule=import_cloud: no room; log: x")
    assert not shown.getvalue()
    view.take(SEPARATOR + json.dumps(job))
    view.take(SEPARATOR + json.dumps({"event": "job_error", "level": 40, "jobid": 1}))
    assert shown.getvalue().splitlines() == [
        "[full import_cloud] half",
        "FAILED full import_cloud: no room; log: x",
    ]


def test_what_stops_a_run_before_its_jobs_is_told(work, capfd):
    (work / "config/trees.tsv").write_text("tree\tclod\n")
    assert main(["run", "-d", str(work), "--cores", "1"]) == 1
    assert "unknown column 'clod'; did you mean 'cloud'?" in capfd.readouterr().out


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("graph: {spacing_m: 0.01", "no valid YAML"),
        ("- a\n", "keys and values"),
        ("# seed: 1\n", "holds nothing"),
    ],
)
def test_a_config_that_cannot_be_read_is_named(work, capsys, text, reason):
    (work / "config/config.yaml").write_text(text)
    assert main(["run", "-d", str(work)]) == 1
    told = capsys.readouterr().err
    assert reason in told and "file: config/config.yaml" in told


def test_time_left_follows_the_forecast_and_the_pace(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("cherrypicker.command.time_left.time.monotonic", lambda: now[0])
    left = TimeLeft({"estimate_depth": 300.0, "fuse_depth": 100.0, "measure_traits": 100.0})
    left.waiting.update(estimate_depth=2, fuse_depth=2, measure_traits=2, all=1)
    left.cores = 2
    assert left.left_s() == pytest.approx(500.0)
    now[0] = 600.0  # four times slower than two cores by the forecast
    left.finish("estimate_depth")
    assert left.left_s() == pytest.approx(2.0 * 700.0)
    left.fail("fuse_depth")
    assert left.left_s() == pytest.approx(2.0 * 500.0)
    assert [duration(s) for s in (5, 65, 7300, 2e5)] == [
        "5 s",
        "1 min 05 s",
        "2 h 01 min",
        "2.3 days",
    ]


def test_doctor_tells_what_is_missing(work, capsys, monkeypatch):
    pins = {"numpy": "0.1", "no-such-package": "1.0"}
    monkeypatch.setattr(doctor, "pinned_versions", lambda: pins)
    assert main(["doctor", "-d", str(work)]) == 1
    lines = capsys.readouterr().out.splitlines()
    told = {line[5:27].strip(): line for line in lines}
    assert "MISS" in told["no-such-package"] and "make install" in told["no-such-package"]
    assert "note" in told["numpy"] and "pinned is 0.1" in told["numpy"]
    assert {"python", "GPU", "cores", "memory", "disk", "dgcnn.pt"} <= told.keys()


def test_doctor_finds_a_package_that_spells_itself_otherwise(work, capsys, monkeypatch):
    pins = {"Robust.Laplacian": importlib.metadata.version("robust-laplacian")}
    monkeypatch.setattr(doctor, "pinned_versions", lambda: pins)
    main(["doctor", "-d", str(work)])
    told = capsys.readouterr().out
    assert "1 of 1 as pinned" in told and "Robust.Laplacian" not in told


def test_doctor_takes_the_pycolmap_of_a_gpu(work, capsys, monkeypatch):
    """README has it installed in the place of the other, of the same version."""
    own = SimpleNamespace(name="pycolmap-cuda12", version="4.2.1")
    monkeypatch.setattr(importlib.metadata, "distributions", lambda: [own])
    monkeypatch.setattr(doctor, "pinned_versions", lambda: {"pycolmap": "4.2.1"})
    main(["doctor", "-d", str(work)])
    assert "1 of 1 as pinned" in capsys.readouterr().out


def test_every_pin_is_read():
    assert {"rich", "torch", "numpy", "snakemake"} <= doctor.pinned_versions().keys()


def test_a_folder_that_is_none_is_told(capsys):
    assert main(["doctor", "-d", "/no/such/folder"]) == 1
    assert "/no/such/folder" in capsys.readouterr().err
