"""Each config key reaches the options of its name in the stages that read it, and reruns these."""

import importlib
import inspect
import os
import re
from pathlib import Path

import pytest
from snakemake.api import SnakemakeApi
from snakemake.iocontainers import Wildcards
from snakemake.settings.types import OutputSettings, ResourceSettings
from workspace import PROJECT, Workspace

from cherrypicker.batch.config import resolve_config
from cherrypicker.files import load_yaml
from cherrypicker.runner import keys_of_stage, options_of

SCHEMA = load_yaml(PROJECT / "workflow/schemas/config.schema.yaml")
# Keys that no stage takes as an option, and what reads them.
ELSEWHERE = {
    "method": "the batch: which defaults the keys have",
    "trees": "the batch: which trees there are",
    "measures": "the batch: what was measured by hand on which trees",
    "finished_only": "the rules of the summary and the series: which trees are their inputs",
    "keep.dense": "the rules of the dense stage: which outputs are temporary",
    "light.enabled": "report_tree: whether it has an input, which makes the light a target",
    "bearing.enabled": "report_tree: whether it has an input, which makes it a target",
    "graph.edits": "edit_graph: its input, and which rule makes a tree's skeleton",
    "orchard.n_scenes": "orchard: which scenes are made",
    "orchard.seed": "orchard, make_skeleton_set: which scenes and trees are made",
    "orchard.chosen": "make_orchard_scene, render_orchard_scene: handed over as JSON",
    "orchard.render": "orchard: whether photos are among the targets",
    "orchard.skeleton_trees": "make_skeleton_set: its n_trees",
    "benchmark.skeleton": "benchmark_skeleton: which trees and methods are measured",
    "benchmark.traits": "benchmark_traits: which trees are measured",
    "benchmark.series": "benchmark_series: which trees are measured, and how they are seen",
    "benchmark.intervals": "fit_intervals: which trees and scans are measured",
}
# Whose default differs from the schema's.
OTHER_DEFAULT = {
    ("make_orchard_scene", "forms"): "a scene by hand is drawn from every form that there is",
    ("render_orchard_scene", "forms"): "a scene by hand is drawn from every form that there is",
}
# A workflow of its own runs inside: it takes the whole config.
WHOLE_CONFIG = "measure_error_budget"
WILDCARDS = {
    "tree": "a",
    "scene_seed": "0",
    "tree_seed": "9000",
    "walk": "seen",
    "series": "row_1",
    "grown": "thin",
    "number": "00",
    "kind": "default",
    "millimetres": "120",
}


def every_key():
    for name, section in SCHEMA["properties"].items():
        if section.get("default") != {}:
            yield name, section.get("stages", [])
        else:
            stages = section.get("stages", [])
            for key, each in section["properties"].items():
                yield f"{name}.{key}", each.get("stages", stages)


STAGES_OF = dict(every_key())
STAGES = sorted({stage for stages in STAGES_OF.values() for stage in stages})


@pytest.fixture(scope="module")
def mains():
    """The ``main`` of each stage."""
    return {stage: importlib.import_module(stage).main for stage in STAGES}


@pytest.fixture(scope="module")
def options(mains):
    return {stage: options_of(main) for stage, main in mains.items()}


def test_every_key_is_read_by_a_stage_or_by_what_is_listed():
    assert {key for key, stages in STAGES_OF.items() if not stages} == set(ELSEWHERE)


@pytest.mark.parametrize("stage", STAGES)
def test_the_keys_of_a_stage_are_options_with_the_same_defaults(options, stage):
    settings = resolve_config(SCHEMA, {})
    for key in keys_of_stage(SCHEMA, stage):
        section, _, name = key.rpartition(".")
        assert name in options[stage], f"{stage} has no option for {key}"
        option = options[stage][name]
        default = (settings[section] if section else settings)[name]
        if (stage, name) in OTHER_DEFAULT or default is None:  # null is the code's own default
            continue
        if isinstance(option.default, tuple):
            assert list(option.default) == default, key
        else:
            assert option.default == default, key
            assert isinstance(default, bool) == isinstance(option.default, bool), key


