import pytest
import yaml

from cherrypicker.batch.config import lookup, read_config_file, resolve_config
from cherrypicker.classes import CLASS_NAMES
from cherrypicker.errors import StageError
from cherrypicker.files import load_yaml
from cherrypicker.pruning.target import LIMIT_WORDS, SHARES


@pytest.fixture(scope="module")
def schema(project):
    return load_yaml(project / "workflow/schemas/config.schema.yaml")


def _sections(schema, path=()):
    for key, value in schema["properties"].items():
        yield (*path, key), value
        if "properties" in value:
            yield from _sections(value, (*path, key))


def test_an_empty_config_is_valid_and_has_every_key(schema):
    config = resolve_config(schema, {})
    for path, _ in _sections(schema):
        lookup(config, ".".join(path))


def test_every_key_has_a_description_and_a_default(schema):
    for path, value in _sections(schema):
        assert "default" in value, path
        assert "properties" in value or value.get("description"), path


def test_the_shipped_config_repeats_valid_keys(schema, project):
    shipped = read_config_file(project / "config/config.yaml")
    assert resolve_config(schema, shipped) == resolve_config(schema, {})


def test_shipped_examples_are_valid(schema, project):
    examples = sorted((project / "config/examples").glob("*.yaml"))
    assert examples
    for example in examples:
        resolve_config(schema, read_config_file(example))


def test_later_layers_win(schema):
    layers = [{"seed": 1, "mvs": {"backend": "cpu"}}, {"seed": 2}, {"seed": "3"}]
    config = resolve_config(schema, *layers)
    assert config["seed"] == 3
    assert config["mvs"]["backend"] == "cpu"


@pytest.mark.parametrize("text", ["0.25", "2.5e-1"])
def test_numbers_arrive_as_strings(text):
    schema = {"type": "object", "properties": {"a": {"type": "number", "default": 1.0}}}
    assert resolve_config(schema, {"a": text})["a"] == 0.25


@pytest.mark.parametrize("text", [".inf", "-.inf", ".nan"])
def test_a_number_is_finite(schema, text):
    value = yaml.safe_load(text)
    with pytest.raises(StageError, match=r"graph\.spacing_m: .* is not of type 'number'"):
        resolve_config(schema, {"graph": {"spacing_m": value}})


@pytest.mark.parametrize("value", [-1, "many", 1.5, None])
def test_a_value_out_of_bounds_names_its_key(schema, value):
    with pytest.raises(StageError, match="seed"):
        resolve_config(schema, {"seed": value})


def test_a_section_may_be_left_empty(schema):
    for empty in ({"mvs": None}, {"skeleton": {"weights": None}}):
        assert resolve_config(schema, empty) == resolve_config(schema, {})


def test_a_config_that_is_no_mapping_is_refused(tmp_path):
    (tmp_path / "c.yaml").write_text(yaml.safe_dump(["a"]))
    with pytest.raises(StageError, match="keys and values"):
        read_config_file(tmp_path / "c.yaml")


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"pruning": {"target": {"heigth_m": 3}}}, r"pruning\.target: 'heigth_m' is not one of"),
        ({"pruning": {"preset": "own"}}, r"pruning\.target: preset own wants a limit"),
        ({"light": {"place_deg": [48, 9]}}, "light: .* belong together"),
        ({"light": 3}, "light: 3 is not of type 'object'"),
    ],
)
def test_what_a_late_stage_could_not_use_is_refused_at_the_start(schema, given, why):
    with pytest.raises(StageError, match=why):
        resolve_config(schema, given)


def test_the_limits_of_a_pruning_are_those_that_the_stage_knows(schema):
    target = schema["properties"]["pruning"]["properties"]["target"]
    assert set(target["propertyNames"]["enum"]) == LIMIT_WORDS.keys() | SHARES


def test_weights_are_of_the_known_classes_and_one_alone_leaves_the_others(schema):
    weights = schema["properties"]["skeleton"]["properties"]["weights"]
    assert set(weights["propertyNames"]["enum"]) == set(CLASS_NAMES.values())
    found = resolve_config(schema, {"skeleton": {"weights": {"branch": 4}}})
    assert found["skeleton"]["weights"] == {"trunk": 10, "branch": 4}
