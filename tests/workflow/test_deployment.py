"""Ways to deploy: environments that name what is installed, containers, several machines."""

import csv
import importlib.metadata
import os
import re
import shutil
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
    for path in (PROJECT / "workflow/rules").rglob("*.smk"):
        text = path.read_text()
        for rule in re.split(r"(?m)^(?=rule )", text)[1:]:
            if "script:" in rule:
                found = re.search(r'conda:\s+"(\S+\.yaml)"', rule)
                assert found, rule.splitlines()[0]
                named.add((path.parent / found[1]).resolve())
    assert named == set(ENVIRONMENTS)


@pytest.mark.parametrize("profile", sorted((PROJECT / "profiles").iterdir()), ids=lambda p: p.name)
def test_a_profile_explains_every_entry(profile):
    lines = (profile / "profile.yaml").read_text().splitlines()
    assert isinstance(yaml.safe_load("\n".join(lines)), dict)
    for number, line in enumerate(lines):
        if re.match(r"[\w-]+:", line):
            assert lines[number - 1].startswith("#"), line


def test_the_hooks_before_a_commit_are_the_checks_of_make_lint():
    (hooks,) = yaml.safe_load((PROJECT / ".pre-commit-config.yaml").read_text())["repos"]
    entries = [hook["entry"].removeprefix(".venv/bin/") for hook in hooks["hooks"]]
    recipe = re.search(r"(?m)^lint: install\n((?:\t.+\n)+)", (PROJECT / "Makefile").read_text())
    assert entries == re.findall(r"\$\(VENV\)/bin/(.+)", recipe[1])


def test_no_profile_asks_for_conda():
    for profile in (PROJECT / "profiles").iterdir():
        content = yaml.safe_load((profile / "profile.yaml").read_text())
        assert not {"sdm", "software-deployment-method", "use-conda"} & set(content)


def test_the_groups_of_a_profile_are_rules():
    rules = set()
    for path in (PROJECT / "workflow/rules").rglob("*.smk"):
        rules |= set(re.findall(r"(?m)^rule (\w+):", path.read_text()))
    slurm, kubernetes = (
        yaml.safe_load((PROJECT / f"profiles/{name}/profile.yaml").read_text())["groups"]
        for name in ("slurm", "kubernetes")
    )
    assert set(slurm) <= rules and slurm == kubernetes


def a_batch(tmp_path, *trees):
    workspace = Workspace(tmp_path / "work")
    for seed, tree in enumerate(trees):
        workspace.add_cloud(tree, seed=seed)
    workspace.table("tree | cloud", *(f"{tree} | {tree}.ply" for tree in trees))
    return workspace


def test_the_slurm_profile_plans_the_whole_batch(tmp_path):
    """Also with a stage between two of a group, which belongs to the group or nothing starts."""
    batch = a_batch(tmp_path, "a")
    asked = {"light": {"enabled": True}, "bearing": {"enabled": True}}
    batch.configure({**asked, "pruning": {"preset": "ltr_100"}})
    printed = batch.run("--dry-run", "--workflow-profile", str(PROJECT / "profiles/slurm"))
    rules = ("import_segmented_cloud", "contract_cloud", "measure_light", "measure_bearing")
    for rule in (*rules, "propose_pruning", "report_tree", "summarise_batch"):
        assert re.search(rf"{rule} +1\n", printed), printed


@pytest.mark.skipif(not shutil.which("conda"), reason="conda is not installed")
def test_the_conda_way_plans_the_whole_batch(tmp_path):
    printed = a_batch(tmp_path, "a").run("--dry-run", "--sdm", "conda")
    assert re.search(r"report_tree +1\n", printed), printed


def test_the_image_copies_and_installs_what_exists():
    lines = (PROJECT / "envs/Dockerfile").read_text().splitlines()
    # Debian 12, whose Python is a tried one; another base can be given
    assert any(line.startswith("ARG BASE=") and "debian:bookworm" in line for line in lines)
    assert "FROM $BASE" in lines
    assert any(line.startswith("RUN make install") for line in lines)
    libraries = (PROJECT / "envs/install_system_packages.sh").read_text()
    needed = {pair.split(":")[1] for pair in re.search(r'libraries="(.*)"', libraries)[1].split()}
    assert needed <= set(" ".join(lines).split())
    ignored = (PROJECT / ".dockerignore").read_text().split()
    assert ".venv" in ignored
    for name in ("workflow", "scripts", "resources", "profiles", "envs", "config"):
        assert not {name, f"{name}/", f"{name}/*"} & set(ignored)


