"""Ways to deploy: environments that name what is installed, containers, several machines."""

import importlib.metadata
import re
import subprocess
import sys

import pytest
import yaml
from packaging.requirements import Requirement
from workspace import PROJECT, Workspace

PINNED = {
    match[1].lower(): match[2]
    for name in ("requirements.txt", "constraints.txt", "torch.txt")
    for match in re.finditer(r"(?m)^([\w.-]+)==(\S+)", (PROJECT / "envs" / name).read_text())
}
ENVIRONMENTS = sorted((PROJECT / "envs").glob("*.yaml"))


def pip_packages(environment):
    (packages,) = (
        part["pip"]
        for part in yaml.safe_load(environment.read_text())["dependencies"]
        if isinstance(part, dict)
    )
    return [Requirement(package) for package in packages]


@pytest.mark.parametrize("environment", ENVIRONMENTS, ids=lambda path: path.stem)
def test_an_environment_names_the_versions_that_are_pinned_and_installed(environment):
    content = yaml.safe_load(environment.read_text())
    assert set(content) == {"channels", "dependencies"}
    assert "python=3.11" in content["dependencies"]
    assert "pip" in content["dependencies"]
    packages = pip_packages(environment)
    assert len({package.name for package in packages}) == len(packages) > 0
    for package in packages:
        (version,) = package.specifier
        assert version.operator == "=="
        assert PINNED[package.name.lower()] == version.version, package
        installed = importlib.metadata.version(package.name)
        assert installed.split("+")[0] == version.version, package


def test_every_rule_with_a_script_names_an_environment_that_exists():
    named = set()
    for path in (PROJECT / "workflow/rules").glob("*.smk"):
        text = path.read_text()
        for rule in re.split(r"(?m)^(?=rule )", text)[1:]:
            if "script:" in rule:
                found = re.search(r'conda:\s+"\.\./\.\./(envs/\w+\.yaml)"', rule)
                assert found, rule.splitlines()[0]
                assert (PROJECT / found[1]).is_file(), found[1]
                named.add(found[1])
    assert named == {f"envs/{path.name}" for path in ENVIRONMENTS}


@pytest.mark.parametrize("profile", sorted((PROJECT / "profiles").iterdir()), ids=lambda p: p.name)
def test_a_profile_explains_every_entry(profile):
    lines = (profile / "config.yaml").read_text().splitlines()
    assert isinstance(yaml.safe_load("\n".join(lines)), dict)
    for number, line in enumerate(lines):
        if re.match(r"[\w-]+:", line):
            assert lines[number - 1].startswith("#"), line


def test_no_profile_asks_for_conda():
    for profile in (PROJECT / "profiles").iterdir():
        content = yaml.safe_load((profile / "config.yaml").read_text())
        assert not {"sdm", "software-deployment-method", "use-conda"} & set(content)


def test_the_groups_of_the_slurm_profile_are_rules():
    rules = set()
    for path in (PROJECT / "workflow/rules").glob("*.smk"):
        rules |= set(re.findall(r"(?m)^rule (\w+):", path.read_text()))
    profile = yaml.safe_load((PROJECT / "profiles/slurm/config.yaml").read_text())
    assert set(profile["groups"]) <= rules


def a_batch(tmp_path, *trees):
    workspace = Workspace(tmp_path / "work")
    for seed, tree in enumerate(trees):
        workspace.add_cloud(tree, seed=seed)
    workspace.table("tree | cloud", *(f"{tree} | {tree}.ply" for tree in trees))
    return workspace


def dry_run(workspace, *arguments):
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(PROJECT / "Snakefile")]
    command += ["--directory", str(workspace.folder), "--dry-run", *arguments]
    done = subprocess.run(
        command,
        cwd=workspace.folder.parent,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


def test_the_slurm_profile_plans_the_whole_batch(tmp_path):
    printed = dry_run(a_batch(tmp_path, "a"), "--workflow-profile", str(PROJECT / "profiles/slurm"))
    for rule in ("import_segmented_cloud", "contract_cloud", "report_tree", "summarise_batch"):
        assert re.search(rf"{rule} +1\n", printed), printed


def test_the_apptainer_way_plans_the_whole_batch(tmp_path):
    image = ("--software-deployment-method", "apptainer", "--apptainer-args", "--bind /data")
    printed = dry_run(a_batch(tmp_path, "a"), "--cores", "2", *image)
    assert re.search(r"report_tree +1\n", printed), printed


def test_the_kubernetes_way_plans_the_whole_batch(tmp_path):
    pytest.importorskip(
        "snakemake_executor_plugin_kubernetes",
        reason="pip install snakemake-executor-plugin-kubernetes",
    )
    pod = ("--executor", "kubernetes", "--jobs", "10", "--container-image", "example.org/cherry:1")
    volume = ("--kubernetes-persistent-volumes", "orchard:/work")
    printed = dry_run(a_batch(tmp_path, "a"), *pod, *volume)
    assert re.search(r"report_tree +1\n", printed), printed


def test_two_machines_share_a_folder_by_taking_different_trees(tmp_path):
    workspace = a_batch(tmp_path, "a", "b")
    shares = [workspace.start(f"results/{tree}/report.html") for tree in "ab"]
    assert [share.wait(timeout=600) for share in shares] == [0, 0]
    for tree in "ab":
        assert (workspace.folder / f"results/{tree}/report.html").stat().st_size > 0
    assert workspace.ran() == {("summarise_batch", "")}