@pytest.mark.parametrize("stage", STAGES)
def test_every_option_is_used(mains, options, stage):
    main = mains[stage]
    for name, option in options[stage].items():
        if not option.holder:
            used = re.findall(rf"\b{name}\b", inspect.getsource(main))
            assert len(used) > 1, f"{stage}.main only names {name}"
        else:
            kind = inspect.signature(main, eval_str=True).parameters[option.holder].annotation
            rooms = {Path(*c.__module__.split(".")[:2]) for c in kind.__mro__ if c is not object}
            files = [f for r in rooms for f in (PROJECT / "scripts" / r).rglob("*.py")]
            package = PROJECT / "scripts" / min(rooms).parts[0]
            files += [f for f in package.rglob("*.py") if kind.__name__ in f.read_text()]
            text = "".join(file.read_text() for file in files)
            text += inspect.getsource(main)
            assert re.search(rf"\.{name}\b", text), f"nothing reads {kind.__name__}.{name}"


def test_a_key_goes_to_no_two_options_of_one_name():
    for stage in STAGES:
        names = [key.rpartition(".")[2] for key in keys_of_stage(SCHEMA, stage)]
        assert len(names) == len(set(names)), stage


@pytest.fixture(scope="module")
def workflow(tmp_path_factory):
    """The workflow with all rules, loaded once for one tree from photos."""
    workspace = Workspace(tmp_path_factory.mktemp("options") / "work")
    workspace.table("tree | photos | scale", "a | photos | none")
    before = Path.cwd()
    with SnakemakeApi(OutputSettings(quiet={"all"})) as api:
        loaded = api.workflow(
            ResourceSettings(cores=1), snakefile=PROJECT / "Snakefile", workdir=workspace.folder
        )
        yield loaded._workflow
    os.chdir(before)


def params_by_script(workflow):
    """What each rule hands to its script, by script; functions of inputs are not compared."""
    wildcards = Wildcards(fromdict=WILDCARDS)
    found = {}
    for rule in workflow.rules:
        if not rule.script or Path(rule.script).stem == WHOLE_CONFIG:
            continue
        values = {
            name: value(wildcards) if callable(value) else value
            for name, value in rule.params.items()
            if not callable(value) or len(inspect.signature(value).parameters) == 1
        }
        found[rule.name, Path(rule.script).stem] = values
    return found


@pytest.fixture(scope="module")
def unchanged(workflow):
    return params_by_script(workflow)


@pytest.mark.parametrize("key", [key for key in STAGES_OF if key not in ELSEWHERE])
def test_a_changed_key_reruns_its_stages_and_no_other(workflow, unchanged, key):
    section, _, name = key.rpartition(".")
    held = [workflow.globals["SETTINGS"], workflow.globals["BATCH"].settings_of["a"]]
    held = [settings[section] if section else settings for settings in held]
    was = [settings[name] for settings in held]
    for settings in held:
        settings[name] = "changed"
    try:
        changed = params_by_script(workflow)
    finally:
        for settings, value in zip(held, was, strict=True):
            settings[name] = value
    different = {rule: values for rule, values in changed.items() if values != unchanged[rule]}
    if key == "pruning.preset":  # asks for cuts, which the batch's page then has
        del different["summarise_batch", "summarise_batch"]
    assert {script for _, script in different} == set(STAGES_OF[key])
    for rule, values in different.items():
        assert {each for each in values if values[each] != unchanged[rule][each]} == {name}


def test_every_rule_of_a_stage_takes_all_its_keys(unchanged):
    for (rule, script), values in unchanged.items():
        names = {key.rpartition(".")[2] for key in keys_of_stage(SCHEMA, script)}
        assert names <= values.keys(), rule