KUBECTL = """#!{python}
import os, subprocess, sys
from pathlib import Path

import yaml

jobs = Path({jobs!r})
command, *rest = sys.argv[1:]
if command == "create":
    manifest = yaml.safe_load(sys.stdin)
    name = "job%d" % len(list(jobs.glob("*.yaml")))
    (jobs / (name + ".yaml")).write_text(yaml.safe_dump(manifest))
    (container,) = manifest["spec"]["template"]["spec"]["containers"]
    done = jobs / (name + ".done")
    shell = ["/bin/sh", "-c", '"$@"; echo $? > ' + str(done), "sh", *container["command"]]
    with open(jobs / (name + ".log"), "wb") as log:
        subprocess.Popen(shell, stdout=log, stderr=log, stdin=subprocess.DEVNULL)
    print(name, end="")
elif command == "get":
    done = jobs / (rest[1] + ".done")
    code = done.read_text().strip() if done.exists() else ""
    succeeded, failed = ("1" if code == "0" else "", "1" if code not in ("", "0") else "")
    print("found %s failed=%s" % (succeeded, failed), end="")
"""


def test_the_kubernetes_profile_runs_a_batch_through_kubectl(tmp_path):
    """A stand-in for kubectl runs the container's command; the manifests are checked."""
    workspace = a_batch(tmp_path, "a")
    jobs = tmp_path / "jobs"
    jobs.mkdir()
    kubectl = tmp_path / "bin/kubectl"
    kubectl.parent.mkdir()
    kubectl.write_text(KUBECTL.format(python=sys.executable, jobs=str(jobs)))
    kubectl.chmod(0o755)
    profile = PROJECT / "profiles/kubernetes"
    environment = {
        **os.environ,
        "PATH": f"{kubectl.parent}:{os.environ['PATH']}",
        "PYTHONPATH": "",
        "CHERRYPICKER_KUBERNETES": str(profile),
        "CHERRYPICKER_IMAGE": "registry.example.org/cherrypicker:0.2",
        "CHERRYPICKER_CLAIM": "orchard",
        "CHERRYPICKER_MOUNT": str(tmp_path),
    }
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(PROJECT / "Snakefile")]
    command += ["--directory", str(workspace.folder), "--workflow-profile", str(profile)]
    done = subprocess.run(
        [*command, "results/a/segmented.ply", "--seconds-between-status-checks", "1"],
        cwd=tmp_path,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    assert (workspace.folder / "results/a/segmented.ply").stat().st_size > 0
    (path,) = jobs.glob("*.yaml")
    job = yaml.safe_load(path.read_text())
    pod = job["spec"]["template"]["spec"]
    assert job["spec"]["backoffLimit"] == 0
    assert pod["volumes"][0]["persistentVolumeClaim"]["claimName"] == "orchard"
    (container,) = pod["containers"]
    assert container["volumeMounts"] == [{"name": "work", "mountPath": str(tmp_path)}]
    assert container["resources"]["requests"]["cpu"] == "1"
    limits = container["resources"]["limits"]
    assert limits == {"memory": container["resources"]["requests"]["memory"]}


@pytest.mark.parametrize(
    ("answer", "code", "status"),
    [
        ("found 1 failed=", 0, "success"),
        ("found  failed=", 0, "running"),
        ("found  failed=1", 0, "failed"),
        ("", 0, "failed"),
        ("", 1, "running"),
    ],
)
def test_the_status_of_a_kubernetes_job_is_told_apart(tmp_path, answer, code, status):
    kubectl = tmp_path / "kubectl"
    kubectl.write_text(f"#!/bin/sh\nprintf '{answer}'\nexit {code}\n")
    kubectl.chmod(0o755)
    told = subprocess.run(
        [str(PROJECT / "profiles/kubernetes/status.sh"), "cherrypicker-x"],
        env={**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    assert told.stdout.strip() == status


def test_a_kubernetes_job_asks_for_a_gpu_where_its_rule_does(tmp_path):
    kubectl = tmp_path / "kubectl"
    kubectl.write_text("#!/bin/sh\ncat\n")
    kubectl.chmod(0o755)
    names = ("IMAGE", "CLAIM", "MOUNT")
    created = subprocess.run(
        [str(PROJECT / "profiles/kubernetes/submit.sh"), "8", "9100", "120", "1", "/work/job.sh"],
        env={
            **os.environ,
            "PATH": f"{tmp_path}:{os.environ['PATH']}",
            **{f"CHERRYPICKER_{name}": "x" for name in names},
        },
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    job = yaml.safe_load(created.stdout)
    (container,) = job["spec"]["template"]["spec"]["containers"]
    assert container["resources"] == {
        "requests": {"cpu": "8", "memory": "9100M"},
        "limits": {"memory": "9100M", "nvidia.com/gpu": "1"},
    }
    assert job["spec"]["activeDeadlineSeconds"] == 7200
    assert container["command"] == ["/bin/sh", "/work/job.sh"]


def test_two_machines_share_a_folder_by_taking_different_trees(tmp_path):
    workspace = a_batch(tmp_path, "a", "b")
    contracted = [f"results/{tree}/contracted.ply" for tree in "ab"]
    shares = [workspace.start(target) for target in contracted]
    assert [share.wait(timeout=600) for share in shares] == [0, 0]
    assert workspace.planned(*contracted) == set()
    workspace.run("results/traits.csv", "--config", "finished_only=true")
    with open(workspace.folder / "results/traits.csv", newline="") as stream:
        assert [row["tree"] for row in csv.DictReader(stream)] == ["a", "b"]
