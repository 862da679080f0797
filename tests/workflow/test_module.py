"""The workflow by path, as a module, in the catalog of Snakemake and in its report."""

import subprocess
import sys

import pytest
import yaml
from workspace import PROJECT, Workspace

MODULE = """
configfile: "config/config.yaml"

module cherrypicker:
    snakefile: "{project}/workflow/Snakefile"
    config: config

use rule * from cherrypicker

rule mine:
    input: "results/small/segmented.ply"
    output: "mine.txt"
    default_target: True
    shell: "flock --nonblock .snakemake/starting wc -c < {{input}} > {{output}}"
"""


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """A small tree's labelled cloud, imported as everybody does."""
    space = Workspace(tmp_path_factory.mktemp("plain"))
    space.add_cloud("small")
    space.table("tree | cloud", "small | small.ply")
    space.run("results/small/segmented.ply")
    return space


def snakemake(folder, *arguments):
    call = [sys.executable, "-m", "snakemake", "--cores", "1", *arguments]
    done = subprocess.run(
        call, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


def test_a_module_gives_the_same_bytes(plain, tmp_path):
    space = Workspace(tmp_path / "work")
    space.add_cloud("small")
    space.table("tree | cloud", "small | small.ply")
    (space.folder / "Snakefile").write_text(MODULE.format(project=PROJECT), encoding="utf-8")
    snakemake(space.folder)
    theirs = (space.folder / "results/small/segmented.ply").read_bytes()
    assert theirs == (plain.folder / "results/small/segmented.ply").read_bytes()
    assert (space.folder / "mine.txt").is_file()


def test_the_configuration_of_the_catalog_plans_every_stage(tmp_path):
    """By the path that the catalog expects; the profile beside it is found."""
    told = yaml.safe_load((PROJECT / ".snakemake-workflow-catalog.yml").read_text(encoding="utf-8"))
    assert set(told["usage"]["software-stack-deployment"]) >= {"conda", "apptainer"}
    workflow = str(PROJECT / "workflow/Snakefile")
    planned = snakemake(
        PROJECT / ".test", "--snakefile", workflow, "--dry-run", "--forceall", "--nolock"
    )
    for rule in ("import_segmented_cloud", "extract_graph", "report_tree", "summarise_batch"):
        assert rule in planned
    assert "profiles/default" in planned


def test_the_report_has_a_landing_page(plain):
    plain.run("--report", "report.html", "results/small/segmented.ply")
    page = (plain.folder / "report.html").read_text(encoding="utf-8")
    assert "Where to begin" in page
